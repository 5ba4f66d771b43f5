"""An IMU's samples on the common time line. Oracle: the function that they were sampled from."""

import numpy as np

from plumbline.config import InertialSettings
from plumbline.gps_time import NS_PER_S
from plumbline.modes.samples import ImuSamples
from plumbline.records import Floats, InertialBlock

T0 = 1_384_000_000 * NS_PER_S
TURN = ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))


def signal(t_s: Floats) -> Floats:
    """Six channels of a smooth motion."""
    return np.column_stack([np.sin(2.0 * np.pi * 0.5 * t_s + k) for k in range(6)])


def block(t_first_ns: int, n: int, interval_ns: int, sensor: int = 0) -> InertialBlock:
    t_ns = t_first_ns + interval_ns * np.arange(n)
    values = signal((t_ns - T0) * 1e-9)
    return InertialBlock(t_first_ns, int(t_ns[-1]), interval_ns, values[:, :3], values[:, 3:], sensor)


def test_stamps_off_the_grid_are_brought_onto_it_with_both_kinds_and_the_offset() -> None:
    samples = ImuSamples()
    settings = InertialSettings(rotation_body_from_sensor=TURN, inertial_time_offset_s=0.25)
    times, values = [], []
    for k in range(10):
        taken = samples.receive(block(T0 + 3_300_000 + k * NS_PER_S, 100, 10_000_000), settings)
        assert taken is not None
        times.append(taken[0])
        values.append(taken[1])
    t_ns, x = np.concatenate(times), np.concatenate(values)
    assert (t_ns % 10_000_000 == 0).all()
    assert (np.diff(t_ns) == 10_000_000).all()
    wanted = signal((t_ns - T0) * 1e-9 - 0.25)
    turn = np.array(TURN)
    assert np.allclose(x, np.hstack([wanted[:, :3] @ turn.T, wanted[:, 3:] @ turn.T]), atol=2e-7)


def test_what_cannot_be_used_is_counted() -> None:
    samples, settings = ImuSamples(), InertialSettings()
    assert samples.receive(block(T0, 10, 10_000_000), settings) is not None
    assert samples.receive(block(T0 + NS_PER_S, 10, 10_000_000, sensor=2), settings) is None
    lone = block(T0 + NS_PER_S, 10, 10_000_000)
    no_rates = InertialBlock(lone.t_first_gps_ns, lone.t_receive_ns, lone.interval_ns, lone.specific_force_m_s2)
    assert samples.receive(no_rates, settings) is None
    assert samples.counters == {"inertial_of_another_sensor": 1, "inertial_without_angular_rates": 1}


def test_a_late_delivery_is_no_break_and_a_leap_of_the_stamps_is() -> None:
    samples, settings = ImuSamples(), InertialSettings()
    samples.receive(block(T0, 100, 10_000_000), settings)
    assert samples.silent_s(T0 + 31 * NS_PER_S) is not None
    assert not samples.breaks_off(block(T0 + NS_PER_S, 100, 10_000_000))
    assert samples.breaks_off(block(T0 + 90 * NS_PER_S, 100, 10_000_000))
    assert samples.breaks_off(block(T0 - 90 * NS_PER_S, 100, 10_000_000))
