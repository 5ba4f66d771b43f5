"""Single-point positioning: a metre-level position from codes and broadcast ephemerides alone.

It starts the precise filter, and is what a station shows while corrections lack. Iterated least squares over position
and one clock a system. Codes in error are identified by their w-statistics (:mod:`plumbline.estimation.dia`), several
if need be, as long as the rest stays redundant; at each solution all codes are tested again, so that one that was left
out only because of another comes back (RAIM: Parkinson & Axelrad 1988; re-instatement: Lee 2016, section 2.2).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from plumbline.constants import EARTH_ROTATION_RATE_RAD_S, SPEED_OF_LIGHT_M_S
from plumbline.estimation import dia
from plumbline.estimation.kalman import cholesky_lower, lower_inverse
from plumbline.estimation.least_squares import solve
from plumbline.gnss.earth_frames import geodetic_from_ecef
from plumbline.records import Booleans, Floats
from plumbline.signals import System

_N_SYSTEMS: Final = len(System)
_AXES: Final = 3
_W_LIMIT: Final = 4.0  # codes' tails are longer than normal ones
_LEAST_REDUNDANCY: Final = 1e-6  # of a code that others check
_MAX_ROUNDS: Final = 8
_MAX_ITERATIONS: Final = 12
_LOWEST_SINE: Final = 0.05


@dataclass(frozen=True, slots=True)
class PointSolution:
    """A code-only position."""

    position_ecef_m: Floats  # (3,) of the antenna
    clock_m: Floats  # (7,) receiver clock against each system's, NaN where not seen
    covariance_ecef_m2: Floats  # (3, 3)
    used: Booleans  # (n,) of the rows given
    pdop: float
    w: Floats  # (n,) w-statistics given the errors found, zero where nothing checks a code
    statistic: float  # vᵀ R⁻¹ v of the codes used, χ² of …
    degrees_of_freedom: int


@njit(cache=True)
def _troposphere_m(height_m: float, sine: float) -> float:
    """Slant delay of a standard atmosphere: 2.4 m at sea level, mapping of Black & Eisner (RTCA DO-229D, A.4.2.4)."""
    zenith = 2.4 * np.exp(-min(max(height_m, -500.0), 9000.0) / 7500.0)
    return float(zenith * 1.001 / np.sqrt(0.002001 + sine * sine))


@njit(cache=True)
def _geometry(position: Floats, satellite_m: Floats, line: Floats) -> tuple[float, float]:
    """Range with the Earth's turn during flight, and the sine of the elevation; ``line`` gets the unit vector."""
    line[:] = satellite_m - position
    flight_s = np.sqrt(np.sum(line * line)) / SPEED_OF_LIGHT_M_S
    angle = EARTH_ROTATION_RATE_RAD_S * flight_s
    line[0] = satellite_m[0] + angle * satellite_m[1] - position[0]
    line[1] = satellite_m[1] - angle * satellite_m[0] - position[1]
    line[2] = satellite_m[2] - position[2]
    distance = np.sqrt(np.sum(line * line))
    line /= distance
    radius = np.sqrt(np.sum(position * position))
    if radius < 1e6:
        return distance, 1.0
    return distance, np.sum(line * position) / radius


@njit(cache=True)
def _linearise(position, satellite_m, satellite_clock_m, code_m, sigma_m, system, use, columns):  # type: ignore[no-untyped-def]
    """Design matrix, misclosures without the receiver clocks, sigmas; rows not used get no weight."""
    n = code_m.size
    h, v, sigma = np.zeros((n, 3 + columns.max() + 1)), np.zeros(n), np.full(n, 1e9)
    line = np.zeros(3)
    on_earth = np.sum(position * position) > 1e12
    height = geodetic_from_ecef(position)[2] if on_earth else 0.0
    for i in range(n):
        if not use[i]:
            continue
        distance, sine = _geometry(position, satellite_m[i], line)
        h[i, :3] = -line
        h[i, 3 + columns[system[i]]] = 1.0
        v[i] = code_m[i] - distance + satellite_clock_m[i]
        sigma[i] = sigma_m[i]
        if on_earth:
            v[i] -= _troposphere_m(height, max(sine, _LOWEST_SINE))
            sigma[i] = sigma_m[i] / max(sine, _LOWEST_SINE)
    return h, v, sigma


@njit(cache=True)
def _columns_of(system: NDArray[np.int8], use: Booleans) -> NDArray[np.int64]:
    """Column of each system's clock, −1 where no row of the system is used."""
    columns = np.full(_N_SYSTEMS, -1, np.int64)
    made = 0
    for i in range(system.size):
        if use[i] and columns[system[i]] < 0:
            columns[system[i]] = made
            made += 1
    return columns


@njit(cache=True)
def _iterate(start, satellite_m, satellite_clock_m, code_m, sigma_m, system, use):  # type: ignore[no-untyped-def]
    """Position, clocks and all of the last linearisation, by Gauss-Newton; last item: whether it converged."""
    position = start.copy()
    columns = _columns_of(system, use)
    unknowns = 3 + columns.max() + 1
    clock = np.full(_N_SYSTEMS, np.nan)
    covariance = np.zeros((unknowns, unknowns))
    residual, sigma, h = np.zeros(code_m.size), np.ones(code_m.size), np.zeros((code_m.size, unknowns))
    if np.sum(use) < unknowns:
        return position, clock, covariance, h, residual, sigma, False
    for _ in range(_MAX_ITERATIONS):
        h, v, sigma = _linearise(position, satellite_m, satellite_clock_m, code_m, sigma_m, system, use, columns)
        dx, covariance, solvable = solve(h, v, sigma)
        if not solvable:
            break
        position += dx[:3]
        residual = v - h @ dx
        if np.sum(dx[:3] * dx[:3]) < 1e-6:
            for k in range(_N_SYSTEMS):
                if columns[k] >= 0:
                    clock[k] = dx[3 + columns[k]]
            return position, clock, covariance, h, residual, sigma, True
    return position, clock, covariance, h, residual, sigma, False


@njit(cache=True)
def _identify(position, satellite_m, satellite_clock_m, code_m, sigma_m, system, observed):  # type: ignore[no-untyped-def]
    """Codes in error among those observed, linearised at a position: which, all codes' w, and the statistic without.

    Last items: degrees of freedom that are left, and whether the codes named explain the misfit. Rows that nothing
    checks are never named.
    """
    columns = _columns_of(system, observed)
    h, v, sigma = _linearise(position, satellite_m, satellite_clock_m, code_m, sigma_m, system, observed, columns)
    rows = np.flatnonzero(observed)
    redundancy = rows.size - h.shape[1]
    wrong, w = np.zeros(observed.size, np.bool_), np.zeros(observed.size)
    table, solvable = dia.residual_information(h[rows], v[rows], sigma[rows])
    if not solvable:
        return wrong, w, 0.0, 0, False
    checked = np.diag(table)[:-1] * sigma[rows] ** 2 > _LEAST_REDUNDANCY
    limits = np.full(rows.size, _W_LIMIT**2)
    most = min(max(1, rows.size // 3), redundancy - 1)
    found = dia.identify(table, np.arange(rows.size + 1), checked, limits, most)
    w[rows] = np.where(checked, dia.w_values(found.swept, found.adopted)[0], 0.0)
    wrong[rows] = found.adopted
    return wrong, w, max(found.statistic_after, 0.0), redundancy - found.order.size, found.explained


@njit(cache=True)
def _position(start, satellite_m, satellite_clock_m, code_m, sigma_m, system, observed):  # type: ignore[no-untyped-def]
    """Solve, test all codes at the solution, solve without those in error, until the same ones are named again.

    Returns position, clocks, covariance, codes used (n,), w (n,), statistic, degrees of freedom, whether it worked.
    """
    use, position, clock = observed.copy(), start.copy(), np.full(_N_SYSTEMS, np.nan)
    covariance, w = np.zeros((_AXES, _AXES)), np.zeros(observed.size)
    for _ in range(_MAX_ROUNDS):
        result = _iterate(position, satellite_m, satellite_clock_m, code_m, sigma_m, system, use)
        position, clock, covariance, converged = result[0], result[1], result[2], result[6]
        if not converged:
            break
        wrong, w, statistic, freedom, explained = _identify(
            position, satellite_m, satellite_clock_m, code_m, sigma_m, system, observed
        )  # fmt: skip
        if np.array_equal(observed & ~wrong, use):
            return position, clock, covariance, use, w, statistic, freedom, explained
        use = observed & ~wrong
    return position, clock, covariance, use, w, 0.0, 0, False


@njit(cache=True)
def _dilution(position: Floats, satellite_m: Floats, system: NDArray[np.int8], use: Booleans) -> float:
    """PDOP of equal weights, one clock a system; NaN where singular."""
    columns = _columns_of(system, use)
    unknowns = 3 + columns.max() + 1
    normal = np.zeros((unknowns, unknowns))
    line, row = np.zeros(3), np.zeros(unknowns)
    for i in range(system.size):
        if use[i]:
            _geometry(position, satellite_m[i], line)
            row[:] = 0.0
            row[:3] = line
            row[3 + columns[system[i]]] = 1.0
            normal += np.outer(row, row)
    factor, positive = cholesky_lower(normal)
    if not positive:
        return np.nan
    inverse = lower_inverse(factor)
    return float(np.sqrt(np.sum(inverse[:, :3] * inverse[:, :3])))


def single_point(
    satellite_m: Floats, satellite_clock_m: Floats, code_m: Floats, sigma_m: Floats, system: NDArray[np.int8],
    start_ecef_m: Floats | None = None,
) -> PointSolution | None:  # fmt: skip
    """Position from codes; None where it is impossible (too few satellites, no convergence, codes that disagree).

    ``satellite_m`` (n, 3) at transmission, Earth-fixed of that instant; ``satellite_clock_m`` (n,) offset times c;
    ``code_m`` (n,) with biases added; ``sigma_m`` (n,) of the code at the zenith; rows with a NaN are not used. The
    covariance is that of the sigmas, or of the residuals where these are larger (posterior variance factor).
    """
    use = np.isfinite(satellite_m[:, 0]) & np.isfinite(satellite_clock_m) & np.isfinite(code_m)
    start = np.zeros(3) if start_ecef_m is None else start_ecef_m
    if not use.any():
        return None
    position, clock, covariance, use, w, statistic, freedom, solved = _position(
        start, satellite_m, satellite_clock_m, code_m, sigma_m, system, use
    )  # fmt: skip
    if not solved:
        return None
    pdop = float(_dilution(position, satellite_m, system, use))
    factor = max(1.0, statistic / freedom) if freedom > 0 else 1.0
    return PointSolution(
        position, clock, factor * covariance[:_AXES, :_AXES], use, pdop, w, float(statistic), int(freedom)
    )
