"""An IMU's samples on the common time line (:mod:`plumbline.epochs.time_matching`), in body axes."""

from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from plumbline.config import InertialSettings
from plumbline.epochs.time_matching import NO_TAIL, SampleTail, grid_rate, grid_time_ns, match_samples
from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, InertialBlock, Ints

SILENT_S: Final = 3.0  # an IMU that sends no samples for so long is said to be silent …
WAITED_FOR_S: Final = 60.0  # … and after this nothing waits for them any more, and what was filtered is worth nothing
FUTURE_LIMIT_NS: Final = 600 * NS_PER_S  # a sample stamped so long after its receipt has a wrong stamp


@dataclass(slots=True)
class ImuSamples:
    """Takes blocks of one sensor, the first that is heard; what is not used is counted. Picklable."""

    counters: Counter[str] = field(default_factory=Counter)
    interval_ns: int = 0  # of the grid; 0 before the first sample
    t_receive_ns: int | None = None  # of the last block used
    t_last_gps_ns: int | None = None  # of the last sample on the grid
    _sensor: int | None = None
    _tails: tuple[SampleTail, SampleTail] = (NO_TAIL, NO_TAIL)  # of forces and rates

    def receive(self, block: InertialBlock, settings: InertialSettings) -> tuple[Ints, Floats] | None:
        """Times (n,) and samples (n, 6), specific force m/s² and rate rad/s in body axes; None: nothing to use."""
        reason, rate = self._refusal(block), grid_rate(block.interval_ns)
        if reason or rate is None or block.angular_rate_rad_s is None:
            self.counters[reason] += 1
            return None
        self._sensor, self.t_receive_ns, offset_s = block.sensor, block.t_receive_ns, settings.inertial_time_offset_s
        rates_block = replace(block, specific_force_m_s2=block.angular_rate_rad_s)
        first, forces, force_tail = match_samples(block, offset_s, self._tails[0])
        _, rates, rate_tail = match_samples(rates_block, offset_s, self._tails[1])
        self._tails, self.interval_ns = (force_tail, rate_tail), NS_PER_S // rate
        turn = np.array(settings.rotation_body_from_sensor)
        times = np.array([grid_time_ns(first + k, rate) for k in range(len(forces))], np.int64)
        self.t_last_gps_ns = int(times[-1]) if times.size else self.t_last_gps_ns
        return times, np.hstack([forces @ turn.T, rates @ turn.T])

    def silent_s(self, t_receive_ns: int) -> float | None:
        """How long no samples have come; None: there never were any."""
        return None if self.t_receive_ns is None else (t_receive_ns - self.t_receive_ns) / NS_PER_S

    def reach(self, t_gps_ns: int) -> bool:
        """Whether the samples have come up to a time."""
        return self.t_last_gps_ns is not None and self.t_last_gps_ns >= t_gps_ns

    def breaks_off(self, block: InertialBlock) -> bool:
        """Whether a block is so far from the samples before it in time that nothing is left to carry on from."""
        far_ns = 0 if self.t_last_gps_ns is None else abs(block.t_first_gps_ns - self.t_last_gps_ns)
        return far_ns > WAITED_FOR_S * NS_PER_S

    def _refusal(self, block: InertialBlock) -> str:
        """Why a block cannot be used; empty if it can."""
        if block.angular_rate_rad_s is None:
            return "inertial_without_angular_rates"
        if grid_rate(block.interval_ns) is None:
            return "inertial_interval_not_usable"
        if block.t_first_gps_ns > block.t_receive_ns + FUTURE_LIMIT_NS:
            return "inertial_from_the_future"
        return "inertial_of_another_sensor" if self._sensor not in (None, block.sensor) else ""
