"""Oracle: the light-time identity, time of reception on the receiver's clock = transmission + P/c + satellite clock."""

import numpy as np

from plumbline.gnss.orbits_broadcast import broadcast_states, empty_row, pack
from plumbline.gnss.satellite_states import STATE_TEXT, StateStatus, broadcast_at_transmission

from .make_ephemeris import T_NS, glonass, kepler

C = 299_792_458.0


def test_the_time_of_transmission_solves_the_light_time_equation() -> None:
    rows = np.array([pack(kepler(clock_bias_s=8e-4)), pack(glonass(clock_bias_s=-5e-4))])
    ranges = np.array([2.1e7, 2.3e7])
    states = broadcast_at_transmission(rows, T_NS, ranges)
    transmission_ns = T_NS - np.round((ranges / C + states.clock_s - states.relativity_s) * 1e9).astype(np.int64)
    again = broadcast_states(rows, transmission_ns)
    assert np.abs(again.position_ecef_m - states.position_ecef_m).max() < 1e-5
    assert np.abs(again.clock_s - states.clock_s).max() < 1e-15


def test_what_cannot_be_used_says_why() -> None:
    rows = np.array([empty_row(), pack(kepler()), pack(kepler()), pack(kepler())])
    states = broadcast_at_transmission(rows, T_NS, np.array([2e7, np.nan, 0.0, 2e7]))
    assert [StateStatus(s) for s in states.status] == [
        StateStatus.NO_EPHEMERIS, StateStatus.NO_PSEUDORANGE, StateStatus.NO_PSEUDORANGE, StateStatus.OK,
    ]  # fmt: skip
    assert set(STATE_TEXT) == set(StateStatus)
