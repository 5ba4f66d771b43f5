"""Critical values and non-centrality of the tests (Baarda 1968; Teunissen 2006, *Testing theory*, ch. 3-4).

The w-test's significance α and power γ fix the non-centrality λ₀ = (N_{1−α/2} + N_γ)², the size of an error in sigmas
that is found with the power. An alternative of q dimensions is tested at the significance whose power for the same λ₀
is the same (the B-method), so that alternatives of different dimensions compete fairly: by their test ratio, the
statistic over its critical value (de Heus, Joosten, Martens & Verhoef 1994).
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2, f, ncx2, norm

from plumbline.errors import ConfigurationError
from plumbline.records import Floats

MOST_DIMENSIONS: Final = 3
_EXCESS_STEP: Final = 0.01  # tables are kept at multiples


@dataclass(frozen=True, slots=True)
class Levels:
    """Significance and power of the tests; Lee 2016, 3.1.3, for the first two."""

    significance: float = 0.05  # of the global test, familywise
    power: float = 0.80
    w_significance: float = 0.001

    def __post_init__(self) -> None:
        for value in (self.significance, self.power, self.w_significance):
            if not 0.0 < value < 1.0:
                raise ConfigurationError(f"a probability lies between 0 and 1, not at {value}")


@lru_cache(maxsize=64)
def noncentrality(levels: Levels) -> float:
    """λ₀ of the w-test, (N_{1−α/2} + N_γ)² (the power of the far tail, below 1e-4 of it, left out)."""
    return float((norm.ppf(1.0 - 0.5 * levels.w_significance) + norm.ppf(levels.power)) ** 2)


@lru_cache(maxsize=64)
def w_critical(levels: Levels) -> float:
    """Critical value of |w|."""
    return float(norm.ppf(1.0 - 0.5 * levels.w_significance))


@lru_cache(maxsize=4096)
def global_critical(levels: Levels, degrees_of_freedom: int) -> float:
    """Critical value of the global test, χ²_{1−α}(r); no test has no redundancy: infinity."""
    return float(chi2.ppf(1.0 - levels.significance, degrees_of_freedom)) if degrees_of_freedom > 0 else float("inf")


def global_critical_of_ratio(levels: Levels, degrees_of_freedom: int, excess: float) -> float:
    """The same where the variance factor is estimated and does not stay the same: r·F_{1−α}(r, ν)/E[F].

    Coloured errors, and variances that differ from satellite to satellite and hour to hour, let a share of the
    statistic, ``T/(r σ̂²)``, vary by more than χ²'s 2/r; ``excess`` is by how much. The F distribution of that variance
    has ``ν = 4 + (2 r + 4)/(r · excess)``; without excess it is χ²/r (Koch 1999, *Parameter Estimation and Hypothesis
    Testing*, 2.6.4 and 4.2.1).
    """
    step = round(excess / _EXCESS_STEP)
    return (
        _ratio_critical(levels, degrees_of_freedom, step) if step > 0 else global_critical(levels, degrees_of_freedom)
    )


@lru_cache(maxsize=4096)
def _ratio_critical(levels: Levels, degrees_of_freedom: int, step: int) -> float:
    if degrees_of_freedom <= 0:
        return float("inf")
    r = degrees_of_freedom
    spread = 4.0 + (2.0 * r + 4.0) / (r * step * _EXCESS_STEP)
    return float(r * f.ppf(1.0 - levels.significance, r, spread) * (spread - 2.0) / spread)


@lru_cache(maxsize=64)
def alternative_critical(levels: Levels) -> Floats:
    """Critical values (MOST_DIMENSIONS + 1,) of alternatives by dimension, the B-method's; index 0 is not used."""
    strength = noncentrality(levels)
    values = np.zeros(MOST_DIMENSIONS + 1)
    values[1] = w_critical(levels) ** 2
    for q in range(2, MOST_DIMENSIONS + 1):
        values[q] = brentq(lambda k, q=q: ncx2.sf(k, q, strength) - levels.power, 1e-6, 10.0 * strength)
    values.flags.writeable = False
    return values


@lru_cache(maxsize=256)
def missed_detection_factor(levels: Levels, missed: float) -> float:
    """An error of this many sigmas of its estimate is missed by the w-test with the probability given."""
    return float(w_critical(levels) + norm.ppf(1.0 - missed))
