"""The two series that the loose filter gives over files: as it said at the time, and smoothed."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from plumbline.config import InertialSettings
from plumbline.fusion.loose_smoother import rows_between, smoothed
from plumbline.fusion.loose_state import LooseExtra, LooseNode, LooseState
from plumbline.fusion.timeline import Rows
from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, Ints, Status

_COASTING_NS: Final = 2 * NS_PER_S
_SETTLED_NS: Final = 2 * NS_PER_S  # older nodes are not changed any more: positions come in order
_LAG_NS: Final = 300 * NS_PER_S  # the smoother looks so far ahead, at least


@dataclass(frozen=True, slots=True)
class Piece:
    """Rows of a stretch of the series, at true times."""

    t_gps_ns: Ints  # (n,)
    rows: Floats  # (n, 51)
    t_fix_gps_ns: int | None  # of the last position before
    status: Status

    def status_at(self, t_ns: int) -> Status:
        """Coasting, where the last position is too long ago."""
        late = self.t_fix_gps_ns is None or t_ns - self.t_fix_gps_ns > _COASTING_NS
        return Status.COASTING if late else self.status


def _piece(rows: Rows, extra: LooseExtra | None, after_ns: int) -> Piece:
    """A piece, its stamps made true by the clock; rows not after a time are left out."""
    t_ns, fix_ns = rows.t_gps_ns, None if extra is None else extra.t_fix_gps_ns
    if extra is not None and extra.clock is not None:
        clock = extra.clock
        offset_s = clock.offset_s + clock.drift * (t_ns - clock.t_gps_ns) / NS_PER_S
        t_ns = t_ns + np.rint(offset_s * NS_PER_S).astype(np.int64)
        fix_ns = None if fix_ns is None else fix_ns + round(clock.offset_at(fix_ns) * NS_PER_S)
    keep = t_ns > after_ns
    return Piece(t_ns[keep], rows.values[keep], fix_ns, Status.COASTING if extra is None else extra.status)


class ForwardSeries:
    """The last word on each sample of a share, when the share has passed."""

    def __init__(self) -> None:
        self._last_ns = -1

    def receive(self, state: LooseState, parts: Sequence[Rows]) -> list[Piece]:
        """Rows of a share."""
        latest = {int(t): row for part in parts for t, row in zip(part.t_gps_ns, part.values, strict=True)}
        if not latest:
            return []
        times = sorted(latest)
        rows = Rows(np.array(times, np.int64), np.array([latest[t] for t in times]))
        piece = _piece(rows, state.timeline.nodes[-1].extra if state.timeline.nodes else None, self._last_ns)
        self._last_ns = int(piece.t_gps_ns[-1]) if piece.t_gps_ns.size else self._last_ns
        return [piece]


class SmoothedSeries:
    """Keeps nodes until enough is known of what came after them; memory is bounded by twice the lag."""

    def __init__(self, settings: InertialSettings) -> None:
        self._settings, self._last_ns = settings, -1
        self._nodes: list[LooseNode] = []
        self._times: list[Ints] = []
        self._samples: list[Floats] = []

    def receive(self, state: LooseState) -> list[Piece]:
        """Rows that are due."""
        self._take(state, int(state.timeline.t_gps_ns[-1]) - _SETTLED_NS)
        if not self._nodes or self._nodes[-1].t_gps_ns - self._nodes[0].t_gps_ns < 2 * _LAG_NS:
            return []
        return self._smooth(self._nodes[-1].t_gps_ns - _LAG_NS)

    def finish(self, state: LooseState) -> list[Piece]:
        """The rest."""
        if state.timeline.nodes:
            self._take(state, state.timeline.nodes[-1].t_gps_ns)
        return self._smooth(self._nodes[-1].t_gps_ns) if len(self._nodes) > 1 else []

    def _take(self, state: LooseState, until_ns: int) -> None:
        """Keep nodes that are settled, and the samples."""
        line = state.timeline
        after_ns = self._nodes[-1].t_gps_ns if self._nodes else -1
        self._nodes += [node for node in line.nodes if after_ns < node.t_gps_ns <= until_ns]
        if self._nodes:
            kept_ns = self._times[-1][-1] if self._times else -1
            new = line.t_gps_ns > kept_ns
            if new.any():
                self._times.append(line.t_gps_ns[new])
                self._samples.append(line.samples[new])

    def _smooth(self, until_ns: int) -> list[Piece]:
        """Rows up to a time; what is before it is forgotten."""
        times, samples = np.concatenate(self._times), np.concatenate(self._samples)
        nodes = smoothed(self._nodes, times, samples, self._settings)
        due = [node for node in nodes if node.t_gps_ns <= until_ns]
        pieces = []
        for node, rows in zip(due, rows_between(due, times, samples, self._settings), strict=False):
            pieces.append(_piece(rows, node.extra, self._last_ns))
            self._last_ns = int(pieces[-1].t_gps_ns[-1]) if pieces[-1].t_gps_ns.size else self._last_ns
        self._nodes = self._nodes[len(due) - 1 :]
        keep = max(int(np.searchsorted(times, self._nodes[0].t_gps_ns)) - 2, 0)
        self._times, self._samples = [times[keep:]], [samples[keep:]]
        return pieces
