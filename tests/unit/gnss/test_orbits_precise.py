"""Oracles: an exact two-body orbit sampled as SP3 does, straight-line clocks, identities at nodes."""

import math

import numpy as np
import pytest

from plumbline.errors import ContractError
from plumbline.gnss.orbits_precise import N_NODES, build_tables, clock_jumps
from plumbline.gnss.satellite_states import StateStatus, precise_at_transmission, precise_states
from plumbline.records import PreciseClocks, PreciseOrbits

NS = 1_000_000_000
T_NS = 1_277_100_000 * NS
OMEGA = 7.2921151467e-5
STEP_S = 900
SATELLITES = np.array([3, 130], np.int16)
C = 299_792_458.0


def two_body(t_s: float) -> np.ndarray:
    """Earth-fixed positions (2, 3) of a GPS-like and a slightly eccentric Galileo-like satellite."""
    out = []
    for a, e, i, node, m0 in ((2.656e7, 0.01, 0.96, 0.3, 1.0), (2.96e7, 0.002, 0.98, 2.0, -2.0)):
        m = m0 + math.sqrt(3.986004418e14 / a**3) * t_s
        anomaly = m
        for _ in range(40):
            anomaly = m + e * math.sin(anomaly)
        x, y = a * (math.cos(anomaly) - e), a * math.sqrt(1 - e * e) * math.sin(anomaly)
        longitude = node - OMEGA * t_s
        c, s = math.cos(longitude), math.sin(longitude)
        out.append([x * c - y * math.cos(i) * s, x * s + y * math.cos(i) * c, y * math.sin(i)])
    return np.array(out)


def products(n: int = 40) -> tuple[PreciseOrbits, PreciseClocks]:
    t_ns = T_NS + np.arange(n, dtype=np.int64) * STEP_S * NS
    positions = np.array([two_body(k * STEP_S) for k in range(n)])
    clock_t_ns = T_NS + np.arange(n * 30, dtype=np.int64) * 30 * NS
    clock = 1e-4 + 1e-11 * np.arange(n * 30)[:, None] * np.array([[30.0, -30.0]])
    return PreciseOrbits(SATELLITES, t_ns, positions), PreciseClocks(SATELLITES, clock_t_ns, clock)


def states_at(tables, t_s: float):  # type: ignore[no-untyped-def]
    return precise_states(tables, SATELLITES, np.full(2, T_NS + round(t_s * NS), np.int64))


def test_an_orbit_is_met_between_the_nodes() -> None:
    tables = build_tables(*products())
    for t_s in (10_000.0, 12_345.6, 18_001.0, 20_249.999):
        assert states_at(tables, t_s).position_ecef_m == pytest.approx(two_body(t_s), abs=2e-4)


def test_nodes_are_met_from_both_sides() -> None:
    orbits, clocks = products()
    tables = build_tables(orbits, clocks)
    for k in (8, 15, 30):
        for nudge in (0.0, -1e-9):
            assert states_at(tables, k * STEP_S + nudge).position_ecef_m == pytest.approx(
                orbits.position_ecef_m[k], abs=1e-4
            )


def test_velocity_is_the_derivative_in_the_turning_frame() -> None:
    tables = build_tables(*products())
    difference = (two_body(15_000.5) - two_body(14_999.5)) / 1.0
    assert states_at(tables, 15_000.0).velocity_ecef_m_s == pytest.approx(difference, abs=1e-4)


def test_the_clock_is_linear_with_the_relativistic_term_on_top() -> None:
    state = states_at(build_tables(*products()), 15_010.0)
    assert state.clock_s - state.relativity_s == pytest.approx([1e-4 + 1.5010e-7, 1e-4 - 1.5010e-7], abs=1e-17)
    assert state.clock_rate_s_s == pytest.approx([1e-11, -1e-11], rel=1e-6)
    r_dot_v = np.sum(state.position_ecef_m * state.velocity_ecef_m_s, axis=1)
    assert state.relativity_s == pytest.approx(-2.0 * r_dot_v / C**2, rel=1e-12)


def test_transmission_times_use_the_satellite_clock() -> None:
    tables = build_tables(*products())
    ranges = np.array([2.2e7, 2.5e7])
    got = precise_at_transmission(tables, SATELLITES, T_NS + 15_000 * NS, ranges)
    for i in range(2):
        t_s = 15_000.0 - ranges[i] / C - (got.clock_s[i] - got.relativity_s[i])
        assert got.position_ecef_m[i] == pytest.approx(two_body(t_s)[i], abs=2e-4)


def test_a_missing_node_leaves_a_hole_and_nothing_wrong_beside_it() -> None:
    orbits, clocks = products(60)
    positions = orbits.position_ecef_m.copy()
    positions[30, 0] = np.nan
    tables = build_tables(PreciseOrbits(SATELLITES, orbits.t_gps_ns, positions), clocks)
    seen = []
    for k in range(8, 51):
        state = states_at(tables, (k + 0.5) * STEP_S)
        assert state.status[1] == 0
        seen.append(int(state.status[0]))
        if state.status[0] == 0:
            assert state.position_ecef_m[0] == pytest.approx(two_body((k + 0.5) * STEP_S)[0], abs=0.02)
    assert seen[21] == seen[22] == StateStatus.ORBIT_GAP
    assert seen.count(StateStatus.ORBIT_GAP) == 4


def test_missing_epochs_are_a_gap_too() -> None:
    orbits, clocks = products(60)
    keep = np.delete(np.arange(60), [29, 30, 31])
    tables = build_tables(PreciseOrbits(SATELLITES, orbits.t_gps_ns[keep], orbits.position_ecef_m[keep]), clocks)
    assert list(states_at(tables, 30.5 * STEP_S).status) == [StateStatus.ORBIT_GAP] * 2
    assert list(states_at(tables, 20.5 * STEP_S).status) == [0, 0]


def test_before_and_after_the_data() -> None:
    tables = build_tables(*products())
    assert list(states_at(tables, -1.0).status) == [StateStatus.ORBIT_OUTSIDE] * 2
    assert list(states_at(tables, 39 * STEP_S + 1.0).status) == [StateStatus.ORBIT_OUTSIDE] * 2
    other = np.array([5, 3], np.int16)
    states = precise_states(tables, other, np.full(2, T_NS + 15_000 * NS, np.int64))
    assert list(states.status) == [StateStatus.NO_ORBIT, 0]
    at = precise_at_transmission(tables, other, T_NS + 15_000 * NS, np.full(2, 2.2e7))
    assert list(at.status) == [StateStatus.NO_CLOCK, 0]


def test_a_clock_is_never_bridged() -> None:
    orbits, clocks = products()
    clock = clocks.clock_s.copy()
    clock[500, 0] = np.nan
    clock[600:, 1] += 5e-9
    tables = build_tables(orbits, PreciseClocks(SATELLITES, clocks.t_gps_ns, clock))
    assert list(states_at(tables, 499.5 * 30).status) == [StateStatus.CLOCK_GAP, 0]
    assert list(states_at(tables, 500.5 * 30).status) == [StateStatus.CLOCK_GAP, 0]
    assert list(states_at(tables, 499.0 * 30).status) == [0, 0]
    assert list(states_at(tables, 599.5 * 30).status) == [0, StateStatus.CLOCK_JUMP]
    assert list(states_at(tables, 600.0 * 30).status) == [0, 0]
    assert states_at(tables, 598.5 * 30).status[1] == 0
    assert states_at(tables, 600.5 * 30).status[1] == 0


def test_noise_is_no_jump_but_a_step_is() -> None:
    rng = np.random.default_rng(5)
    clock = np.cumsum(rng.normal(0, 5e-11, (2000, 1)), axis=0)
    assert not clock_jumps(clock).any()
    clock[1000:] -= 3e-9
    assert list(np.flatnonzero(clock_jumps(clock)[:, 0])) == [999]


def test_an_uneven_grid_is_a_broken_contract() -> None:
    orbits, clocks = products()
    t_ns = orbits.t_gps_ns.copy()
    t_ns[7] += 10 * NS
    with pytest.raises(ContractError):
        build_tables(PreciseOrbits(SATELLITES, t_ns, orbits.position_ecef_m), clocks)
    with pytest.raises(ContractError):
        build_tables(orbits, PreciseClocks(SATELLITES, clocks.t_gps_ns[:1], clocks.clock_s[:1]))


def test_too_few_nodes_give_no_orbit() -> None:
    tables = build_tables(*products(N_NODES - 1))
    assert list(states_at(tables, 5.5 * STEP_S).status) == [StateStatus.ORBIT_GAP] * 2
