"""What the converter writes, decoded again, is what it read."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.epochs.translate_ephemeris import ephemeris_from_message
from plumbline.epochs.translate_ssr import SsrTranslator
from plumbline.files.rinex_clock import read_clocks
from plumbline.files.rinex_observation import RinexObservations
from plumbline.files.sp3 import read_sp3
from plumbline.gnss.orbits_broadcast import pack
from plumbline.gnss.orbits_precise import build_tables
from plumbline.gnss.satellite_states import corrected_at_transmission, precise_at_transmission
from plumbline.gnss.ssr_orbits import pack_correction
from plumbline.gps_time import NS_PER_S
from plumbline.records import Ephemeris, SsrClock, SsrCodeBias, SsrOrbit, SsrPhaseBias
from plumbline.rtcm3 import Message, Observations, decode, scan_frames
from plumbline.signals import System, carrier_frequency_hz, system_of
from plumbline_dtu.convert import Conversion, convert

pytestmark = pytest.mark.realdata
N_EPOCHS = 12


@pytest.fixture(scope="module")
def folder(data_dir: Path) -> Path:
    return data_dir / "esbc-2020-177"


@pytest.fixture(scope="module")
def products(folder: Path) -> dict[str, Any]:
    return {
        "orbits": sorted(folder.glob("*.SP3.gz")),
        "clocks": sorted(folder.glob("*.CLK.gz")),
        "observations": sorted(folder.glob("*_MO.rnx.gz")),
        "navigation": sorted(folder.glob("*_MN.rnx.gz")),
    }


@pytest.fixture(scope="module")
def converted(products: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("converted")
    convert(Conversion(**products, out=out, max_epochs=N_EPOCHS, systems="GREC"))
    return out


def messages(path: Path) -> list[Any]:
    scan = scan_frames(path.read_bytes())
    assert not scan.rejected_bytes
    return [decode(frame.payload) for frame in scan.frames]


def test_observations_survive(products: dict[str, Any], converted: Path) -> None:
    """Oracle: the RINEX file: codes to 0.3 mm, phases to 0.1 mm but for whole cycles, Doppler to 0.05 mm/s, C/N0."""
    expected: dict[tuple[int, int, int], tuple[float, ...]] = {}
    epochs = [e for _, e in zip(range(N_EPOCHS), RinexObservations(products["observations"][0]), strict=False)]
    for e in epochs:
        for k in range(len(e.satellite)):
            frequency = carrier_frequency_hz(int(e.signal[k]), int(e.glonass_channel[k]))
            row = (e.pseudorange_m[k], e.carrier_phase_cycles[k], e.doppler_hz[k], e.cn0_db_hz[k], frequency)
            expected[e.t_gps_ns, int(e.satellite[k]), int(e.signal[k])] = row
    arcs: dict[tuple[int, int], set[float]] = {}
    compared = 0
    for message in messages(converted / "observations.rtcm3"):
        if not isinstance(message, Observations):
            continue
        t_ns = message.t_gps_ns(epochs[0].t_gps_ns)
        for k in range(message.n_rows):
            satellite, signal = int(message.satellite[k]), int(message.signal[k])
            code, phase, doppler, cn0, frequency = expected[t_ns, satellite, signal]
            wavelength = SPEED_OF_LIGHT_M_S / frequency
            assert message.pseudorange_m[k] == pytest.approx(code, abs=4e-4)
            assert message.cn0_db_hz[k] == pytest.approx(cn0, abs=0.04)
            if np.isfinite(phase):
                cycles = (message.phase_range_m[k] / wavelength) - phase
                assert abs(cycles - round(cycles)) * wavelength < 1.5e-4
                arcs.setdefault((satellite, signal), set()).add(round(cycles))
                assert message.phase_range_rate_m_s[k] == pytest.approx(-doppler * wavelength, abs=1e-3)
            compared += 1
    assert compared == sum(key[1] // 64 in (0, 1, 2, 5) for key in expected)
    assert max(len(offsets) for offsets in arcs.values()) == 1  # one alignment an arc


def corrections_in_force(path: Path, t_near_ns: int) -> Any:
    """Ephemerides by (satellite, issue) and the last orbit, clock and bias of each system, message by message."""
    translator = SsrTranslator()
    ephemerides: dict[tuple[int, int], Ephemeris] = {}
    orbits: dict[System, SsrOrbit] = {}
    for message in messages(path):
        assert isinstance(message, Message)
        ephemeris = ephemeris_from_message(message, t_near_ns, t_near_ns)
        if hasattr(ephemeris, "satellite"):
            ephemerides[ephemeris.satellite, ephemeris.issue] = ephemeris
            continue
        translated = translator.translate(message, t_near_ns, t_near_ns)
        assert isinstance(translated, list)
        for correction in translated:
            if isinstance(correction, SsrOrbit):
                orbits[system_of(int(correction.satellite[0]))] = correction
            elif isinstance(correction, SsrClock):
                yield ephemerides, orbits[system_of(int(correction.satellite[0]))], correction
            elif isinstance(correction, SsrCodeBias):
                assert not correction.bias_m.any()
            else:
                assert isinstance(correction, SsrPhaseBias)


def test_corrections_give_the_products_back(products: dict[str, Any], converted: Path) -> None:
    """Oracle: SP3 and CLK interpolated: well under a millimetre over the whole update interval."""
    orbits, _ = read_sp3(products["orbits"])
    tables = build_tables(orbits, read_clocks(products["clocks"]).clocks)
    t_first_ns = next(iter(RinexObservations(products["observations"][0]))).t_gps_ns
    compared: Counter[System] = Counter()
    worst = np.zeros(2)
    for ephemerides, orbit, clock in corrections_in_force(converted / "corrections.rtcm3", t_first_ns):
        satellite = orbit.satellite
        assert (clock.satellite == satellite).all()
        rows = np.array([pack(ephemerides[int(s), int(i)]) for s, i in zip(satellite, orbit.issue, strict=True)])
        packed = np.array([pack_correction(orbit, k, clock, k) for k in range(len(satellite))])
        range_m = np.full(len(satellite), 22e6)
        for after_s in (0, 15, 30):
            t_ns = orbit.header.t_gps_ns + after_s * NS_PER_S
            got = corrected_at_transmission(rows, packed, t_ns, range_m)
            want = precise_at_transmission(tables, satellite, t_ns, range_m)
            assert not got.status.any()
            if t_ns == t_first_ns and want.status.any():
                continue  # transmitted before the clock file's first node
            assert not want.status.any()
            distance = np.linalg.norm(got.position_ecef_m - want.position_ecef_m, axis=1)
            clock_m = np.abs(got.clock_s - want.clock_s) * SPEED_OF_LIGHT_M_S
            worst = np.maximum(worst, [distance.max(), clock_m.max()])
        compared[system_of(int(satellite[0]))] += 1
    assert set(compared) == {System.GPS, System.GLONASS, System.GALILEO}
    assert min(compared.values()) == N_EPOCHS
    assert worst[0] < 7e-4  # along and cross are rounded to 0.4 mm; the eccentric E18 bends by as much in 15 s
    assert worst[1] < 3.5e-4  # the clock's slope changes at its nodes, 75 ms after transmission


def test_summary_and_phase_centres(products: dict[str, Any], folder: Path, converted: Path, tmp_path: Path) -> None:
    """Oracle: the reference point is declared; with ANTEX, radial corrections move by the antennas' z offsets, m."""
    summary = json.loads((converted / "streams.json").read_text())
    assert summary["streams"]["corrections.rtcm3"]["reference_point"] == "centre_of_mass"
    convert(Conversion(**products, out=tmp_path, max_epochs=2, systems="GE", antex=folder / "approx-igs14.atx"))
    summary = json.loads((tmp_path / "streams.json").read_text())
    assert summary["streams"]["corrections.rtcm3"]["reference_point"] == "antenna_phase_centre"
    plain = dict(first_radials(converted))
    moved = dict(first_radials(tmp_path))
    shift = np.array([moved[s] - plain[s] for s in moved])
    assert len(shift) > 30
    assert ((shift > 0.3) & (shift < 3.0)).all()  # towards the Earth: the radial correction, subtracted, grows


def first_radials(folder: Path) -> list[tuple[int, float]]:
    translator, found = SsrTranslator(), dict[int, float]()
    for message in messages(folder / "corrections.rtcm3"):
        if message.number in (1057, 1240):
            translated = translator.translate(message, 1277078400 * NS_PER_S)
            assert isinstance(translated, list)
            orbit = translated[0]
            assert isinstance(orbit, SsrOrbit)
            for satellite, rac in zip(orbit.satellite.tolist(), orbit.delta_rac_m, strict=True):
                found.setdefault(satellite, float(rac[0]))
    return sorted(found.items())
