"""Observation messages of one antenna → epochs, by their time.

The multiple-message bit (DF393) that should mark the last message of an epoch is set wrongly by some receivers and
never cleared by others, so it is one sign of several. An epoch closes when

* every message that the last epochs had is in, as often as they had it or with the bit set at last, or
* nothing is known yet of what to expect and the bit says that this was the last, or
* its deadline has passed, counted from the receive time of its first message: a constellation is late or gone, or
* a later epoch closes, or two later ones have begun.

Epochs leave in order of time. What comes for a time that has left is counted, not used; a message whose time is far off
(a broken clock field) waits until a second message confirms it, so that one bad field cannot move the series.
"""

from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.gps_time import NS_PER_S
from plumbline.records import UNKNOWN_CHANNEL, Epoch, Floats, SatelliteIds, SignalIds
from plumbline.rtcm3.observations import Observations, unroll_legacy_phase
from plumbline.signals import CHANNEL_STEP_HZ, FREQUENCY_HZ, N_SATELLITES, SATELLITES_PER_SYSTEM, System

FAR_OFF_NS: Final = 300 * NS_PER_S
_REMEMBERED_EPOCHS: Final = 3
_REJECTED_BEFORE_RESET: Final = 40
_LAST_LEGACY_MESSAGE: Final = 1012
_GLONASS_FIRST: Final = System.GLONASS * SATELLITES_PER_SYSTEM


@dataclass(slots=True)
class _OpenEpoch:
    t_gps_ns: int
    t_first_receive_ns: int
    t_last_receive_ns: int
    parts: list[Observations] = field(default_factory=list)
    last_by_bit: bool = False

    def numbers(self) -> Counter[int]:
        return Counter(part.number for part in self.parts)


class EpochAssembler:
    """Sans-IO: feed it messages with their times, it answers with the epochs that are now complete. Picklable.

    ``counters`` holds what was not used, by reason.
    """

    def __init__(self, deadline_ns: int) -> None:
        self.deadline_ns = deadline_ns
        self.counters: Counter[str] = Counter()
        self.glonass_channel = np.full(SATELLITES_PER_SYSTEM, UNKNOWN_CHANNEL, np.int8)
        self._open: dict[int, _OpenEpoch] = {}
        self._recent: deque[tuple[int, Counter[int]]] = deque(maxlen=_REMEMBERED_EPOCHS)
        self._last_closed_ns: int | None = None
        self._doubtful: list[tuple[Observations, int, int]] = []
        self._rejected_in_a_row = 0
        self._legacy_cycles: dict[int, float] = {}  # last phase by row key, to undo the roll-over of 1003, 1004 …

    def learn_channel(self, satellite: int, channel: int) -> None:
        """A GLONASS satellite's frequency channel, from its ephemeris."""
        self.glonass_channel[satellite - _GLONASS_FIRST] = channel

    def receive(self, message: Observations, t_gps_ns: int, t_receive_ns: int) -> list[Epoch]:
        """Take a message whose epoch time has been resolved; return the epochs that close with it, in order."""
        epochs = self.advance(t_receive_ns)
        for accepted, t, received in self._plausible(message, t_gps_ns, t_receive_ns):
            if self._add(accepted, t, received):
                epochs += self._close_complete(t)
        return epochs

    def advance(self, t_receive_ns: int) -> list[Epoch]:
        """Time passes: close what has waited past its deadline."""
        overdue = [t for t, e in self._open.items() if t_receive_ns - e.t_first_receive_ns >= self.deadline_ns]
        if not overdue:
            return []
        for t in overdue:
            self._count_missing(self._open[t])
        return self._close_up_to(max(overdue))

    def flush(self) -> list[Epoch]:
        """The stream has ended: close everything."""
        return self._close_up_to(max(self._open)) if self._open else []

    def _plausible(
        self, message: Observations, t_gps_ns: int, t_receive_ns: int
    ) -> Iterator[tuple[Observations, int, int]]:
        """Yield the messages that may be used now: this one, or those that it confirms with it, or none."""
        newest = max(self._open, default=self._last_closed_ns)
        if newest is None or abs(t_gps_ns - newest) < FAR_OFF_NS:
            self._drop_doubtful()
            yield message, t_gps_ns, t_receive_ns
            return
        confirmed = [d for d in self._doubtful if abs(d[1] - t_gps_ns) < FAR_OFF_NS and d[0].number != message.number]
        confirmed += [d for d in self._doubtful if 0 < abs(d[1] - t_gps_ns) < FAR_OFF_NS and d not in confirmed]
        if not confirmed:
            self._doubtful.append((message, t_gps_ns, t_receive_ns))
            if len(self._doubtful) > _REJECTED_BEFORE_RESET:
                self._drop_doubtful(1)
            return
        if t_gps_ns < newest:
            self._restart()
        waiting = [d for d in self._doubtful if abs(d[1] - t_gps_ns) < FAR_OFF_NS]
        self._doubtful = []
        yield from waiting
        yield message, t_gps_ns, t_receive_ns

    def _drop_doubtful(self, n: int | None = None) -> None:
        dropped = self._doubtful[:n]
        if dropped:
            self.counters["implausible_epoch_time"] += len(dropped)
            self._doubtful = self._doubtful[len(dropped) :]

    def _restart(self) -> None:
        """The series went back in time, and the messages agree on it."""
        self.counters["time_went_back"] += 1
        self._open.clear()
        self._recent.clear()
        self._last_closed_ns = None

    def _add(self, message: Observations, t_gps_ns: int, t_receive_ns: int) -> bool:
        if self._last_closed_ns is not None and t_gps_ns <= self._last_closed_ns:
            self._count_late(message, t_gps_ns)
            return False
        epoch = self._open.get(t_gps_ns)
        if epoch is None:
            epoch = self._open[t_gps_ns] = _OpenEpoch(t_gps_ns, t_receive_ns, t_receive_ns)
        elif _repeats(epoch, message):
            self.counters["duplicate_message"] += 1
            return False
        epoch.parts.append(message)
        epoch.t_last_receive_ns = t_receive_ns
        epoch.last_by_bit = not message.multiple_message
        self._rejected_in_a_row = 0
        return True

    def _count_late(self, message: Observations, t_gps_ns: int) -> None:
        """A message for an epoch that has left; one that comes late every time is waited for from now on."""
        self.counters["late_message" if t_gps_ns == self._last_closed_ns else "out_of_order_message"] += 1
        for t, numbers in self._recent:
            if t == t_gps_ns and not numbers[message.number]:
                numbers[message.number] += 1
        self._rejected_in_a_row += 1
        if self._rejected_in_a_row >= _REJECTED_BEFORE_RESET and t_gps_ns != self._last_closed_ns:
            self._restart()
            self._rejected_in_a_row = 0

    def _expected(self) -> Counter[int]:
        expected: Counter[int] = Counter()
        for _, numbers in self._recent:
            expected |= numbers
        return expected

    def _close_complete(self, t_gps_ns: int) -> list[Epoch]:
        if self._is_complete(self._open[t_gps_ns]):
            return self._close_up_to(t_gps_ns)
        later = sorted(t for t in self._open if t > min(self._open))
        return self._close_up_to(min(self._open)) if len(later) >= 2 else []

    def _is_complete(self, epoch: _OpenEpoch) -> bool:
        """Every system is in, as often as before or, where their number of messages varies, by the bit's word."""
        expected, numbers = self._expected(), epoch.numbers()
        return set(expected) <= set(numbers) and (epoch.last_by_bit or (bool(expected) and expected <= numbers))

    def _close_up_to(self, t_gps_ns: int) -> list[Epoch]:
        closing = sorted(t for t in self._open if t <= t_gps_ns)
        return [self._close(self._open.pop(t)) for t in closing]

    def _count_missing(self, epoch: _OpenEpoch) -> None:
        for number in (self._expected() - epoch.numbers()).elements():
            self.counters[f"deadline_without_{number}"] += 1

    def _close(self, epoch: _OpenEpoch) -> Epoch:
        self._last_closed_ns = epoch.t_gps_ns
        self._recent.append((epoch.t_gps_ns, epoch.numbers()))
        return self._merge(epoch)

    def _merge(self, epoch: _OpenEpoch) -> Epoch:
        parts = epoch.parts
        satellite = np.concatenate([p.satellite for p in parts])
        signal = np.concatenate([p.signal for p in parts])
        order = np.lexsort((signal, satellite))
        satellite, signal = satellite[order], signal[order]
        phase_range_m = np.concatenate([p.phase_range_m for p in parts])[order]
        channel = np.concatenate([p.glonass_channel for p in parts])[order]
        channel = self._channels(satellite, channel)
        frequency_hz = FREQUENCY_HZ[signal] + channel * CHANNEL_STEP_HZ[signal]
        frequency_hz[channel == UNKNOWN_CHANNEL] = np.nan
        wavelength_m = SPEED_OF_LIGHT_M_S / frequency_hz
        return Epoch(
            t_gps_ns=epoch.t_gps_ns,
            t_receive_ns=epoch.t_last_receive_ns,
            satellite=satellite,
            signal=signal,
            pseudorange_m=np.concatenate([p.pseudorange_m for p in parts])[order],
            carrier_phase_cycles=self._continuous(phase_range_m / wavelength_m, satellite, signal, parts[0].number),
            doppler_hz=-np.concatenate([p.phase_range_rate_m_s for p in parts])[order] / wavelength_m,
            cn0_db_hz=np.concatenate([p.cn0_db_hz for p in parts])[order],
            lock_time_s=np.concatenate([p.lock_time_s for p in parts])[order],
            half_cycle_ambiguous=np.concatenate([p.half_cycle_ambiguous for p in parts])[order],
            glonass_channel=channel,
            antenna=parts[0].station,
        )

    def _continuous(self, cycles: Floats, satellite: SatelliteIds, signal: SignalIds, message_number: int) -> Floats:
        """Phases as they are, or with the legacy messages' jumps of 1500 cycles undone."""
        if message_number > _LAST_LEGACY_MESSAGE:
            return cycles
        keys = _row_keys(satellite, signal)
        previous = np.array([self._legacy_cycles.get(key, np.nan) for key in keys])
        unrolled = unroll_legacy_phase(previous, cycles)
        self._legacy_cycles = dict(zip(keys, unrolled.tolist(), strict=True))
        return unrolled

    def _channels(self, satellite: SatelliteIds, channel: NDArray[np.int8]) -> NDArray[np.int8]:
        """Each row's GLONASS channel: the message's own, else the ephemeris's; what a message told is remembered."""
        glonass = satellite // SATELLITES_PER_SYSTEM == System.GLONASS
        slot = satellite[glonass] - _GLONASS_FIRST
        told = channel[glonass]
        known = told != UNKNOWN_CHANNEL
        self.glonass_channel[slot[known]] = told[known]
        result = np.zeros(satellite.size, np.int8)
        result[glonass] = np.where(known, told, self.glonass_channel[slot])
        return result


def _row_keys(satellite: SatelliteIds, signal: SignalIds) -> list[int]:
    keys: list[int] = (signal.astype(np.int64) * N_SATELLITES + satellite).tolist()
    return keys


def _repeats(epoch: _OpenEpoch, message: Observations) -> bool:
    """Whether the epoch already holds one of the message's rows (a repeated message, not its second part)."""
    rows = set(_row_keys(message.satellite, message.signal))
    held = [set(_row_keys(p.satellite, p.signal)) for p in epoch.parts if p.number == message.number]
    return any(not rows.isdisjoint(other) for other in held) or (not rows and bool(held))
