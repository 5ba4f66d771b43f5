"""Signal pairs: which signals are chosen, and what the combinations keep and lose."""

from dataclasses import replace

import numpy as np
import pytest

from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.positioning.preprocess import signal_pairs
from plumbline.positioning.satellites import SignalBiases
from plumbline.positioning.state import ARC_DTYPE, no_arcs
from plumbline.records import UNKNOWN_CHANNEL, Epoch
from plumbline.signals import carrier_frequency_hz, satellite_of_name, signal_code, signal_id, system_of

RANGE_M, DELAY_M = 2.3e7, 7.0  # DELAY_M on the first frequency


def _epoch(rows):
    """Epoch of (satellite, code, has code, has phase, cycles); delays and frequencies as physics has them."""
    satellite = np.array([satellite_of_name(r[0]) for r in rows], np.int16)
    signal = np.array([signal_id(system_of(int(s)), r[1]) for s, r in zip(satellite, rows, strict=True)], np.int16)
    channel = np.where(satellite // 64 == 1, 3, 0).astype(np.int8)
    f = np.array([carrier_frequency_hz(int(s), int(c)) for s, c in zip(signal, channel, strict=True)])
    delay = DELAY_M * (1575.42e6 / f) ** 2
    code = np.where([r[2] for r in rows], RANGE_M + delay, np.nan)
    phase = np.where([r[3] for r in rows], (RANGE_M - delay) * f / SPEED_OF_LIGHT_M_S, np.nan)
    phase = phase + np.array([r[4] if len(r) > 4 else 0.0 for r in rows])
    n = len(rows)
    nan = np.full(n, np.nan)
    return Epoch(0, 0, satellite, signal, code, phase, nan, nan + 1, nan, np.zeros(n, np.bool_), channel)


def _biases(epoch, unknown=()):
    n = epoch.satellite.size
    code = np.array([np.nan if signal_code(int(s)) in unknown else 0.0 for s in epoch.signal])
    return SignalBiases(code, np.full(n, np.nan), np.full(n, -1, np.int16))


def _pairs(epoch, unknown=(), arcs=None):
    return signal_pairs(epoch, epoch.glonass_channel, _biases(epoch, unknown), no_arcs() if arcs is None else arcs)


@pytest.mark.parametrize(
    ("name", "codes"), [("G05", "1C 2W"), ("E11", "1C 5Q"), ("C21", "2I 6I"), ("R04", "1P 2P"), ("J02", "1C 2L")]
)
def test_the_ionosphere_cancels_and_the_wide_lane_counts_cycles(name, codes):
    """Oracle: closed form: the range remains in code and phase; Melbourne-Wübbena is N1 − N2; f² law."""
    first, second = codes.split()
    epoch = _epoch([(name, first, True, True, 12.0), (name, second, True, True, 5.0)])
    pair = _pairs(epoch)[0]
    assert pair["code_m"] == pytest.approx(RANGE_M, abs=1e-6)
    assert pair["wide_lane_cycles"] == pytest.approx(7.0, abs=1e-6)
    f1, f2 = (carrier_frequency_hz(int(s), int(epoch.glonass_channel[0])) for s in epoch.signal)
    cycles_m = (f1 * 12.0 - f2 * 5.0) / (f1**2 - f2**2) * SPEED_OF_LIGHT_M_S
    assert pair["phase_m"] - RANGE_M == pytest.approx(cycles_m, abs=1e-6)
    delay = DELAY_M * 1575.42e6**2 * (1 / f2**2 - 1 / f1**2)
    lengths = 12.0 * SPEED_OF_LIGHT_M_S / f1 - 5.0 * SPEED_OF_LIGHT_M_S / f2
    assert pair["geometry_free_m"] == pytest.approx(delay + lengths, abs=1e-6)


def test_a_code_without_a_phase_of_its_own_uses_its_bands():
    """Oracle: the choice by hand: GPS L1 P(Y) code (a reference of the clocks), L1 C/A phase."""
    epoch = _epoch([("G05", "1C", True, True), ("G05", "1W", True, False), ("G05", "2W", True, True)])
    code = epoch.pseudorange_m.copy()
    code[0] += 100.0  # if C/A were used it would show
    pair = _pairs(replace(epoch, pseudorange_m=code), unknown=("1C",))[0]
    assert pair["code_m"] == pytest.approx(RANGE_M, abs=1e-6)
    assert pair["bias_known"]
    assert signal_code(int(pair["signal_1"])) == "1C"


def test_an_unknown_bias_is_told():
    """Oracle: the flag."""
    assert not _pairs(_epoch([("G05", "1C", True, True), ("G05", "2W", True, True)]), unknown=("1C",))[0]["bias_known"]


def test_an_arc_keeps_its_signals():
    """Oracle: the arc's pair, although a better one is there now."""
    rows = [("E11", "1C", True, True), ("E11", "5Q", True, True), ("E11", "7Q", True, True)]
    arcs = np.zeros(1, ARC_DTYPE)
    arcs["satellite"] = satellite_of_name("E11")
    arcs["signal_1"], arcs["signal_2"] = _epoch(rows).signal[0], signal_id(system_of(int(arcs["satellite"][0])), "7Q")
    assert signal_code(int(_pairs(_epoch(rows))[0]["signal_2"])) == "5Q"
    assert signal_code(int(_pairs(_epoch(rows), arcs=arcs)[0]["signal_2"])) == "7Q"


def test_one_frequency_gives_a_code_alone():
    """Oracle: the raw code, no phase."""
    pair = _pairs(_epoch([("G05", "1C", True, True)]))[0]
    assert pair["code_m"] == pytest.approx(RANGE_M + DELAY_M, abs=1e-6)
    assert np.isnan(pair["phase_m"])
    assert pair["signal_1"] == -1


def test_what_cannot_be_used_gives_no_pair():
    """Oracle: GLONASS without its channel, a satellite without code, an impossible code."""
    epoch = _epoch([("R04", "1P", True, True), ("R04", "2P", True, True)])
    assert _pairs(replace(epoch, glonass_channel=np.full(2, UNKNOWN_CHANNEL, np.int8))).size == 0
    assert _pairs(_epoch([("G05", "1C", False, True), ("G05", "2W", False, True)])).size == 0
    epoch = _epoch([("G05", "1C", True, True)])
    assert _pairs(replace(epoch, pseudorange_m=np.array([-3.0]))).size == 0


def test_biases_are_added():
    """Oracle: α b1 − β b2 on the code, and on the phase in metres."""
    epoch = _epoch([("G05", "1C", True, True), ("G05", "2W", True, True)])
    biases = SignalBiases(np.array([1.0, -2.0]), np.array([0.1, 0.3]), np.array([4, 5], np.int16))
    plain, pair = _pairs(epoch)[0], signal_pairs(epoch, epoch.glonass_channel, biases, no_arcs())[0]
    alpha = pair["alpha"]
    assert pair["code_m"] - plain["code_m"] == pytest.approx(alpha * 1.0 + (alpha - 1.0) * 2.0, abs=1e-6)
    assert pair["phase_m"] - plain["phase_m"] == pytest.approx(alpha * 0.1 - (alpha - 1.0) * 0.3, abs=1e-6)
    assert (pair["discontinuity_1"], pair["discontinuity_2"]) == (4, 5)


@pytest.mark.parametrize(("name", "codes", "share"), [("E05", ("1C", "5Q"), 10.0), ("G05", ("1W", "2W"), 0.0)])
def test_weak_signals_have_more_thermal_noise_unless_they_are_tracked_without_their_code(name, codes, share):
    """Oracle: ten decibels below where thermal noise is as large as all other, ten times as much of it."""
    epoch = _epoch([(name, code, True, True) for code in codes])
    epoch = replace(epoch, cn0_db_hz=np.array([45.0, 23.0]))
    assert _pairs(epoch)["thermal"][0] == pytest.approx(share)
