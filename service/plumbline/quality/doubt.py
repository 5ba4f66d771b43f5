"""What speaks against a station's displacement, epoch by epoch: its witnesses are asked, suspicions open and close.

Pure and small: ``Watch`` is a station's state, fed with its own solutions, its neighbours' and the fusion's
innovations in the order in which they become known. A suspicion names the displacement that it contradicts and lasts as
long as the antenna shows that one: it ends when the antenna returns, when it moves elsewhere (which nobody has
contradicted), or when a neighbour shows the same. Meanwhile every baseline is frozen, so that what is false does not
become the rule by lasting.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from plumbline.epochs.reference_book import Shown
from plumbline.gps_time import NS_PER_S
from plumbline.quality.course import Course, extended, without_before
from plumbline.quality.structure_or_receiver import (
    ACCELEROMETER,
    NEIGHBOUR,
    RAISED_SIGMA,
    REFERENCE,
    Suspicion,
    contradicted_by_accelerometer,
    contradicted_by_neighbours,
    explained_by_reference,
    is_significant,
)
from plumbline.records import Floats, Solution, Status

TRUSTED: Final = frozenset({Status.PPP_FLOAT, Status.PPP_FIXED, Status.RTK_FLOAT, Status.RTK_FIXED})
_SILENT_NS: Final = 10 * NS_PER_S  # a neighbour without trusted epochs for so long is not waited for
_ENDED_KEPT_NS: Final = 120 * NS_PER_S
_REMEMBERED_NS: Final = 600 * NS_PER_S  # a baseline shows nothing of what was longer ago
_STAYS_SIGMA: Final = 1.0  # neighbours must disagree by less to keep a suspicion than to raise it


@dataclass(frozen=True, slots=True)
class Watch:
    """A station's witnesses and what they say. Times are event times."""

    own: Course = field(default_factory=Course)
    neighbours: Mapping[str, Course] = field(default_factory=dict)
    open: tuple[Suspicion, ...] = ()
    ended: tuple[Suspicion, ...] = ()  # of the last minutes
    t_asked_gps_ns: int = 0  # the neighbours have been asked about every epoch up to this one

    def doubts(self, t_first_gps_ns: int, t_last_gps_ns: int) -> tuple[Suspicion, ...]:
        """What speaks against a stretch of event time."""
        every = (*self.ended, *self.open)
        return tuple(s for s in every if s.overlaps(t_first_gps_ns, t_last_gps_ns))


def neighbour_shows(watch: Watch, name: str, solution: Solution, share: float) -> Watch:
    """A neighbour's epoch; one without a position to trust is no word. ``share`` as in :func:`own_shows`."""
    if not _is_word(solution):
        return watch
    assert solution.displacement_enu_m is not None
    before = watch.neighbours.get(name, Course())
    course = extended(before, solution.t_gps_ns, solution.displacement_enu_m, frozen=bool(watch.open))
    return _ask_neighbours(replace(watch, neighbours={**watch.neighbours, name: course}), share)


def own_shows(watch: Watch, solution: Solution, references: Mapping[str, Shown], share: float) -> Watch:
    """The station's own epoch: suspicions that no longer hold end, and the witnesses are asked.

    ``references``: name → what the reference stations' own positions show at this epoch, as known by now.
    ``share``: of a displacement that a neighbour must show, too.
    """
    if not _is_word(solution):
        return watch
    assert solution.displacement_enu_m is not None
    t_ns = solution.t_gps_ns
    own = extended(watch.own, t_ns, solution.displacement_enu_m, frozen=bool(watch.open))
    watch = _reviewed(replace(watch, own=own), t_ns, share)
    watch = _ask_neighbours(watch, share)
    return _ask_references(watch, t_ns, references)


def accelerometer_says(watch: Watch, t_gps_ns: int, innovation_m: Floats, whitened: Floats) -> Watch:
    """The fusion's innovation of the station's epoch at a time: what GNSS says beyond what was felt."""
    departure = watch.own.departure_at(t_gps_ns)
    if departure is None or _has(watch, ACCELEROMETER):
        return watch
    return _opened(watch, contradicted_by_accelerometer(whitened, innovation_m, departure), t_gps_ns)


def _is_word(solution: Solution) -> bool:
    return (
        solution.status in TRUSTED
        and solution.displacement_enu_m is not None
        and bool(np.isfinite(solution.displacement_enu_m).all())
    )


def _has(watch: Watch, witness: str) -> bool:
    return any(suspicion.witness == witness for suspicion in watch.open)


def _opened(watch: Watch, suspicion: Suspicion | None, t_gps_ns: int) -> Watch:
    if suspicion is None:
        return watch
    return replace(watch, open=(*watch.open, replace(suspicion, t_from_gps_ns=t_gps_ns)))


def _reviewed(watch: Watch, t_ns: int, share: float) -> Watch:
    """End the suspicions that the station's epoch at a time no longer bears out."""
    departure = watch.own.departure_at(t_ns)
    if departure is None or not watch.open:
        return watch
    still = [s for s in watch.open if s.explains(departure, watch.own.sigma_m) and not _confirmed(watch, s, share)]
    ended = [replace(s, t_until_gps_ns=t_ns) for s in watch.open if s not in still]
    kept = (s for s in watch.ended if (s.t_until_gps_ns or 0) > t_ns - _ENDED_KEPT_NS)
    if not still:  # the doubted epochs have been spoken of, and become part of no baseline
        asked_ns = max(watch.t_asked_gps_ns, t_ns - 1)
        watch = replace(watch, own=without_before(watch.own, t_ns), t_asked_gps_ns=asked_ns)
    return replace(watch, open=tuple(still), ended=(*kept, *ended))


def _confirmed(watch: Watch, suspicion: Suspicion, share: float) -> bool:
    """Whether the neighbours, who were suspicion's witnesses, have come to show the displacement themselves."""
    if suspicion.witness != NEIGHBOUR:
        return False
    t_ns = watch.t_asked_gps_ns
    if t_ns < suspicion.t_from_gps_ns or watch.own.departure_at(t_ns) is None:
        return False
    return _contradiction(watch, t_ns, share, _STAYS_SIGMA) is None


def _common(watch: Watch, after_ns: int) -> list[int]:
    """The station's recent epochs after a time that every neighbour who speaks has, too, in order."""
    times = watch.own.times
    if not times:
        return []
    speaking = [
        c
        for c in watch.neighbours.values()
        if c.times and times[-1] - c.times[-1] <= _SILENT_NS and _remembers(c, watch.own)
    ]
    if not speaking:
        return []
    return [t for t in times if t > after_ns and all(c.departure_at(t) is not None for c in speaking)]


def _remembers(neighbour: Course, own: Course) -> bool:
    """Whether a neighbour's baseline is as old as what the station's own still remembers."""
    return neighbour.is_learnt and (
        neighbour.t_first_gps_ns <= own.t_first_gps_ns
        or neighbour.t_last_gps_ns - neighbour.t_first_gps_ns >= _REMEMBERED_NS
    )


def _ask_neighbours(watch: Watch, share: float) -> Watch:
    """Ask about every epoch that all have come to; the first that is contradicted begins a suspicion."""
    if not watch.neighbours:
        return watch
    for t in _common(watch, watch.t_asked_gps_ns):
        watch = replace(watch, t_asked_gps_ns=t)
        if not _has(watch, NEIGHBOUR):
            watch = _opened(watch, _contradiction(watch, t, share), t)
    return watch


def _contradiction(watch: Watch, t_ns: int, share: float, sigmas: float = RAISED_SIGMA) -> Suspicion | None:
    """The neighbours' word against the station's epoch at a time."""
    departure = watch.own.departure_at(t_ns)
    if departure is None:
        return None
    told = {name: (course.departure_at(t_ns), course.sigma_m) for name, course in watch.neighbours.items()}
    others = {
        name: (shown, np.diag(sigma**2))
        for name, (shown, sigma) in told.items()
        if shown is not None and _remembers(watch.neighbours[name], watch.own)
    }
    return contradicted_by_neighbours(departure, np.diag(watch.own.sigma_m**2), others, share, sigmas)


def _ask_references(watch: Watch, t_ns: int, references: Mapping[str, Shown]) -> Watch:
    departure = watch.own.departure_at(t_ns)
    if departure is None or _has(watch, REFERENCE):
        return watch
    if not is_significant(departure, np.diag(watch.own.sigma_m**2)):
        return watch
    for name, shown in references.items():
        found = explained_by_reference(departure, np.array(shown.departure_m), np.array(shown.sigma_m), name)
        if found is not None:
            return _opened(watch, found, t_ns)
    return watch
