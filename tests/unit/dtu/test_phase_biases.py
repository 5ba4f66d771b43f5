"""Phase biases of integer-recovery clocks, as the converter sends them."""

import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.epochs.translate_ssr import SsrTranslator
from plumbline.files.rinex_clock import read_clocks
from plumbline.files.rinex_observation import RinexObservations
from plumbline.gps_time import NS_PER_S
from plumbline.records import SsrHeader, SsrPhaseBias
from plumbline.rtcm3 import Message, decode, scan_frames
from plumbline.signals import BAND_FREQUENCIES_HZ, System, satellite_of_name, signal_id, system_of
from plumbline_dtu.convert import Conversion, convert
from plumbline_dtu.corrections import integer_phase_biases

T_NS = 1277078400 * NS_PER_S
#: Codes and phases of the reference pair as this receiver tracks them.
PAIRS = {System.GPS: ("1W", "2W", "1C", "2W"), System.GALILEO: ("1C", "5Q", "1C", "5Q")}


def by_signal(biases: SsrPhaseBias) -> dict[tuple[int, int], float]:
    return {(s, g): b for s, g, b in zip(biases.satellite.tolist(), biases.signal.tolist(), biases.bias_m, strict=True)}


def frequencies(system: System) -> tuple[float, float]:
    first, second = PAIRS[system][:2]
    return BAND_FREQUENCIES_HZ[system][first[0]], BAND_FREQUENCIES_HZ[system][second[0]]


@pytest.mark.parametrize("name", ["G05", "E11"])
def test_biases_move_the_wide_lane_alone(name: str) -> None:
    """Oracle: the definitions: phi1 - phi2 grows by the wide-lane bias, the ionosphere-free phase not at all."""
    satellite, wide_lane = satellite_of_name(name), 0.44
    system = system_of(satellite)
    biases = integer_phase_biases(SsrHeader(T_NS, T_NS, 30.0, 0, 0, 0), [satellite, 2], {satellite: wide_lane})
    assert set(biases.satellite.tolist()) == {satellite}  # G03 has no wide-lane bias
    bias_m = by_signal(biases)
    f1, f2 = frequencies(system)
    _, _, first, second = PAIRS[system]
    b1, b2 = bias_m[satellite, signal_id(system, first)], bias_m[satellite, signal_id(system, second)]
    assert (b1 * f1 - b2 * f2) / SPEED_OF_LIGHT_M_S == pytest.approx(wide_lane, abs=1e-12)
    assert f1**2 * b1 - f2**2 * b2 == pytest.approx(0.0, abs=1e-12 * f1**2)
    assert biases.integer.all()
    assert not biases.discontinuity.any()


@pytest.fixture(scope="module")
def files(data_dir: Path) -> dict[str, list[Path]]:
    folder = data_dir / "esbc-2020-177"
    return {
        "observations": sorted(folder.glob("*_MO.rnx.gz")),
        "navigation": sorted(folder.glob("*_MN.rnx.gz")),
        "orbits": sorted(folder.glob("*.SP3.gz")),
        "clocks": sorted(folder.glob("*.CLK.gz")),
    }


@pytest.fixture(scope="module")
def sent(files: dict[str, list[Path]], tmp_path_factory: pytest.TempPathFactory) -> list[SsrPhaseBias]:
    """All phase biases of a converted stream of half a day, decoded."""
    out = tmp_path_factory.mktemp("biases")
    convert(Conversion(**files, out=out, interval_s=1800.0, correction_interval_s=1800, systems="GRE"))
    assert "phase biases" in json.loads((out / "streams.json").read_text())["streams"]["corrections.rtcm3"]["carries"]
    translator, found = SsrTranslator(), []
    for frame in scan_frames((out / "corrections.rtcm3").read_bytes()).frames:
        message = decode(frame.payload)
        if isinstance(message, Message) and message.number in (1265, 1266, 1267):
            translated = translator.translate(message, T_NS, T_NS)
            assert isinstance(translated, list)
            found += translated
    return found


@pytest.mark.realdata
def test_the_stream_repeats_constant_biases_of_every_satellite(
    sent: list[SsrPhaseBias], files: dict[str, list[Path]]
) -> None:
    """Oracle: the clock file's header: its satellites, wide lanes to the 0.1 mm of DF482, nothing of GLONASS."""
    wide_lanes = read_clocks(files["clocks"]).wide_lane_cycles
    values: dict[tuple[int, int], set[float]] = defaultdict(set)
    for biases in sent:
        assert biases.integer.all()
        assert not biases.discontinuity.any()
        assert biases.mw_consistent
        for key, bias_m in by_signal(biases).items():
            values[key].add(bias_m)
    assert {system_of(satellite) for satellite, _ in values} == {System.GPS, System.GALILEO}
    assert all(len(of_signal) == 1 for of_signal in values.values())
    assert len({satellite for satellite, _ in values}) > 50
    for satellite in {satellite for satellite, _ in values}:
        system = system_of(satellite)
        f1, f2 = frequencies(system)
        b1, b2 = (next(iter(values[satellite, signal_id(system, code)])) for code in PAIRS[system][2:])
        assert (b1 * f1 - b2 * f2) / SPEED_OF_LIGHT_M_S == pytest.approx(wide_lanes[satellite], abs=5e-4)


def mean_wide_lanes(path: Path, bias_m: dict[tuple[int, int], float]) -> dict[System, list[float]]:
    """Melbourne-Wübbena, cycles, averaged over each pass of half an hour or more, biases applied."""
    passes: dict[int, list[list[tuple[int, float]]]] = defaultdict(list)
    for epoch in RinexObservations(path):
        keys = zip(epoch.satellite.tolist(), epoch.signal.tolist(), strict=True)
        values = dict(zip(keys, zip(epoch.pseudorange_m, epoch.carrier_phase_cycles, strict=True), strict=True))
        for satellite in {s for s, _ in values if system_of(s) in PAIRS}:
            wide_lane = melbourne_wuebbena(satellite, values, bias_m)
            if np.isfinite(wide_lane):
                arcs = passes[satellite]
                if not arcs or epoch.t_gps_ns - arcs[-1][-1][0] > 300 * NS_PER_S or is_slip(arcs[-1], wide_lane):
                    arcs.append([])
                arcs[-1].append((epoch.t_gps_ns, wide_lane))
    means: dict[System, list[float]] = defaultdict(list)
    for satellite, arcs in passes.items():
        means[system_of(satellite)] += [float(np.mean([w for _, w in arc])) for arc in arcs if len(arc) >= 60]
    return means


def melbourne_wuebbena(satellite: int, values: dict[Any, Any], bias_m: dict[tuple[int, int], float]) -> float:
    system = system_of(satellite)
    f1, f2 = frequencies(system)
    keys = [(satellite, signal_id(system, code)) for code in PAIRS[system]]
    if any(key not in values for key in keys):
        return float("nan")
    (p1, _), (p2, _), (_, phase_1), (_, phase_2) = (values[key] for key in keys)
    phase_1 += bias_m.get(keys[2], 0.0) * f1 / SPEED_OF_LIGHT_M_S
    phase_2 += bias_m.get(keys[3], 0.0) * f2 / SPEED_OF_LIGHT_M_S
    return float(phase_1 - phase_2 - (f1 * p1 + f2 * p2) / (f1 + f2) * (f1 - f2) / SPEED_OF_LIGHT_M_S)


def is_slip(arc: list[tuple[int, float]], wide_lane: float) -> bool:
    return abs(wide_lane - float(np.mean([w for _, w in arc[-40:]]))) > 3.5


def share_near_common(cycles: list[float]) -> float:
    """Share of fractional parts within 0.15 cycles of the one that they have in common (the receiver's)."""
    phasor = np.exp(2j * np.pi * np.array(cycles))
    apart = np.angle(phasor * np.conj(phasor.mean())) / (2.0 * np.pi)
    return float((np.abs(apart) < 0.15).mean())


@pytest.mark.realdata
def test_wide_lanes_become_integers(sent: list[SsrPhaseBias], files: dict[str, list[Path]]) -> None:
    """Oracle: half a day of a real receiver: fractional wide lanes agree between satellites, without biases not."""
    bias_m = {key: value for biases in sent for key, value in by_signal(biases).items()}
    plain = mean_wide_lanes(files["observations"][0], {})
    biased = mean_wide_lanes(files["observations"][0], bias_m)
    for system, least in ((System.GPS, 0.95), (System.GALILEO, 1.0)):
        assert len(biased[system]) >= 20
        assert share_near_common(biased[system]) >= least
        assert share_near_common(plain[system]) < 0.7
