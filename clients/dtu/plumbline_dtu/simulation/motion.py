"""Known motions: displacement, velocity and acceleration as functions of time, east, north, up."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline

from plumbline.errors import ConfigurationError
from plumbline.files.seismic import Series, read_components
from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, Ints

_AXES = {"e": 0, "n": 1, "u": 2}


@dataclass(frozen=True, slots=True)
class State:
    """Motion at given times: all (n, 3), ENU."""

    displacement_m: Floats
    velocity_m_s: Floats
    acceleration_m_s2: Floats


#: GPS times (n,), ns → motion.
Motion = Callable[[Ints], State]


def static() -> Motion:
    """No motion."""
    return sines(())


@dataclass(frozen=True, slots=True)
class Sine:
    """One sine: axis 0…2, amplitude, frequency, phase at the GPS week's start."""

    axis: int
    amplitude_m: float
    frequency_hz: float
    phase_rad: float = 0.0


def sines(parts: Sequence[Sine]) -> Motion:
    """A sum of sines."""

    def motion(t_gps_ns: Ints) -> State:
        out = np.zeros((3, len(t_gps_ns), 3))
        t_s = (t_gps_ns % (86_400 * NS_PER_S)) / NS_PER_S
        for sine in parts:
            omega = 2.0 * math.pi * sine.frequency_hz
            phase = omega * t_s + sine.phase_rad
            out[0, :, sine.axis] += sine.amplitude_m * np.sin(phase)
            out[1, :, sine.axis] += sine.amplitude_m * omega * np.cos(phase)
            out[2, :, sine.axis] -= sine.amplitude_m * omega * omega * np.sin(phase)
        return State(*out)

    return motion


def bursts(part: Sine, every_s: float, lasting_s: float) -> Motion:
    """A sine that swells and fades (a squared sine of the time) for ``lasting_s`` at every full ``every_s``."""

    def motion(t_gps_ns: Ints) -> State:
        t_s = (t_gps_ns % round(every_s * NS_PER_S)) / NS_PER_S
        a, w = math.pi / lasting_s, 2.0 * math.pi * part.frequency_hz
        inside = t_s < lasting_s
        envelope = np.where(inside, np.sin(a * t_s) ** 2, 0.0)
        slope = np.where(inside, a * np.sin(2.0 * a * t_s), 0.0)
        bend = np.where(inside, 2.0 * a * a * np.cos(2.0 * a * t_s), 0.0)
        carrier, quadrature = np.sin(w * t_s + part.phase_rad), np.cos(w * t_s + part.phase_rad)
        out = np.zeros((3, len(t_gps_ns), 3))
        out[0, :, part.axis] = envelope * carrier
        out[1, :, part.axis] = slope * carrier + envelope * w * quadrature
        out[2, :, part.axis] = bend * carrier + 2.0 * slope * w * quadrature - envelope * w * w * carrier
        return State(*(part.amplitude_m * out))

    return motion


def steps(step_enu_m: tuple[float, float, float], t_step_gps_ns: int, rise_s: float = 2.0) -> Motion:
    """From rest to a new rest: a fifth-order polynomial (velocity and acceleration zero at both ends) in ``rise_s``."""

    def motion(t_gps_ns: Ints) -> State:
        x = np.clip((t_gps_ns - t_step_gps_ns) / (rise_s * NS_PER_S), 0.0, 1.0)
        shape = x**3 * (10.0 - 15.0 * x + 6.0 * x * x)
        slope = 30.0 * x * x * (1.0 - x) ** 2 / rise_s
        bend = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / rise_s**2
        return State(*(np.outer(factor, step_enu_m) for factor in (shape, slope, bend)))

    return motion


def record(series: Series, t_start_gps_ns: int) -> Motion:
    """A recorded displacement, or an acceleration integrated twice, played from ``t_start_gps_ns``; before and after it
    rests.

    Acceleration has its trend removed, and the displacement's drift (a parabola) with it.
    """
    from scipy.signal import detrend  # here: it takes seconds to load, and a replay does without

    values = np.nan_to_num(series.values[:, :3])
    t_s = np.arange(len(values)) * (series.interval_ns / NS_PER_S)
    if series.unit == "m/s2":
        velocity = detrend(cumulative_trapezoid(detrend(values, axis=0), t_s, axis=0, initial=0), axis=0)
        values = detrend(cumulative_trapezoid(velocity, t_s, axis=0, initial=0), axis=0)
    values = values - values[0]
    spline = CubicSpline(t_s, values, bc_type="clamped")

    def motion(t_gps_ns: Ints) -> State:
        at_s = (t_gps_ns - t_start_gps_ns) / NS_PER_S
        inside = ((at_s >= 0.0) & (at_s <= t_s[-1]))[:, None]
        held = np.clip(at_s, 0.0, t_s[-1])
        return State(spline(held), np.where(inside, spline(held, 1), 0.0), np.where(inside, spline(held, 2), 0.0))

    return motion


def parse_motion(text: str, t_start_gps_ns: int) -> Motion:
    """A motion of the command line; raises ConfigurationError.

    ``static`` · ``sine:AXIS,AMPLITUDE_M,HZ[;AXIS,…]`` · ``burst:AXIS,AMPLITUDE_M,HZ,EVERY_S,LASTING_S`` ·
    ``step:E,N,U@SECONDS`` · ``file:PATH[,PATH,PATH][@SECONDS]`` (SAC, MiniSEED or CSV; seconds after the start).
    """
    kind, _, rest = text.partition(":")
    try:
        if kind == "static":
            return static()
        if kind == "sine":
            return sines([_sine(part.split(",")) for part in rest.split(";")])
        if kind == "burst":
            *sine, every, lasting = rest.split(",")
            return bursts(_sine(sine), float(every), float(lasting))
        what, _, seconds = rest.partition("@")
        t_ns = t_start_gps_ns + round(float(seconds or 0.0) * NS_PER_S)
        if kind == "step":
            east, north, up = (float(part) for part in what.split(","))
            return steps((east, north, up), t_ns)
        if kind == "file":
            return record(read_components([Path(part) for part in what.split(",")]), t_ns)
    except (ValueError, KeyError, IndexError) as error:
        raise ConfigurationError(f"motion {text!r}: {error}") from error
    raise ConfigurationError(f"motion {text!r}: none of static, sine, burst, step, file")


def _sine(parts: Sequence[str]) -> Sine:
    axis, amplitude, frequency, *phase = parts
    return Sine(_AXES[axis.strip().lower()], float(amplitude), float(frequency), float(phase[0]) if phase else 0.0)
