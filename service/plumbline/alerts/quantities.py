"""What a threshold can be set on, and its value in a block of motion.

A block's value is its peak: the largest absolute value of its samples. A sway crosses zero twice a period, so delays
are counted in blocks whose peak exceeds, not in samples.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from plumbline.records import Floats, Motion

RATE_WINDOW_S: Final = 60.0  # displacement rates: slope of the blocks' means over this long

_COMPONENTS: Final[dict[str, tuple[int, ...]]] = {
    "east": (0,),
    "north": (1,),
    "up": (2,),
    "horizontal": (0, 1),
    "3d": (0, 1, 2),
}
_FIELDS: Final[dict[str, Callable[[Motion], Floats]]] = {
    "displacement": lambda motion: motion.displacement_enu_m,
    "velocity": lambda motion: motion.velocity_enu_m_s,
    "acceleration": lambda motion: motion.acceleration_enu_m_s2,
}
RATE: Final = "displacement_rate"
DATA_GAP: Final = "data_gap"  # seconds without a decoded epoch
SOLUTION_AGE: Final = "solution_age"  # seconds since the last solution with a position
HEALTH: Final = (DATA_GAP, SOLUTION_AGE)
CONTRADICTED: Final = "contradicted_displacement"  # metres that a witness contradicts; raised without a threshold set

QUANTITIES: Final[dict[str, str]] = {
    **{f"displacement_{c}": "m" for c in _COMPONENTS},
    **{f"velocity_{c}": "m/s" for c in _COMPONENTS},
    **{f"acceleration_{c}": "m/s²" for c in _COMPONENTS},
    **{f"{RATE}_{c}": "m/s" for c in _COMPONENTS},
    DATA_GAP: "s",
    SOLUTION_AGE: "s",
}
#: Units of the quantities that data alerts are raised on: what thresholds can be set on, and what cannot.
DATA_QUANTITIES: Final[dict[str, str]] = {DATA_GAP: "s", SOLUTION_AGE: "s", CONTRADICTED: "m"}


def unit_of(quantity: str) -> str:
    """The SI unit of a quantity; empty for an unknown one."""
    return QUANTITIES.get(quantity, DATA_QUANTITIES.get(quantity, ""))


def in_words(quantity: str, value: float) -> str:
    """A value as an alert's text gives it: lengths in millimetres, three digits, with its unit."""
    unit = unit_of(quantity)
    if unit.startswith("m"):
        value, unit = value * 1e3, f"m{unit}"
    return f"{value:.3g} {unit}" if abs(value) < 1000 else f"{value:.0f} {unit}"


def name_in_words(quantity: str) -> str:
    """``displacement_horizontal`` as "horizontal displacement"."""
    name, _, component = quantity.rpartition("_")
    return f"{component} {name.replace('_', ' ')}" if component in _COMPONENTS else quantity.replace("_", " ")


@dataclass(frozen=True, slots=True)
class BlockValues:
    """A quantity's samples in a block, absolute, and the one-sigma uncertainty of its value."""

    values: Floats  # (n,)
    sigma: float


def needs_gnss(quantity: str) -> bool:
    """Whether a quantity means nothing while the displacement is bad; an acceleration is the sensor's own."""
    return not quantity.startswith("acceleration")


def block_values(quantity: str, motion: Motion) -> BlockValues:
    """Absolute samples of a displacement, velocity or acceleration. A velocity's and an acceleration's sigma is taken
    as 0.
    """
    name, _, component = quantity.partition("_")
    columns = list(_COMPONENTS[component])
    values = np.linalg.norm(_FIELDS[name](motion)[:, columns], axis=1)
    sigma = float(np.linalg.norm(motion.sigma_displacement_enu_m[-1, columns])) if name == "displacement" else 0.0
    return BlockValues(values, sigma)


def rate_value(quantity: str, t_s: Floats, means_enu_m: Floats) -> float:
    """Absolute slope, m/s, of block means (n, 3) at times (n,) s by least squares; NaN before half a window is
    filled.
    """
    if len(t_s) < 3 or t_s[-1] - t_s[0] < 0.5 * RATE_WINDOW_S:
        return float("nan")
    centred = t_s - t_s.mean()
    slope = centred @ (means_enu_m - means_enu_m.mean(axis=0)) / (centred @ centred)
    columns = list(_COMPONENTS[quantity.removeprefix(RATE + "_")])
    return float(np.linalg.norm(slope[columns]))
