"""A navigation filter's samples to blocks of motion, one a GPS second.

A block leaves when its last sample is in, and once more, with a higher revision, when the GNSS measurements of its
whole second have been applied (and again if something later still has changed it). So motion leaves with the latency of
the samples, and what is stored in the end is what everything received says.
"""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

import numpy as np

from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, Ints, Motion, Status

N_COLUMNS: Final = 18  # displacement, velocity, acceleration, sigma of displacement, attitude, its sigma
_COASTING_NS: Final = 2 * NS_PER_S


@dataclass(frozen=True, slots=True)
class Told:
    """What a block says of itself beyond its samples."""

    t_gnss_gps_ns: int | None  # of the last GNSS measurement applied
    status: Status  # of that measurement
    reason: str  # why nothing newer was applied, where that is known


@dataclass(slots=True)
class _Second:
    t_gps_ns: Ints
    values: Floats
    revision: int = 0  # of the next block
    changed: bool = True  # since the last block


@dataclass(slots=True)
class MotionSeconds:
    """The last seconds of a station's samples. Picklable."""

    kept_ns: int  # no measurement later than this is applied
    first_revision: int = 0
    _seconds: dict[int, _Second] = field(default_factory=dict)

    def put(self, t_gps_ns: Ints, values: Floats) -> None:
        """Take the rows (n, 18) of all samples from a time on; earlier ones of those times are replaced."""
        if not t_gps_ns.size:
            return
        edges = [0, *(np.flatnonzero(np.diff(t_gps_ns // NS_PER_S)) + 1).tolist(), t_gps_ns.size]
        for begin, end in pairwise(edges):
            number = int(t_gps_ns[begin]) // NS_PER_S
            held = self._seconds.get(number)
            if held is None:
                held = _Second(np.zeros(0, np.int64), np.zeros((0, N_COLUMNS)), self.first_revision)
                self._seconds[number] = held
            before = held.t_gps_ns < t_gps_ns[begin]
            held.t_gps_ns = np.concatenate([held.t_gps_ns[before], t_gps_ns[begin:end]])
            held.values = np.concatenate([held.values[before], values[begin:end]])
            held.changed = True

    def due(self, station: str, interval_ns: int, told: Told, t_receive_ns: int) -> list[Motion]:
        """The blocks that are to leave now, in order of time."""
        if not self._seconds:
            return []
        newest_ns = int(self._seconds[max(self._seconds)].t_gps_ns[-1])
        motions: list[Motion] = []
        for number in sorted(self._seconds):
            second, end_ns = self._seconds[number], (number + 1) * NS_PER_S
            whole = newest_ns >= end_ns - interval_ns - interval_ns // 2
            settled = told.t_gnss_gps_ns is not None and told.t_gnss_gps_ns >= end_ns
            over = newest_ns >= end_ns + self.kept_ns
            first = second.revision == self.first_revision
            if whole and second.changed and (first or settled or over):
                motions += _blocks(station, second, interval_ns, told, t_receive_ns)
                second.revision, second.changed = second.revision + 1, False
            if over:
                del self._seconds[number]
        return motions


def _blocks(station: str, second: _Second, interval_ns: int, told: Told, t_receive_ns: int) -> list[Motion]:
    """One block, or where samples are missing one for each run of them."""
    gaps = np.flatnonzero(np.diff(second.t_gps_ns) > interval_ns + interval_ns // 2) + 1
    return [
        _block(station, second, slice(begin, end), interval_ns, told, t_receive_ns)
        for begin, end in pairwise([0, *gaps.tolist(), second.t_gps_ns.size])
    ]


def _block(
    station: str, second: _Second, part: slice, interval_ns: int, told: Told, t_receive_ns: int
) -> Motion:  # fmt: skip
    values, t_last_ns = second.values[part], int(second.t_gps_ns[part][-1])
    gap_ns = None if told.t_gnss_gps_ns is None else t_last_ns - told.t_gnss_gps_ns
    coasting = gap_ns is None or gap_ns > _COASTING_NS
    since = "" if gap_ns is None else f" for {gap_ns / NS_PER_S:.0f} s"
    why = f"no GNSS{since}: " + (told.reason or "none has come") if coasting else ""
    return Motion(
        station=station,
        t_first_gps_ns=int(second.t_gps_ns[part][0]),
        t_receive_ns=t_receive_ns,
        interval_ns=interval_ns,
        displacement_enu_m=values[:, 0:3],
        velocity_enu_m_s=values[:, 3:6],
        acceleration_enu_m_s2=values[:, 6:9],
        sigma_displacement_enu_m=values[:, 9:12],
        status=Status.COASTING if coasting else told.status,
        revision=second.revision,
        reason=why,
        attitude_rad=values[:, 12:15],
        sigma_attitude_rad=values[:, 15:18],
    )
