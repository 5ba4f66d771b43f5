"""Several antennas on a moving platform, and what single differences to a base say of them."""

import numpy as np

from plumbline.config import InertialSettings
from plumbline.constants import EARTH_ROTATION_RATE_RAD_S
from plumbline.fusion.tight_observations import ANTENNA_KEY, SIGNAL_KEY, TightEpoch
from plumbline.records import Floats

ARMS = ((0.0, 0.577, 0.1), (-0.5, -0.289, 0.1), (0.5, -0.289, 0.1))
WAVELENGTH = 0.19029367


def sky(rng: np.random.Generator, n: int, up: Floats) -> Floats:
    """Unit vectors (n, 3) above 15° of elevation, Earth-fixed."""
    out = []
    while len(out) < n:
        e = rng.normal(size=3)
        e /= np.linalg.norm(e)
        if e @ up > 0.26:
            out.append(e)
    return np.array(out)


def antenna_state(nav: Floats, rate: Floats, arm: Floats) -> tuple[Floats, Floats]:
    """Position and velocity (3,) of an antenna, by differentiation of r + C l."""
    rotation, earth = nav[6:15].reshape(3, 3), np.array([0.0, 0.0, EARTH_ROTATION_RATE_RAD_S])
    turned = rotation @ arm
    return nav[0:3] + turned, nav[3:6] + rotation @ np.cross(rate, arm) - np.cross(earth, turned)


class Scene:
    """Constant directions, ambiguities and noise; the noise of the base is common to the antennas."""

    def __init__(self, seed: int, n_satellites: int, up: Floats, settings: InertialSettings, origin: Floats) -> None:
        self.rng = np.random.default_rng(seed)
        self.lines = sky(self.rng, n_satellites, up)
        self.arms = np.array(settings.lever_arms_body_m)
        self.origin = origin
        n = len(self.arms)
        self.integers = self.rng.integers(-50, 50, size=(n, n_satellites))
        self.sine = self.lines @ up
        self.sigmas = np.array([0.003, 0.4, 0.03])  # single difference: phase, code, range rate

    def epoch(self, t_ns: int, nav: Floats, rate: Floats, antennas: tuple[int, ...], codes: bool = True) -> TightEpoch:
        """What the antennas measure of a true state (Earth-fixed) with the true rate."""
        m = len(self.lines)
        phases, codes_m, rates = [], [], []
        share = np.sqrt(0.5)
        base = self.rng.normal(size=(m, 3)) * self.sigmas * share
        for a in antennas:
            place, speed = antenna_state(nav, rate, self.arms[a])
            z, dz = -self.lines @ (place - self.origin[a]), -self.lines @ speed
            noise = base + self.rng.normal(size=(m, 3)) * self.sigmas * share
            clock, drift = self.rng.normal(size=2) * [30.0, 5.0]
            phases.append(z + clock + WAVELENGTH * self.integers[a] + noise[:, 0])
            codes_m.append(z + clock + noise[:, 1])
            rates.append(dz + drift + noise[:, 2])
        antenna = np.repeat(np.array(antennas, np.int64), m)
        satellite = np.tile(np.arange(m, dtype=np.int64), len(antennas))
        return TightEpoch(
            t_ns, antenna, antenna * ANTENNA_KEY + satellite * SIGNAL_KEY + 1, antenna * ANTENNA_KEY + SIGNAL_KEY + 1,
            satellite * SIGNAL_KEY + 1, np.full(antenna.size, WAVELENGTH), np.tile(self.lines, (len(antennas), 1)),
            np.tile(self.sine, len(antennas)), np.concatenate(phases),
            np.concatenate(codes_m) if codes else np.full(antenna.size, np.nan), np.concatenate(rates),
            np.tile(self.sigmas**2, (antenna.size, 1)), np.ones(antenna.size, np.bool_),
            np.zeros(antenna.size, np.bool_), np.full(antenna.size, np.nan), self.origin,
        )  # fmt: skip
