"""What a station's motion is worth an alert: its witnesses are heard first, its thresholds are asked second.

A station's own solutions, those of its neighbours and the fusion's innovations become *known* at a receive time that
follows from their bytes alone (an epoch's last byte, and how long such an epoch may wait for its parts and its base).
They are taken in that order, however late or early the pipeline came to compute them; a block of motion is judged a
little later still (``wait_ns``), when those who could contradict it have been heard. So alerts and flags follow from
receive times alone, live, after a take-over and in a replay. What an accelerometer measures itself is judged at once.

A contradicted displacement is marked in the reason of the solutions and motions that show it, raises no alert on
displacement, velocity or rate, and raises a data alert that says what speaks against it.
"""

import heapq
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

from plumbline.alerts import rules
from plumbline.alerts.data_faults import Fault, evaluate_faults
from plumbline.alerts.quantities import HEALTH, needs_gnss
from plumbline.config import Mode, StationSettings
from plumbline.epochs.reference_book import ReferenceBook
from plumbline.epochs.stream import Books
from plumbline.fusion import Innovation
from plumbline.gps_time import NS_PER_S
from plumbline.modes.context import Felt, Outcome
from plumbline.quality.doubt import Watch, accelerometer_says, neighbour_shows, own_shows
from plumbline.quality.structure_or_receiver import REFERENCE, WITNESSES, Suspicion
from plumbline.records import AlertEvent, Motion, Output, QualityReport, Solution, StationStatus, Threshold

_NEIGHBOURS_WAIT_NS: Final = 2 * NS_PER_S  # a neighbour's epoch may come so much later than the station's own
_KNOWN_KEPT: Final = 64
_FOREVER_NS: Final = 1 << 62
_FRAME_KEY = tuple[object, ...]


class _Said(NamedTuple):
    """A neighbour's solution."""

    name: str
    solution: Solution


_Event = Solution | _Said | Innovation | Motion


@dataclass(slots=True)
class JudgementState:
    """What a checkpoint holds of it."""

    frame: _FRAME_KEY = ()  # what displacements are measured from: another, and the watch begins anew
    watch: Watch = field(default_factory=Watch)
    prompt: rules.AlertsState = field(default_factory=rules.AlertsState)  # data health, accelerations
    considered: rules.AlertsState = field(default_factory=rules.AlertsState)  # the rest, and data alerts
    queue: list[tuple[int, int, _Event]] = field(default_factory=list)  # (known from, number, what), a heap
    number: int = 0
    flags: list[tuple[int, str]] = field(default_factory=list)  # (receive time, what is said of records from then on)


class Judge:
    """One station's. The state is passed in and changed in place."""

    def __init__(
        self,
        settings: StationSettings,
        thresholds: Sequence[Threshold],
        books: Books,
        neighbours: Sequence[StationSettings] = (),
    ) -> None:
        self._settings = settings
        self._prompt = tuple(t for t in thresholds if t.quantity in HEALTH or not needs_gnss(t.quantity))
        self._considered = tuple(t for t in thresholds if t not in self._prompt)
        self._references: Mapping[str, ReferenceBook] = books.references
        self._settle_ns = {s.station: _settle_ns(s) for s in (settings, *neighbours)}
        self._has_witness = bool(neighbours) or settings.mode is Mode.PPP_ACCEL or _is_relative(settings)
        self._own_settle_ns = self._settle_ns[settings.station]
        self.wait_ns = self._own_settle_ns if self._has_witness else 0
        if neighbours:
            self.wait_ns = max(self._settle_ns.values()) + _NEIGHBOURS_WAIT_NS
        self._frame = (
            settings.reference_position_ecef_m,
            settings.rtk.base_position_ecef_m,
            *((n.station, n.reference_position_ecef_m) for n in neighbours),
        )

    def resume(self, state: JudgementState, *, anew: bool = False) -> None:
        """Go on with a state; the watch begins anew where its displacements or times (``anew``) meant something else.

        Alerts that are raised stay so until their thresholds say otherwise.
        """
        if anew or state.frame != self._frame:
            state.frame, state.watch, state.queue, state.flags = self._frame, Watch(), [], []

    # ----------------------------------------------------------------------------------------- what comes in

    def told(self, state: JudgementState, outcomes: Sequence[Outcome]) -> list[Output]:
        """What a mode has made leaves again, flagged where it is doubted, with the alerts that are due."""
        outputs, events = list[Output](), list[Output]()
        for outcome in outcomes:
            events += self.advance(state, outcome.t_receive_ns)
            if isinstance(outcome, Felt):
                self._put(state, outcome.t_receive_ns + self._own_settle_ns, outcome.innovation)
            elif isinstance(outcome, QualityReport):
                outputs.append(outcome)
            else:
                outputs.append(self._flagged(state, outcome))
                events += self._considered_later(state, outcome)
                events += self.advance(state, outcome.t_receive_ns)
        return [*outputs, *events]

    def _considered_later(self, state: JudgementState, record: Solution | Motion) -> list[AlertEvent]:
        """Queue a record for when its witnesses have been heard; what needs none is judged now."""
        state.prompt, raised = rules.evaluate(state.prompt, self._prompt, record)
        if isinstance(record, Motion):
            self._put(state, record.t_receive_ns + self.wait_ns, record)
        elif self._has_witness:
            self._put(state, record.t_receive_ns + self._own_settle_ns, record)
        return raised

    def said(self, state: JudgementState, name: str, solution: Solution) -> None:
        """A neighbour's solution."""
        self._put(state, solution.t_receive_ns + self._settle_ns[name], _Said(name, solution))

    def status(self, state: JudgementState, status: StationStatus) -> list[AlertEvent]:
        """What a status says of the data's health is judged at once."""
        state.prompt, raised = rules.evaluate(state.prompt, self._prompt, status)
        return raised

    def advance(self, state: JudgementState, t_receive_ns: int) -> list[AlertEvent]:
        """Take what is known by a receive time, in order."""
        events: list[AlertEvent] = []
        while state.queue and state.queue[0][0] <= t_receive_ns:
            t_known_ns, _, event = heapq.heappop(state.queue)
            events += self._take(state, t_known_ns, event)
        return events

    def finish(self, state: JudgementState) -> list[AlertEvent]:
        """Nothing more will come."""
        return self.advance(state, _FOREVER_NS)

    def _put(self, state: JudgementState, t_known_ns: int, event: _Event) -> None:
        state.number += 1
        heapq.heappush(state.queue, (t_known_ns, state.number, event))

    # ----------------------------------------------------------------------------------------- what follows

    def _take(self, state: JudgementState, t_known_ns: int, event: _Event) -> list[AlertEvent]:
        share = self._settings.neighbour_share
        if isinstance(event, Motion):
            last_ns = event.t_first_gps_ns + event.interval_ns * max(len(event.displacement_enu_m) - 1, 0)
            doubted = bool(state.watch.doubts(event.t_first_gps_ns, last_ns))
            state.considered, raised = rules.evaluate(state.considered, self._considered, event, doubted)
            return raised
        if isinstance(event, _Said):
            state.watch = neighbour_shows(state.watch, event.name, event.solution, share)
        elif isinstance(event, Innovation):
            state.watch = accelerometer_says(state.watch, event.t_gps_ns, event.innovation_enu_m, event.whitened)
        else:
            books = {name: book for name, book in self._references.items() if self._rests_on(name)}
            shown = {name: book.at(event.t_gps_ns, t_known_ns) for name, book in books.items()}
            known = {name: at for name, at in sorted(shown.items()) if at is not None}
            state.watch = own_shows(state.watch, event, known, share)
        told = self._told_of_references(t_known_ns)
        self._note(state, t_known_ns, told)
        if not isinstance(event, Solution) or not event.status.has_position:
            return []
        faults = _faults(state.watch.open, told, event.t_gps_ns)
        state.considered, raised = evaluate_faults(
            state.considered, self._settings.station, WITNESSES, faults, event.t_gps_ns, event.t_receive_ns
        )
        return raised

    def _rests_on(self, stream: str) -> bool:
        """Whether a stream's station is (one of) the station's references."""
        if not _is_relative(self._settings):
            return False
        rtk = self._settings.rtk
        named = {rtk.base_stream, *rtk.base_streams} - {None}
        return not named or stream in named

    def _told_of_references(self, t_known_ns: int) -> str:
        """What the long watch says of the references: they have moved."""
        books = sorted((name, book) for name, book in self._references.items() if self._rests_on(name))
        said = {name: book.said(t_known_ns) for name, book in books}
        return "; ".join(f"{name}: {text}" for name, text in said.items() if text)

    def _note(self, state: JudgementState, t_known_ns: int, told: str) -> None:
        """Remember from when on what is said of records."""
        words = "; ".join([*(suspicion.reason for suspicion in state.watch.open), *([told] if told else [])])
        if words != (state.flags[-1][1] if state.flags else ""):
            state.flags = [*state.flags[1 - _KNOWN_KEPT :], (t_known_ns, words)]

    def _flagged(self, state: JudgementState, record: Solution | Motion) -> Solution | Motion:
        """The record, its reason saying what speaks against it as known when it was received."""
        words = next((text for t_ns, text in reversed(state.flags) if t_ns <= record.t_receive_ns), "")
        if not words:
            return record
        return replace(record, reason="; ".join(text for text in (record.reason, f"doubtful: {words}") if text))


def _faults(suspicions: Sequence[Suspicion], told: str, t_gps_ns: int) -> dict[str, Fault]:
    """What speaks against the data, by witness."""
    faults = {REFERENCE: Fault(t_gps_ns, 0.0, told)} if told else {}
    for suspicion in suspicions:
        faults[suspicion.witness] = Fault(suspicion.t_from_gps_ns, suspicion.size_m, suspicion.reason)
    return faults


def _is_relative(settings: StationSettings) -> bool:
    """Whether displacements are measured from a base station."""
    return settings.mode.value.startswith("rtk")


def _settle_ns(settings: StationSettings) -> int:
    """After an epoch's last byte, how long it can be until it is positioned: for late parts, and for its base."""
    wait_s = settings.rtk.base_wait_s if _is_relative(settings) else 0.0
    return round((settings.epoch_deadline_s + wait_s) * NS_PER_S)
