"""How a sensor is mounted, from the motion that it and GNSS both saw. It is offered; nobody applies it unasked.

In the band where both see the motion, the specific force less its mean, integrated twice, is the displacement turned
into the sensor's axes. The rotation is the one that fits best (Wahba 1965, by singular values); its uncertainty and the
share of motion explained say whether to believe it.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from plumbline.errors import ContractError
from plumbline.records import Floats, Ints

_EDGE: Final = 0.1  # of the record, at each end, not used: the filters' own transients
_LEAST_SAMPLES: Final = 32


@dataclass(frozen=True, slots=True)
class Mounting:
    """A proposal."""

    rotation_enu_from_sensor: Floats  # (3, 3), by all three axes
    angle_about_up_rad: float  # the sensor turned about the vertical alone: E' = E cos + N sin
    sigma_about_up_rad: float
    explained: float  # share of the displacement's variance in the band, with the rotation about up
    explained_unturned: float  # the same without any rotation
    rms_m: float  # of the displacement in the band

    def describe(self) -> str:
        """In words that ask for a decision."""
        angle, sigma = math.degrees(self.angle_about_up_rad), math.degrees(self.sigma_about_up_rad)
        return (
            f"the sensor seems to be turned by {angle:.1f}° ± {sigma:.1f}° about the vertical: that explains "
            f"{self.explained:.1%} of {1e3 * self.rms_m:.1f} mm of common motion, {self.explained_unturned:.1%} without"
            f"; to accept it, give --rotation-deg={angle:.1f}"
        )


def mounting_of(
    t_gnss_ns: Ints,
    displacement_enu_m: Floats,
    t_first_ns: int,
    interval_ns: int,
    force_m_s2: Floats,
    band_hz: tuple[float, float],
) -> Mounting:
    """Compare displacements (n, 3) at even times (n,) with samples (m, 3) in a band that both resolve.

    Raises ContractError for a band beyond GNSS's Nyquist frequency, or too little in common.
    """
    step_s = float(np.median(np.diff(t_gnss_ns))) * 1e-9
    if not 0.0 < band_hz[0] < band_hz[1] <= 0.5 / step_s:
        raise ContractError(f"the band must lie below {0.5 / step_s:g} Hz")
    usable = np.asarray(np.isfinite(force_m_s2).all(axis=1), np.bool_)
    force = np.where(usable[:, None], force_m_s2, np.nanmean(force_m_s2, axis=0))
    t_force_s = (t_first_ns - int(t_gnss_ns[0]) + interval_ns * np.arange(len(force))) * 1e-9
    inertial = _band(force - force.mean(axis=0), interval_ns * 1e-9, band_hz, integrate=True)
    gnss = _band(displacement_enu_m - np.nanmean(displacement_enu_m, axis=0), step_s, band_hz, integrate=False)
    t_s = (t_gnss_ns - t_gnss_ns[0]) * 1e-9
    begin, end = max(t_s[0], t_force_s[0]), min(t_s[-1], t_force_s[-1])
    margin = _EDGE * (end - begin)
    common = (t_s > begin + margin) & (t_s < end - margin)
    if common.sum() < _LEAST_SAMPLES:
        raise ContractError("the sensor and GNSS have too little time in common")
    sensor = np.column_stack([np.interp(t_s[common], t_force_s, axis) for axis in inertial.T])
    return _fitted(gnss[common], sensor)


def _band(values: Floats, step_s: float, band_hz: tuple[float, float], *, integrate: bool) -> Floats:
    """Values (n, 3) between two frequencies, with smooth edges; accelerations integrated twice on the way."""
    filled = np.nan_to_num(values) * np.hanning(len(values))[:, None] ** 0.1
    spectrum = np.fft.rfft(filled, axis=0)
    frequency = np.fft.rfftfreq(len(values), step_s)
    gain = 1.0 / (1.0 + (band_hz[0] / np.maximum(frequency, 1e-12)) ** 8) / (1.0 + (frequency / band_hz[1]) ** 8)
    if integrate:
        gain = gain / -np.square(2.0 * np.pi * np.maximum(frequency, 1e-12))
    gain[0] = 0.0
    out: Floats = np.fft.irfft(spectrum * gain[:, None], n=len(values), axis=0)
    return out


def _fitted(gnss: Floats, sensor: Floats) -> Mounting:
    u, _, vt = np.linalg.svd(gnss.T @ sensor)
    rotation: Floats = u @ np.diag([1.0, 1.0, float(np.linalg.det(u @ vt))]) @ vt
    flat, seen = sensor[:, 0] + 1j * sensor[:, 1], gnss[:, 0] + 1j * gnss[:, 1]
    product = complex(np.sum(seen * np.conj(flat)))
    turn = product / abs(product) if product else 1.0 + 0.0j
    power, total = float(np.sum(np.abs(flat) ** 2)), float(np.sum(np.abs(seen) ** 2))
    left, unturned = float(np.sum(np.abs(seen - turn * flat) ** 2)), float(np.sum(np.abs(seen - flat) ** 2))
    return Mounting(
        rotation_enu_from_sensor=rotation,
        angle_about_up_rad=-math.atan2(turn.imag, turn.real),
        sigma_about_up_rad=math.sqrt(left / max(len(seen) - 1, 1) / max(power, 1e-30)),
        explained=1.0 - left / max(total, 1e-30),
        explained_unturned=1.0 - unturned / max(total, 1e-30),
        rms_m=math.sqrt(total / len(seen)),
    )
