"""Precise orbits and clocks (SP3, CLK): interpolated, never across a gap or a jump.

Orbits: once, every interval between two nodes gets a polynomial of degree 13 through its 14 nearest nodes, taken in a
frame that stands still (Earth-fixed at the interval's start), where an orbit is smooth; an epoch then costs one Horner
scheme and one rotation. Clocks: linear between neighbouring nodes.
"""

import math
from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numba import njit

from plumbline.constants import EARTH_ROTATION_RATE_RAD_S
from plumbline.errors import ContractError
from plumbline.records import Floats, Ints, PreciseClocks, PreciseOrbits
from plumbline.signals import N_SATELLITES

N_NODES: Final = 14
CLOCK_JUMP_S: Final = 1e-9  # change of the clock's rate between neighbouring intervals, times the interval
CLOCK_END_NS: Final = 1_000_000_000  # a second on, a clock is off by picoseconds
_HALF: Final = N_NODES // 2
MAX_SHIFT: Final = 5  # intervals that the window may be off centre: only the outermost interval has none
_SHIFTS: Final = sorted(range(-MAX_SHIFT, MAX_SHIFT + 1), key=abs)


class PreciseTables(NamedTuple):
    """Interpolation tables for the kernels. Index arrays (N_SATELLITES,) give a satellite's column, −1 for none.

    ``coefficients_m`` (intervals, satellites, 3, N_NODES): ascending powers of the time since the interval's start in
    steps, NaN where a gap is near. ``clock_s`` (nodes, satellites) and ``clock_jump`` (nodes, satellites): jump after
    the node.
    """

    orbit_column: Ints
    orbit_start_ns: int
    orbit_step_ns: int
    coefficients_m: Floats
    clock_column: Ints
    clock_start_ns: int
    clock_step_ns: int
    clock_s: Floats
    clock_jump: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]


def _uniform_step_ns(t_ns: Ints, what: str) -> int:
    """The smallest step of a time grid, of which all others must be multiples."""
    if t_ns.size < 2:
        raise ContractError(f"precise {what}: fewer than two epochs")
    steps = np.diff(t_ns)
    step = int(steps.min())
    if step <= 0 or np.any(steps % step):
        raise ContractError(f"precise {what}: the epochs are not on an even, ascending grid")
    return step


def _on_full_grid(t_ns: Ints, step_ns: int, values: Floats) -> Floats:
    """``values`` (m, …) with rows of NaN where an epoch of the even grid is missing."""
    index = (t_ns - t_ns[0]) // step_ns
    full = np.full((int(index[-1]) + 1, *values.shape[1:]), np.nan)
    full[index] = values
    return full


def _columns(satellites: Ints) -> Ints:
    column = np.full(N_SATELLITES, -1, np.int64)
    column[satellites] = np.arange(len(satellites))
    return column


@cache
def _lagrange_basis(first: int) -> Floats:
    """Ascending coefficients (power, node) of the Lagrange polynomials of nodes ``first``, ``first`` + 1, …

    In whole numbers until the last division: a numerical inverse would lose centimetres off centre.
    """
    nodes = range(first, first + N_NODES)
    basis = np.empty((N_NODES, N_NODES))
    for column, own in enumerate(nodes):
        coefficients, divisor = [1], 1
        for other in nodes:
            if other != own:
                lower, upper = [0, *coefficients], [*coefficients, 0]
                coefficients = [a - other * b for a, b in zip(lower, upper, strict=True)]
                divisor *= own - other
        basis[:, column] = [c / divisor for c in coefficients]
    return basis


def _window_polynomials(nodes: Floats, first: int, step_ns: int) -> Floats:
    """Polynomials (s, 3, N_NODES) through nodes (N_NODES, s, 3), the first of them ``first`` steps off the start."""
    angle = EARTH_ROTATION_RATE_RAD_S * step_ns * 1e-9 * np.arange(first, first + N_NODES)
    c, sn = np.cos(angle)[:, None], np.sin(angle)[:, None]
    x, y, z = nodes[..., 0], nodes[..., 1], nodes[..., 2]
    still = np.stack([c * x - sn * y, sn * x + c * y, z])
    start = still[:, -first, :]
    polynomials = np.einsum("pn,xns->sxp", _lagrange_basis(first), still - start[:, None, :])
    polynomials[..., 0] += start.T
    return np.asarray(polynomials, np.float64)


def orbit_coefficients(position_ecef_m: Floats, step_ns: int) -> Floats:
    """Polynomials (m − 1, s, 3, N_NODES) of each interval from positions (m, s, 3) on an even grid.

    Where the centred window meets a gap or the end of the data, it is moved by up to ``MAX_SHIFT`` intervals: at 15
    minutes' spacing that costs 2 mm up to four intervals, 5 mm at five (90 %; the eccentric E14, E18 ten times that).
    An interval still without a whole window is NaN.
    """
    m, s, _ = position_ecef_m.shape
    out = np.full((max(m - 1, 0), s, 3, N_NODES), np.nan)
    for k in range(m - 1):
        for shift in _SHIFTS:
            first = k - _HALF + 1 + shift
            missing = np.isnan(out[k, :, 0, 0])
            if not missing.any():
                break
            if 0 <= first <= m - N_NODES:
                nodes = position_ecef_m[first : first + N_NODES, missing]
                out[k, missing] = _window_polynomials(nodes, first - k, step_ns)
    return out


def clock_jumps(clock_s: Floats) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Whether the clock (m, s) jumps between node k and k + 1: its step differs from both neighbouring steps' mean."""
    steps = np.diff(clock_s, axis=0)
    jump = np.zeros(clock_s.shape, np.bool_)
    if steps.shape[0] < 3:
        return jump
    before, after = np.full(steps.shape, np.nan), np.full(steps.shape, np.nan)
    before[1:], after[:-1] = steps[:-1], steps[1:]
    far_before = ~(np.abs(steps - before) <= CLOCK_JUMP_S)
    far_after = ~(np.abs(steps - after) <= CLOCK_JUMP_S)
    known = ~(np.isnan(before) & np.isnan(after))
    jump[:-1] = far_before & far_after & known
    return jump


def build_tables(orbits: PreciseOrbits, clocks: PreciseClocks) -> PreciseTables:
    """Tables for :mod:`plumbline.gnss.satellite_states` from precise orbits and clocks; even grids, gaps allowed.

    Raises :class:`~plumbline.errors.ContractError` for uneven or descending grids.
    """
    orbit_step = _uniform_step_ns(orbits.t_gps_ns, "orbits")
    clock_step = _uniform_step_ns(clocks.t_gps_ns, "clocks")
    positions = _on_full_grid(orbits.t_gps_ns, orbit_step, orbits.position_ecef_m)
    clock = _on_full_grid(clocks.t_gps_ns, clock_step, clocks.clock_s)
    return PreciseTables(
        _columns(orbits.satellite.astype(np.int64)),
        int(orbits.t_gps_ns[0]),
        orbit_step,
        orbit_coefficients(positions, orbit_step),
        _columns(clocks.satellite.astype(np.int64)),
        int(clocks.t_gps_ns[0]),
        clock_step,
        clock,
        clock_jumps(clock),
    )


@njit(cache=True)
def interpolate_orbit(tables: PreciseTables, satellite: int, t_ns: int, position: Floats, velocity: Floats) -> int:
    """Earth-fixed position [m], velocity [m/s] (3,) of a satellite id at a GPS time, in place; returns the status."""
    column = tables.orbit_column[satellite]
    if column < 0:
        return 4
    since_ns = t_ns - tables.orbit_start_ns
    last = tables.coefficients_m.shape[0] - 1
    k = min(since_ns // tables.orbit_step_ns, last)
    in_step_ns = since_ns - k * tables.orbit_step_ns
    if since_ns < 0 or in_step_ns > tables.orbit_step_ns:
        return 5
    polynomial = tables.coefficients_m[k, column]
    if math.isnan(polynomial[0, 0]):
        return 6
    u = in_step_ns / tables.orbit_step_ns
    still, rate = np.zeros(3), np.zeros(3)
    for axis in range(3):
        for power in range(N_NODES - 1, -1, -1):
            rate[axis] = rate[axis] * u + still[axis]
            still[axis] = still[axis] * u + polynomial[axis, power]
        rate[axis] /= tables.orbit_step_ns * 1e-9
    angle = EARTH_ROTATION_RATE_RAD_S * in_step_ns * 1e-9
    s, c = math.sin(angle), math.cos(angle)
    position[0], position[1], position[2] = c * still[0] + s * still[1], -s * still[0] + c * still[1], still[2]
    velocity[0] = c * rate[0] + s * rate[1] + EARTH_ROTATION_RATE_RAD_S * position[1]
    velocity[1] = -s * rate[0] + c * rate[1] - EARTH_ROTATION_RATE_RAD_S * position[0]
    velocity[2] = rate[2]
    return 0


@njit(cache=True)
def interpolate_clock(tables: PreciseTables, satellite: int, t_ns: int) -> tuple[float, float, int]:
    """Clock offset [s], rate [s/s] and status of a satellite id at a GPS time; no relativistic term.

    At the ends the line goes on for ``CLOCK_END_NS``: signals of a file's first epoch left before it.
    """
    column = tables.clock_column[satellite]
    if column < 0:
        return math.nan, math.nan, 7
    since_ns = t_ns - tables.clock_start_ns
    last = tables.clock_s.shape[0] - 2
    k = min(max(since_ns // tables.clock_step_ns, 0), last)
    in_step_ns = since_ns - k * tables.clock_step_ns
    if in_step_ns < -CLOCK_END_NS or in_step_ns > tables.clock_step_ns + CLOCK_END_NS:
        return math.nan, math.nan, 8
    left, right = tables.clock_s[k, column], tables.clock_s[k + 1, column]
    if in_step_ns == 0 and not math.isnan(left):
        right = left if math.isnan(right) or tables.clock_jump[k, column] else right
    elif math.isnan(left) or math.isnan(right):
        return math.nan, math.nan, 9
    elif tables.clock_jump[k, column]:
        return math.nan, math.nan, 10
    slope = (right - left) / tables.clock_step_ns
    return left + slope * in_step_ns, slope * 1e9, 0
