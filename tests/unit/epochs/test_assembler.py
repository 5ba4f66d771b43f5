"""Epoch assembly: oracles are the messages that went in, counted by hand, and two recordings' known epoch counts."""

import pickle
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.epochs.assembler import EpochAssembler
from plumbline.gps_time import NS_PER_MS, NS_PER_S, gps_ns, gps_ns_from_utc
from plumbline.records import UNKNOWN_CHANNEL, Epoch
from plumbline.rtcm3 import MsmHeader, Observations, decode, encode_observations, scan_frames
from plumbline.signals import System, satellite_id, signal_id

T0 = gps_ns(2400, 100_000)
DEADLINE = 800 * NS_PER_MS


def msm(system: System, t_gps_ns: int, more: bool, numbers: tuple[int, ...] = (1, 2), code: str = "1C") -> Observations:
    """A real MSM7 message, encoded and decoded."""
    tow_ms = t_gps_ns // NS_PER_MS % (7 * 86_400_000)
    if system is System.BEIDOU:
        tow_ms -= 14_000
    satellites = np.array([satellite_id(system, n) for n in numbers], np.int16)
    signal = signal_id(system, code)
    assert signal is not None
    signals = np.full(len(numbers), signal, np.int16)
    row = np.full(len(numbers), 22_000_000.0)
    channel = np.zeros(len(numbers), np.int8)
    header = MsmHeader(system, 7, 5, tow_ms, multiple_message=more)
    (payload,) = encode_observations(
        header, satellites, signals, row, row, row * 0, row * 0 + 45, row * 0, row > 0, channel
    )
    message = decode(payload)
    assert isinstance(message, Observations)
    return message


def feed(assembler: EpochAssembler, *items: tuple[Observations, int, int]) -> list[Epoch]:
    return [epoch for message, t, received in items for epoch in assembler.receive(message, t, received)]


def second(k: int, *systems: tuple[System, bool], delay_ns: int = 0) -> Iterator[tuple[Observations, int, int]]:
    """One second's messages, all received ``delay_ns`` after their epoch."""
    t = T0 + k * NS_PER_S
    for system, more in systems:
        yield msm(system, t, more, code="2I" if system is System.BEIDOU else "1C"), t, t + delay_ns


GPS_GAL = ((System.GPS, True), (System.GALILEO, False))


def test_complete_epochs_leave_at_once_and_rows_are_sorted() -> None:
    epochs = feed(EpochAssembler(DEADLINE), *second(0, *reversed(GPS_GAL)), *second(1, *GPS_GAL))
    assert [e.t_gps_ns for e in epochs] == [T0, T0 + NS_PER_S]
    second_epoch = epochs[1]
    key = second_epoch.satellite.astype(int) * 1000 + second_epoch.signal
    assert (np.diff(key) > 0).all()
    assert second_epoch.satellite.size == 4


def test_a_bit_that_ends_the_epoch_too_early_costs_no_constellation() -> None:
    """The bit says 'last' on GPS although Galileo follows: after the first epoch that is known."""
    wrong = ((System.GPS, False), (System.GALILEO, False))
    assembler = EpochAssembler(DEADLINE)
    epochs = feed(assembler, *(item for k in range(4) for item in second(k, *wrong)))
    assert [e.satellite.size for e in epochs] == [2, 4, 4, 4]
    assert assembler.counters == {"late_message": 1}


def test_a_bit_that_never_clears_does_not_hold_an_epoch() -> None:
    never = ((System.GPS, True), (System.GALILEO, True))
    assembler = EpochAssembler(DEADLINE)
    epochs = feed(assembler, *(item for k in range(4) for item in second(k, *never)))
    # The first epoch must wait for its deadline, since nothing says that it is complete; the later ones need not.
    assert [e.t_gps_ns for e in epochs] == [T0 + k * NS_PER_S for k in range(4)]
    assert all(e.satellite.size == 4 for e in epochs)
    assert assembler.advance(T0 + 60 * NS_PER_S) == []


def test_a_missing_constellation_closes_at_the_deadline_and_is_counted() -> None:
    assembler = EpochAssembler(DEADLINE)
    feed(assembler, *second(0, *GPS_GAL), *second(1, *GPS_GAL))
    assert feed(assembler, *second(2, (System.GPS, True))) == []
    assert assembler.advance(T0 + 2 * NS_PER_S + DEADLINE - 1) == []
    (epoch,) = assembler.advance(T0 + 2 * NS_PER_S + DEADLINE)
    assert epoch.satellite.size == 2
    assert assembler.counters == {"deadline_without_1097": 1}


def test_a_tick_changes_when_an_epoch_leaves_and_not_what_is_in_it() -> None:
    items = [*second(0, *GPS_GAL), *second(1, (System.GPS, True)), *second(2, *GPS_GAL)]
    with_ticks, without = EpochAssembler(DEADLINE), EpochAssembler(DEADLINE)
    ticked = []
    for item in items:
        ticked += with_ticks.advance(item[2] - 1) + with_ticks.receive(*item)
    plain = feed(without, *items)
    assert [(e.t_gps_ns, e.t_receive_ns, e.satellite.tolist()) for e in ticked] == [
        (e.t_gps_ns, e.t_receive_ns, e.satellite.tolist()) for e in plain
    ]


def test_repeated_and_old_messages_are_counted_and_not_used() -> None:
    assembler = EpochAssembler(DEADLINE)
    once = list(second(0, *GPS_GAL))
    epochs = feed(assembler, *once, *once, *second(1, *GPS_GAL), *once)
    assert len(epochs) == 2
    assert assembler.counters == {"late_message": 2, "out_of_order_message": 2}


def test_a_constellation_in_two_messages_is_one_epoch() -> None:
    t = T0
    first, rest = msm(System.GPS, t, True, (1, 2)), msm(System.GPS, t, False, (3, 4))
    (epoch,) = feed(EpochAssembler(DEADLINE), (first, t, t), (rest, t, t))
    assert [s % 64 + 1 for s in epoch.satellite] == [1, 2, 3, 4]


def test_a_constellation_that_fits_one_message_again_does_not_wait_for_a_second() -> None:
    assembler = EpochAssembler(DEADLINE)
    t = T0
    parts = [(msm(System.GPS, t, True, (1, 2)), t, t), (msm(System.GPS, t, True, (3,)), t, t)]
    feed(assembler, *parts, (msm(System.GALILEO, t, False), t, t))
    assert [e.satellite.size for e in feed(assembler, *second(1, *GPS_GAL))] == [4]
    assert not assembler.counters


def test_one_broken_clock_field_leaves_no_mark() -> None:
    assembler = EpochAssembler(DEADLINE)
    broken = (msm(System.BEIDOU, T0, True, code="2I"), T0 + 40_000 * NS_PER_S, T0 + 3 * NS_PER_S)
    items = [*second(0, *GPS_GAL), *second(1, *GPS_GAL), broken, *second(2, *GPS_GAL), *second(3, *GPS_GAL)]
    epochs = feed(assembler, *items)
    assert [e.t_gps_ns for e in epochs] == [T0 + k * NS_PER_S for k in range(4)]
    assert assembler.counters == {"implausible_epoch_time": 1}


def test_a_real_jump_is_followed_from_its_first_epoch_on() -> None:
    epochs = feed(EpochAssembler(DEADLINE), *second(0, *GPS_GAL), *second(5000, *GPS_GAL), *second(5001, *GPS_GAL))
    assert [(e.t_gps_ns - T0) // NS_PER_S for e in epochs] == [0, 5000, 5001]


def test_glonass_phase_needs_a_channel_and_remembers_it() -> None:
    assembler = EpochAssembler(DEADLINE)
    satellite = satellite_id(System.GLONASS, 3)
    signal = signal_id(System.GLONASS, "1C")
    rows = np.array([22e6])
    payloads = encode_observations(
        MsmHeader(System.GLONASS, 4, 5, 0, day_of_week=1),
        np.array([satellite], np.int16), np.array([signal], np.int16),
        rows, rows, rows * 0, rows * 0 + 40, rows * 0, rows < 0, np.zeros(1, np.int8),
    )  # fmt: skip
    message = decode(payloads[0])
    assert isinstance(message, Observations)
    (before,) = assembler.receive(message, T0, T0)
    assert before.glonass_channel.tolist() == [UNKNOWN_CHANNEL]
    assert np.isnan(before.carrier_phase_cycles).all()
    assert before.pseudorange_m[0] == pytest.approx(22e6)
    assembler.learn_channel(satellite, -4)
    (after,) = assembler.receive(message, T0 + NS_PER_S, T0 + NS_PER_S)
    frequency_hz = 1602e6 - 4 * 0.5625e6
    assert after.carrier_phase_cycles[0] == pytest.approx(message.phase_range_m[0] * frequency_hz / SPEED_OF_LIGHT_M_S)


def test_pickled_in_the_middle_it_carries_on() -> None:
    items = [item for k in range(3) for item in second(k, *GPS_GAL)]
    assembler = EpochAssembler(DEADLINE)
    before = feed(assembler, *items[:3])
    after = feed(pickle.loads(pickle.dumps(assembler)), *items[3:])
    assert [e.t_gps_ns for e in before + after] == [T0 + k * NS_PER_S for k in range(3)]


@pytest.mark.realdata
@pytest.mark.parametrize(("name", "first", "count"), [("STR17", "23:50:00", 1126), ("STR24", "23:49:51", 1134)])
def test_week_crossing_and_broken_epoch_of_a_real_receiver(data_dir: Path, name: str, first: str, count: int) -> None:
    """Every second once, from the first to the last, across the end of the GPS week."""
    path = data_dir / "str-2018-195" / f"week-rollover-{name}.rtcm3"
    near = gps_ns_from_utc(datetime(2018, 7, 15, tzinfo=UTC))
    assembler, epochs, received = EpochAssembler(DEADLINE), [], 0
    for frame in scan_frames(path.read_bytes()).frames:
        message = decode(frame.payload)
        if isinstance(message, Observations):
            t = message.t_gps_ns(near)
            received = max(received, t) if abs(t - near) < 3600 * NS_PER_S else received
            epochs += assembler.receive(message, t, received)
    epochs += assembler.flush()
    start = gps_ns_from_utc(datetime.fromisoformat(f"2018-07-14T{first}+00:00"))
    assert [e.t_gps_ns for e in epochs] == [start + k * NS_PER_S for k in range(count)]
