"""What a receiver's own epochs tell of its tracking, counted: lock lost, half cycles, clock jumps, channels.

Handled these are where they belong (arcs begin anew in :mod:`plumbline.positioning.cycle_slip` and ``rtk_arcs``, a
clock that jumps in code alone is put right in :mod:`plumbline.positioning.tracking`); here they are only seen, in every
mode alike, from the observations themselves.
"""

from collections import Counter
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from plumbline.constants import LIGHT_MILLISECOND_M
from plumbline.gps_time import NS_PER_S
from plumbline.records import UNKNOWN_CHANNEL, Epoch, Floats, Ints, QualityReport, SatelliteIds, Solution
from plumbline.signals import N_SATELLITES, SATELLITES_PER_SYSTEM, System

LOCK_LOST: Final = "receiver_lock_lost"
HALF_CYCLE: Final = "receiver_half_cycle_ambiguous"
CLOCK_JUMP: Final = "receiver_clock_jump_ms"
CHANNEL_CHANGED: Final = "glonass_channel_changed"
CONNECTIONS: Final = "connections_within_an_hour"
CYCLE_SLIP: Final = "cycle_slip"
WEAKER: Final = "receiver_signals_weaker"

_LONGEST_STEP_NS: Final = 60 * NS_PER_S  # a range changes by less than half a light millisecond in that time
_FEWEST: Final = 4
_LOCK_SLACK_S: Final = 1e-3
_CN0_DROP_DB: Final = 6.0
_CN0_MEMORY: Final = 0.02  # of an epoch in the usual strength


@dataclass(slots=True)
class ReceiverWatch:
    """The last epoch's rows as far as they are compared. Picklable."""

    t_gps_ns: int | None = None
    keys: Ints = field(default_factory=lambda: np.zeros(0, np.int64))
    pseudorange_m: Floats = field(default_factory=lambda: np.zeros(0))
    lock_time_s: Floats = field(default_factory=lambda: np.zeros(0))
    channel: dict[int, int] = field(default_factory=dict)
    usual_cn0_db_hz: dict[int, float] = field(default_factory=dict)
    counters: Counter[str] = field(default_factory=Counter)

    def see(self, epoch: Epoch) -> None:
        """Count what an epoch, newer than the last, shows."""
        keys = epoch.signal.astype(np.int64) * N_SATELLITES + epoch.satellite
        self._count(HALF_CYCLE, int(np.count_nonzero(epoch.half_cycle_ambiguous)))
        self._channels(epoch.satellite, epoch.glonass_channel.astype(np.int64))
        self._strengths(keys, epoch.cn0_db_hz)
        if self.t_gps_ns is not None and 0 < epoch.t_gps_ns - self.t_gps_ns <= _LONGEST_STEP_NS:
            _, now, before = np.intersect1d(keys, self.keys, return_indices=True)
            self._locks(epoch, now, before)
            self._clock(epoch.pseudorange_m[now] - self.pseudorange_m[before])
        self.t_gps_ns, self.keys = epoch.t_gps_ns, keys
        self.pseudorange_m, self.lock_time_s = epoch.pseudorange_m, epoch.lock_time_s

    def _count(self, what: str, n: int) -> None:
        if n:
            self.counters[what] += n

    def _locks(self, epoch: Epoch, now: Ints, before: Ints) -> None:
        """Lock-time indicators that fell, and flags of lost lock (RTCM 10403, DF402 and DF407; RINEX LLI)."""
        fell = epoch.lock_time_s[now] < self.lock_time_s[before] - _LOCK_SLACK_S
        if epoch.loss_of_lock is not None:
            fell = fell | epoch.loss_of_lock[now]
        self._count(LOCK_LOST, int(np.count_nonzero(fell)))

    def _clock(self, changes_m: Floats) -> None:
        """A whole millisecond that all pseudoranges have changed by at once."""
        changes_m = changes_m[np.isfinite(changes_m)]
        if changes_m.size >= _FEWEST and round(float(np.median(changes_m)) / LIGHT_MILLISECOND_M) != 0:
            self._count(CLOCK_JUMP, 1)

    def _channels(self, satellite: SatelliteIds, channel: Ints) -> None:
        """GLONASS channels as the stream gives them."""
        glonass = (satellite // SATELLITES_PER_SYSTEM == System.GLONASS) & (channel != UNKNOWN_CHANNEL)
        now = dict(zip(satellite[glonass].tolist(), channel[glonass].tolist(), strict=True))
        self._count(CHANNEL_CHANGED, sum(self.channel.get(s, c) != c for s, c in now.items()))
        self.channel |= now

    def _strengths(self, keys: Ints, cn0_db_hz: Floats) -> None:
        """An epoch whose signals are, in the middle, much weaker than each of them usually is."""
        known = np.isfinite(cn0_db_hz)
        pairs = list(zip(keys[known].tolist(), cn0_db_hz[known].tolist(), strict=True))
        drops = [self.usual_cn0_db_hz[key] - value for key, value in pairs if key in self.usual_cn0_db_hz]
        if len(drops) >= _FEWEST and float(np.median(drops)) > _CN0_DROP_DB:
            self._count(WEAKER, 1)
            return  # the usual strength is that of undisturbed epochs
        for key, value in pairs:
            usual = self.usual_cn0_db_hz.get(key, value)
            self.usual_cn0_db_hz[key] = usual + _CN0_MEMORY * (value - usual)


def satellite_counts(solution: Solution) -> Counter[str]:
    """Satellites that an epoch did without as they are marked unhealthy, and those used in the Earth's shadow."""
    named = {"satellite_unhealthy": "unhealthy_satellites", "satellite_eclipsed": "eclipsed_satellites"}
    found = {what: int(solution.extras.get(extra, 0.0)) for what, extra in named.items()}
    return Counter({what: n for what, n in found.items() if n})


def slip_counts(report: QualityReport) -> Counter[str]:
    """Cycle slips that the processing found in an epoch, by whatever test."""
    n = sum(event.startswith("cycle slip") for event in report.events)
    return Counter({CYCLE_SLIP: n} if n else {})
