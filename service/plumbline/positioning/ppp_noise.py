"""How well each code and phase is believed.

Elevation: σ = σ₀ / sin(elevation), σ₀ per signal, times the combination's factor √(α² + β²).

Code: white noise and, for ever the same, what is left of satellite, receiver and multipath bias. A filter that took
both for white would trust the mean of a thousand codes to a centimetre. Here the codes of one arc carry as much
information as a mean with a constant bias does, ``I = 1 / (1/Σσ⁻² + σ_b²)``, and an epoch enters with what it adds to
``I``: the estimate that a bias state a satellite would give for a constant ambiguity, without the state. Multipath
stays alike for half a minute, so that faster rates do not add information.

Phase: white noise; the slow part of orbit, clock and multipath errors is the ambiguities' random walk.
"""

from typing import Final, NamedTuple

import numpy as np
from numba import njit

from plumbline.config import AntennaMotion, PositioningSettings
from plumbline.estimation.dia_tables import Levels, alternative_critical
from plumbline.positioning.state import Records
from plumbline.records import Floats, Ints
from plumbline.signals import System

_GLONASS: Final = int(System.GLONASS)
_GALILEO: Final = int(System.GALILEO)
_BEIDOU: Final = int(System.BEIDOU)
_SBAS: Final = int(System.SBAS)
_LOWEST_SINE: Final = 0.03
_NORMAL_MEDIAN: Final = 0.6745  # median of a standard normal's absolute value
_CHANCE: Final = 1.3  # the median of a dozen and a half draws is larger by that only now and then


class Tuning(NamedTuple):
    """Noise of the filter in the kernels' form: metres and seconds, one sigma."""

    code_sigma_m: float
    phase_sigma_m: float
    position_m_sqrt_s: float
    position_jump_m: float  # a kinematic antenna may be this far from where it was, whatever the interval
    zenith_delay_m_sqrt_s: float
    gradient_m_sqrt_s: float
    common_clock_m: float  # the receiver clock after the codes have foretold it
    system_clock_m_sqrt_s: float  # walk of one system's clock against the others'
    ambiguity_m_sqrt_s: float  # for the gains
    ambiguity_error_m_sqrt_s: float  # for the errors that these leave
    gps_bias_m: float  # what is left of a code whose bias is known, ionosphere-free
    galileo_bias_m: float
    unknown_bias_m: float
    glonass_bias_m: float  # inter-channel biases
    beidou_bias_m: float
    code_correlation_s: float  # multipath: codes closer than this say the same
    geo_factor: float  # sigma of BeiDou's geostationary satellites
    critical: float  # χ² that an error of one observation must exceed
    critical_move: float  # … and a jump of the position


def levels_of(settings: PositioningSettings) -> Levels:
    """Significance and power of the tests."""
    return Levels(settings.test_significance, settings.test_power, settings.w_test_significance)


def tuning_of(settings: PositioningSettings) -> Tuning:
    """The kernels' noise values of a station's settings."""
    kinematic = settings.motion is AntennaMotion.KINEMATIC
    critical = alternative_critical(levels_of(settings)) if settings.quality_control == "on" else np.full(4, np.inf)
    per_sqrt_s = 1.0 / 60.0  # √h is 60 √s
    return Tuning(
        code_sigma_m=settings.code_sigma_m,
        phase_sigma_m=settings.phase_sigma_m,
        position_m_sqrt_s=0.0 if kinematic else settings.static_process_noise_m_sqrt_h * per_sqrt_s,
        position_jump_m=10.0 if kinematic else 0.0,
        zenith_delay_m_sqrt_s=settings.zenith_delay_process_noise_m_sqrt_h * per_sqrt_s,
        gradient_m_sqrt_s=settings.gradient_process_noise_m_sqrt_h * per_sqrt_s,
        common_clock_m=30.0,
        system_clock_m_sqrt_s=0.0002,
        ambiguity_m_sqrt_s=0.0003,
        ambiguity_error_m_sqrt_s=0.0001,
        gps_bias_m=0.1,
        galileo_bias_m=0.15,
        unknown_bias_m=1.0,
        glonass_bias_m=3.0,
        beidou_bias_m=1.0,
        code_correlation_s=30.0,
        geo_factor=5.0,
        critical=float(critical[1]),
        critical_move=float(critical[3]),
    )


@njit(cache=True)
def _is_geo(pair) -> bool:  # type: ignore[no-untyped-def]
    number = pair.satellite % 64 + 1
    return bool(pair.system == _BEIDOU and (number <= 5 or number >= 59))


@njit(cache=True)
def bias_sigma_m(pair, tuning: Tuning) -> float:  # type: ignore[no-untyped-def]
    """One sigma of the constant part of a code's error."""
    if pair.system == _GLONASS:
        return tuning.glonass_bias_m
    if pair.system in (_BEIDOU, _SBAS):
        return tuning.beidou_bias_m
    known = tuning.galileo_bias_m if pair.system == _GALILEO else tuning.gps_bias_m
    return known if pair.bias_known else tuning.unknown_bias_m


@njit(cache=True)
def noise_factor(pair, sine: float, tuning: Tuning) -> float:  # type: ignore[no-untyped-def]
    """From the sigma of one signal at the zenith to that of the combination at an elevation."""
    combination = np.sqrt(pair.alpha * pair.alpha + (pair.alpha - 1.0) * (pair.alpha - 1.0))
    geo = tuning.geo_factor if _is_geo(pair) else 1.0
    return float(combination * geo / max(sine, _LOWEST_SINE))


@njit(cache=True)
def code_scale(misclosure_m: Floats, rows: Records, pairs: Records, tuning: Tuning) -> float:
    """How much noisier (1: not at all) than thought an epoch's codes are: their median misclosure over its sigma.

    ``misclosure_m`` (n,) code less prediction with the receiver's clocks. Receivers differ by a factor of four; one
    whose codes are worse than the settings say has them believed less instead of rejected one by one.
    """
    ratio = np.full(rows.size, np.nan)
    for i in range(rows.size):
        if rows[i].usable:
            white = noise_factor(pairs[i], rows[i].sine, tuning) * tuning.code_sigma_m
            ratio[i] = abs(misclosure_m[i]) / np.sqrt(white**2 + bias_sigma_m(pairs[i], tuning) ** 2)
    scale = np.nanmedian(ratio) / (_NORMAL_MEDIAN * _CHANCE)
    return scale if scale > 1.0 else 1.0


@njit(cache=True)
def variances(
    rows: Records, pairs: Records, arcs: Records, arc_of_pair: Ints, dt_s: float, scale: float, tuning: Tuning
) -> tuple[Floats, Floats, Floats]:
    """Variances (m²) of each pair's code and phase, and what the code adds to its arc's weight (1/m²). All (n,).

    ``scale`` multiplies the codes' white noise (:func:`code_scale`).
    """
    n = rows.size
    code, phase, added = np.full(n, np.nan), np.full(n, np.nan), np.zeros(n)
    for i in range(n):
        if not rows[i].usable:
            continue
        factor = noise_factor(pairs[i], rows[i].sine, tuning)
        alike = max(1.0, tuning.code_correlation_s / dt_s) if dt_s > 0.0 else 1.0
        white = (scale * factor * tuning.code_sigma_m) ** 2
        bias = bias_sigma_m(pairs[i], tuning) ** 2
        phase[i] = (factor * tuning.phase_sigma_m) ** 2
        if arc_of_pair[i] < 0:
            code[i] = white * alike + bias
            continue
        before = arcs[arc_of_pair[i]].code_weight_m2
        added[i] = 1.0 / (white * (alike if before > 0.0 else 1.0))
        known = before / (1.0 + before * bias)
        code[i] = 1.0 / ((before + added[i]) / (1.0 + (before + added[i]) * bias) - known)
    return code, phase, added
