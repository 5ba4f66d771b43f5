"""Oracle: RTKLIB EX (pyrtklib5) on the same products: orbits, clocks, Sun, Moon, tides, directions, mapping."""

import gzip
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from plumbline.files.rinex_clock import read_clocks
from plumbline.files.rinex_navigation import read_navigation
from plumbline.files.sp3 import read_sp3
from plumbline.gnss.earth_frames import azimuth_elevation, geodetic_from_ecef, rotation_enu_from_ecef
from plumbline.gnss.orbits_broadcast import KEPLER_GEO, KIND, broadcast_states, pack
from plumbline.gnss.orbits_precise import PreciseTables, build_tables
from plumbline.gnss.satellite_states import precise_states
from plumbline.gnss.ssr_orbits import rotation_ecef_from_rac
from plumbline.gnss.sun_moon import sun_moon_ecef
from plumbline.gnss.tides import ocean_loading_enu_m, solid_earth_tide_ecef_m
from plumbline.gnss.troposphere import map_troposphere, troposphere_site
from plumbline.gps_time import NS_PER_S, WEEK_NS, gps_minus_utc_s, gps_ns_from_calendar, week_and_tow_ns
from plumbline.records import Ephemeris
from plumbline.signals import satellite_name, satellite_of_name, system_of

rt: Any = pytest.importorskip("pyrtklib5")
pytestmark = pytest.mark.realdata

C = 299_792_458.0
STATION = [3582104.7628, 532590.1800, 5232755.1333]
T_NS = gps_ns_from_calendar(2020, 6, 25, 6, 0, 0)
NAVIGATION = "ESBC00DNK_R_20201770000_01D_MN.rnx"
SP3 = ["GRG0MGXFIN_20201760000_01D_15M_ORB.SP3", "GRG0MGXFIN_20201770000_01D_15M_ORB.SP3"]
CLK = "GRG0MGXFIN_20201770000_01D_30S_CLK.CLK"


def _time(t_gps_ns: int) -> Any:
    week, tow_ns = week_and_tow_ns(t_gps_ns)
    return rt.gpst2time(week, tow_ns * 1e-9)


def _gps_ns(time: Any) -> int:
    week = rt.Arr1Dint(1)
    tow_s = rt.time2gpst(time, week)
    return int(week[0] * WEEK_NS + round(tow_s * NS_PER_S))


def _doubles(values: Any) -> Any:
    array = rt.Arr1Ddouble(len(values))
    for i, value in enumerate(values):
        array[i] = float(value)
    return array


def _list(array: Any, n: int) -> np.ndarray:
    return np.array([array[i] for i in range(n)])


def _name(satellite: int) -> str:
    number = rt.Arr1Dint(1)
    system = rt.satsys(satellite, number)
    letter = {rt.SYS_GPS: "G", rt.SYS_GLO: "R", rt.SYS_GAL: "E", rt.SYS_CMP: "C", rt.SYS_QZS: "J"}.get(system, "?")
    return f"{letter}{number[0] - (192 if letter == 'J' else 0):02d}"


@pytest.fixture(scope="module")
def folder(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording's files, unpacked for RTKLIB."""
    out = tmp_path_factory.mktemp("esbc")
    for name in [NAVIGATION, *SP3, CLK]:
        (out / name).write_bytes(gzip.decompress((data_dir / "esbc-2020-177" / f"{name}.gz").read_bytes()))
    return out


@pytest.fixture(scope="module")
def rtklib(folder: Path) -> Any:
    """RTKLIB's navigation data with broadcast and precise products."""
    nav = rt.nav_t()
    assert rt.readrnx(str(folder / NAVIGATION), 1, "", rt.obs_t(), nav, rt.sta_t()) == 1
    for name in SP3:
        rt.readsp3(str(folder / name), nav, 0)
    rt.readrnxc(str(folder / CLK), nav)
    return nav


@pytest.fixture(scope="module")
def ephemerides(folder: Path) -> list[Ephemeris]:
    return list(read_navigation(folder / NAVIGATION).ephemerides)


@pytest.fixture(scope="module")
def tables(folder: Path) -> PreciseTables:
    orbits, _ = read_sp3([folder / name for name in SP3])
    return build_tables(orbits, read_clocks([folder / CLK]).clocks)


def _compare(records: Any, count: int, mine: dict[tuple[str, int], Ephemeris], model: Callable[..., None], after_s: int
) -> dict[str, list[tuple[float, float]]]:  # fmt: skip
    """Position [m] and clock [m] differences by system over all broadcast records that both have."""
    found: dict[str, list[tuple[float, float]]] = {}
    for i in range(count):
        record = records[i]
        ephemeris = mine.get((_name(record.sat), _gps_ns(record.toe)))
        if ephemeris is None:
            continue
        t_gps_ns = ephemeris.toe_gps_ns + after_s * NS_PER_S
        position, clock = rt.Arr1Ddouble(3), rt.Arr1Ddouble(1)
        model(_time(t_gps_ns), record, position, clock, rt.Arr1Ddouble(1))
        row = pack(ephemeris)
        state = broadcast_states(row[None], np.array([t_gps_ns]))
        key = _name(record.sat)[0] + ("geo" if row[KIND] == KEPLER_GEO else "")
        difference = float(np.abs(state.position_ecef_m[0] - _list(position, 3)).max())
        found.setdefault(key, []).append((difference, float(state.clock_s[0] - clock[0]) * C))
    return found


def test_kepler_orbits(rtklib: Any, ephemerides: list[Ephemeris]) -> None:
    mine = {(satellite_name(e.satellite), e.toe_gps_ns): e for e in ephemerides if getattr(e, "message", "") != "FNAV"}
    found = _compare(rtklib.eph, rtklib.n, mine, rt.eph2pos, 1234)
    assert {k: len(v) for k, v in found.items() if len(v) < 10} == {}
    assert set(found) >= {"G", "E", "C", "Cgeo", "J"}
    for key, differences in found.items():
        assert max(d for d, _ in differences) < 1e-6, key
        if key in ("G", "C", "Cgeo", "J"):  # relativity from r·v here, from the eccentric anomaly there
            assert max(abs(c) for _, c in differences) < 0.05, key


def test_glonass_orbits(rtklib: Any, ephemerides: list[Ephemeris]) -> None:
    mine = {(satellite_name(e.satellite), e.toe_gps_ns): e for e in ephemerides}
    found = _compare(rtklib.geph, rtklib.ng, mine, rt.geph2pos, 700)["R"]
    assert len(found) > 400
    assert max(d for d, _ in found) < 2e-3
    assert max(abs(c) for _, c in found) < 1e-6


def test_precise_orbits_and_clocks(rtklib: Any, tables: PreciseTables) -> None:
    """RTKLIB interpolates to order ten; on the eccentric E14 that costs it a centimetre: that one is left out."""
    for name in ("G01", "G07", "G21", "E01", "E11", "E30", "R05", "R20"):
        satellite = rt.satid2no(name)
        ids = np.array([satellite_of_name(name)], np.int16)
        for k in range(0, 43_000, 1777):
            t_gps_ns = T_NS - 5 * 3600 * NS_PER_S + k * NS_PER_S
            state, clock = rt.Arr1Ddouble(6), rt.Arr1Ddouble(2)
            if not rt.peph2pos(_time(t_gps_ns), satellite, rtklib, 0, state, clock, rt.Arr1Ddouble(1)):
                continue
            got = precise_states(tables, ids, np.array([t_gps_ns]))
            assert got.status[0] == 0
            assert got.position_ecef_m[0] == pytest.approx(_list(state, 3), abs=1.5e-3)
            assert got.velocity_ecef_m_s[0] == pytest.approx(_list(state, 6)[3:], abs=5e-4)
            assert got.clock_s[0] * C == pytest.approx(clock[0] * C, abs=1e-3)


def test_broadcast_agrees_with_precise_to_its_own_error(tables: PreciseTables, ephemerides: list[Ephemeris]) -> None:
    """Oracle: the analysis centre's orbits: radially apart by the antennas' offsets; the rest is broadcast error."""
    apart: dict[str, list[np.ndarray]] = {}
    for e in ephemerides:
        letter = system_of(e.satellite).letter
        t_gps_ns = np.array([e.toe_gps_ns + 300 * NS_PER_S])
        if letter not in "GRE" or e.health != 0:
            continue
        precise = precise_states(tables, np.array([e.satellite], np.int16), t_gps_ns)
        if precise.status[0] == 0:
            broadcast = broadcast_states(pack(e)[None], t_gps_ns)
            axes = rotation_ecef_from_rac(precise.position_ecef_m[0], precise.velocity_ecef_m_s[0])
            apart.setdefault(letter, []).append(axes.T @ (broadcast.position_ecef_m[0] - precise.position_ecef_m[0]))
    for letter, radial, rms in (("G", -1.0, 1.3), ("E", -0.8, 0.5), ("R", -2.1, 3.0)):
        rac = np.array(apart[letter])
        assert len(rac) > 150
        assert rac[:, 0].mean() == pytest.approx(radial, abs=0.3)
        assert np.sqrt(np.mean(rac[:, 1:] ** 2, axis=0)).max() < rms


def test_sun_moon_and_solid_tide() -> None:
    """RTKLIB turns a series of date by the precession once more: 17′ off in 2020. ERFA is the sharp test of the Sun."""
    for hour in (0, 6, 14, 20):
        t_gps_ns = T_NS + hour * 3600 * NS_PER_S
        utc, sun, moon = rt.gpst2utc(_time(t_gps_ns)), rt.Arr1Ddouble(3), rt.Arr1Ddouble(3)
        rt.sunmoonpos(utc, _doubles([0.0] * 5), sun, moon, rt.Arr1Ddouble(1))
        got_sun, got_moon = sun_moon_ecef(t_gps_ns, gps_minus_utc_s(t_gps_ns))
        assert np.linalg.norm(got_sun - _list(sun, 3)) < 1.5e11 * math.radians(18 / 60)
        assert np.linalg.norm(got_moon - _list(moon, 3)) < 3.9e8 * math.radians(25 / 60)
        tide = _doubles([0.0] * 3)
        rt.tidedisp(utc, _doubles(STATION), 1, rt.erp_t(), _doubles([0.0] * 66), tide)
        got = solid_earth_tide_ecef_m(np.array(STATION), got_sun, got_moon, t_gps_ns, 18.0)
        assert got == pytest.approx(_list(tide, 3), abs=2e-3)  # RTKLIB: K1 alone of the frequency-dependent terms


def test_ocean_loading() -> None:
    """RTKLIB EX interpolates 342 tides from the eleven (HARDISP; phases negative for lags): 5 % of rms apart."""
    amplitude = np.array([[312, 101, 66, 27, 60, 42, 19, 8, 6, 4, 3], [80, 26, 17, 7, 13, 10, 4, 2, 1, 1, 1],
                          [45, 13, 9, 4, 9, 6, 3, 1, 1, 1, 0]]) * 1e-4  # fmt: skip
    phase = np.array([[-60, -25, -80, -27, -55, -110, -56, 160, 5, 12, 3],
                      [80, 115, 60, 112, 90, 50, 91, -20, 30, 20, 5],
                      [20, 45, 0, 40, -150, 170, -151, 120, -60, -70, 10]])  # fmt: skip
    geodetic = geodetic_from_ecef(np.array(STATION))
    rotation = rotation_enu_from_ecef(geodetic[0], geodetic[1])
    coefficients = _doubles(np.concatenate([amplitude.T.ravel(), -phase.T.ravel()]))
    theirs, ours = [], []
    for hour in range(0, 24 * 28, 7):
        t_gps_ns, tide = T_NS + hour * 3600 * NS_PER_S, _doubles([0.0] * 3)
        rt.tidedisp(rt.gpst2utc(_time(t_gps_ns)), _doubles(STATION), 2, rt.erp_t(), coefficients, tide)
        theirs.append(rotation @ _list(tide, 3))
        ours.append(ocean_loading_enu_m(amplitude, np.radians(phase), t_gps_ns, 18.0))
    apart = np.sqrt(np.mean((np.array(ours) - theirs) ** 2, axis=0))
    assert np.all(apart < 0.06 * np.sqrt(np.mean(np.square(theirs), axis=0)))


def test_azimuth_elevation_and_mapping() -> None:
    """Niell's mapping functions there, GMF here: within 1 % at 5°, 0.1 % from 20° up."""
    geodetic = geodetic_from_ecef(np.array(STATION))
    rotation = rotation_enu_from_ecef(geodetic[0], geodetic[1])
    site = troposphere_site(geodetic[0], geodetic[1], geodetic[2], T_NS)
    for azimuth, elevation, tolerance in ((0.3, 5.0, 1e-2), (2.0, 20.0, 1e-3), (5.9, 70.0, 1e-4)):
        e = math.radians(elevation)
        unit = np.array([math.cos(e) * math.sin(azimuth), math.cos(e) * math.cos(azimuth), math.sin(e)]) @ rotation
        angles, wet = rt.Arr1Ddouble(2), rt.Arr1Ddouble(1)
        rt.satazel(_doubles(geodetic), _doubles(unit), angles)
        got = azimuth_elevation(unit[None], rotation)
        assert (got[0][0], got[1][0]) == pytest.approx((angles[0], angles[1]), abs=1e-12)
        dry = rt.tropmapf(_time(T_NS), _doubles(geodetic), angles, wet)
        hydrostatic, wet_factor, _, _ = map_troposphere(site, azimuth, e)
        assert hydrostatic == pytest.approx(dry, rel=tolerance)
        assert wet_factor == pytest.approx(wet[0], rel=tolerance)
