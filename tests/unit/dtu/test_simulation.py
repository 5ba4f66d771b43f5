"""The simulator: what it sends is what its truth says."""

import shutil
import subprocess
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from plumbline.config import read_server_settings
from plumbline.constants import SPEED_OF_LIGHT_M_S, STANDARD_GRAVITY_M_S2
from plumbline.epochs.translate_ephemeris import Rejected, ephemeris_from_message
from plumbline.epochs.translate_ssr import SsrTranslator
from plumbline.errors import ConfigurationError
from plumbline.files.seismic import Series
from plumbline.gnss.orbits_broadcast import broadcast_states, pack
from plumbline.gnss.satellite_states import corrected_at_transmission
from plumbline.gnss.ssr_orbits import pack_correction
from plumbline.gps_time import DAY_NS, NS_PER_S, WEEK_NS, utc_from_gps
from plumbline.records import Ephemeris, Ints, SsrClock, SsrOrbit
from plumbline.rtcm3 import InertialMessage, Message, Observations, decode, scan_frames
from plumbline.signals import System, system_of
from plumbline_dtu.demo import Ports, plans, settings_toml
from plumbline_dtu.simulate_cli import marker_ecef_m
from plumbline_dtu.simulation.accelerometer import Accelerometer, Sampler, sca3300
from plumbline_dtu.simulation.constellation import Constellation, clock_wave_s, simulate_corrections
from plumbline_dtu.simulation.live import Scenario, write_files
from plumbline_dtu.simulation.motion import Motion, Sine, bursts, parse_motion, record, sines, static, steps
from plumbline_dtu.simulation.station import PERFECT, Errors, StationPlan, simulate_station

REFERENCE = 2400 * WEEK_NS
START = REFERENCE + 3 * DAY_NS + 2 * 3600 * NS_PER_S - 20 * NS_PER_S  # 20 s before new broadcast sets
MARKER = marker_ecef_m(55.57, 12.85, 60.0)


@pytest.fixture(scope="module")
def constellation() -> Constellation:
    return Constellation(REFERENCE)


def times(seconds: np.ndarray[tuple[int], np.dtype[np.float64]]) -> Ints:
    return START + np.round(seconds * NS_PER_S).astype(np.int64)


def recorded() -> Motion:
    grid = np.arange(0.0, 20.0, 0.05)
    values = np.column_stack([np.sin(grid) ** 2, grid * 0, np.cos(grid) - 1.0])
    return record(Series(0, 50_000_000, values, "m", ("e", "n", "u")), START)


@pytest.mark.parametrize(
    "motion",
    [
        sines([Sine(0, 0.02, 0.7, 0.3), Sine(2, 0.01, 2.0)]),
        bursts(Sine(1, 0.025, 0.3), 30.0, 20.0),
        steps((0.02, -0.01, 0.0), START + 5 * NS_PER_S),
        recorded(),
    ],
    ids=["sines", "bursts", "steps", "recorded"],
)
def test_motions_are_consistent(motion: Motion) -> None:
    """Oracle: central differences of displacement and velocity."""
    seconds, h = np.linspace(1.03, 18.9, 300), 1e-4
    before, now, after = (motion(times(seconds + shift)) for shift in (-h, 0.0, h))
    velocity = (after.displacement_m - before.displacement_m) / (2 * h)
    acceleration = (after.velocity_m_s - before.velocity_m_s) / (2 * h)
    np.testing.assert_allclose(now.velocity_m_s, velocity, atol=2e-6)
    np.testing.assert_allclose(now.acceleration_m_s2, acceleration, atol=2e-3)
    assert np.abs(now.displacement_m).max() > 0.009


def test_an_acceleration_record_is_integrated() -> None:
    """Oracle: the sine that was differentiated twice by hand: −ω² A sin gives A sin, but for the trend removed."""
    grid, omega = np.arange(0.0, 40.0, 0.01), 2 * np.pi * 0.5
    taper = np.sin(np.pi * grid / 40.0) ** 2
    values = np.column_stack([-(omega**2) * 0.03 * np.sin(omega * grid) * taper, grid * 0, grid * 0])
    motion = record(Series(0, 10_000_000, values, "m/s2", ("e", "n", "u")), START)
    middle = motion(times(np.arange(15.0, 25.0, 0.1))).displacement_m[:, 0]
    assert (middle.max() - middle.min()) / 2 == pytest.approx(0.03, rel=0.1)


def test_motion_texts() -> None:
    """Oracle: the text's own numbers; nonsense is refused."""
    motion = parse_motion("step:0.02,0,-0.01@60", START)
    assert motion(times(np.array([100.0]))).displacement_m[0].tolist() == pytest.approx([0.02, 0.0, -0.01])
    sway = parse_motion("sine:e,0.01,0.5;u,0.02,1.0", START)(times(np.arange(0, 10, 0.01))).displacement_m
    assert np.abs(sway).max(axis=0) == pytest.approx([0.01, 0.0, 0.02], abs=1e-4)
    for text in ("", "wobble", "sine:x,1,1", "step:1,2@3", "file:/does/not/exist.csv"):
        with pytest.raises((ConfigurationError, Exception)):
            parse_motion(text, START)


def named_by(ephemeris: Ephemeris) -> int:
    """The issue that a correction names a set by: BeiDou's is its toe in BDT, units of 8 s modulo 1024."""
    if system_of(ephemeris.satellite) is System.BEIDOU:
        return (ephemeris.toe_gps_ns // NS_PER_S - 14) % 604_800 // 8 % 1024
    return ephemeris.issue


def test_corrections_lead_from_broadcast_to_truth(constellation: Constellation) -> None:
    """Oracle: the true orbits and clocks, also across the change of broadcast sets; corrections are not zero."""
    translator, ephemerides = SsrTranslator(), dict[tuple[int, int], Ephemeris]()
    satellites, rows = constellation.satellites, constellation.rows()
    worst, largest, orbits, checked = np.zeros(2), 0.0, dict[int, SsrOrbit](), 0
    for t_ns, data in simulate_corrections(constellation, START, START + 40 * NS_PER_S):
        for found in scan_frames(data).frames:
            message = decode(found.payload)
            assert isinstance(message, Message)
            ephemeris = ephemeris_from_message(message, t_ns)
            if not isinstance(ephemeris, Rejected):
                ephemerides[ephemeris.satellite, named_by(ephemeris)] = ephemeris
                continue
            translated = translator.translate(message, t_ns)
            assert isinstance(translated, list)
            for correction in translated:
                if isinstance(correction, SsrOrbit):
                    orbits[int(correction.satellite[0]) // 64] = correction
                elif isinstance(correction, SsrClock):
                    orbit = orbits[int(correction.satellite[0]) // 64]
                    own = np.isin(satellites, orbit.satellite)
                    sets = [ephemerides[int(s), int(i)] for s, i in zip(orbit.satellite, orbit.issue, strict=True)]
                    packed = np.array([pack_correction(orbit, k, correction, k) for k in range(len(sets))])
                    ranges = np.full(len(sets), 2.2e7)
                    at_ns = t_ns + 3 * NS_PER_S
                    got = corrected_at_transmission(np.array([pack(e) for e in sets]), packed, at_ns, ranges)
                    flight_ns = np.round(ranges / SPEED_OF_LIGHT_M_S * 1e9).astype(np.int64)
                    t_tx = at_ns - flight_ns - np.round(got.clock_s * 1e9).astype(np.int64)
                    want = broadcast_states(rows[own], t_tx)
                    clock_s = want.clock_s + clock_wave_s(satellites[own], t_tx)
                    distance = np.linalg.norm(got.position_ecef_m - want.position_ecef_m, axis=1)
                    worst = np.maximum(
                        worst, [distance.max(), np.abs(got.clock_s - clock_s).max() * SPEED_OF_LIGHT_M_S]
                    )
                    largest, checked = max(largest, float(np.abs(orbit.delta_rac_m).max())), checked + 1
    assert checked == 9 * 3
    assert largest > 0.5
    assert worst[0] < 1e-2  # the instant of transmission is found to 1 ns of clock: 4 µm; rounding 0.4 mm
    assert worst[1] < 3e-4


def test_the_same_plan_gives_the_same_bytes(constellation: Constellation) -> None:
    """Oracle: a second run; every byte is a frame; slips restart the lock time, and the rest of an arc counts on."""
    plan = StationPlan("a", MARKER, errors=Errors(slips_per_hour=120.0), accelerometer=sca3300(100, 3), seed=5)
    first = list(simulate_station(plan, constellation, START, START + 20 * NS_PER_S))
    assert first == list(simulate_station(plan, constellation, START, START + 20 * NS_PER_S))
    scan = scan_frames(b"".join(data for _, data in first))
    assert not scan.rejected_bytes
    messages = [decode(found.payload) for found in scan.frames]
    assert sum(isinstance(message, InertialMessage) for message in messages) == 21
    locks: dict[tuple[int, int], list[float]] = {}
    for message in messages:
        if isinstance(message, Observations):
            for satellite, signal, lock in zip(message.satellite, message.signal, message.lock_time_s, strict=True):
                locks.setdefault((int(satellite), int(signal)), []).append(float(lock))
    falls = sum(b < a for values in locks.values() for a, b in pairwise(values))
    expected = 120.0 / 3600.0 * sum(len(values) for values in locks.values())
    assert 0.5 * expected < falls < 1.5 * expected


def test_accelerometer_at_rest() -> None:
    """Oracle: gravity turned by the mounting, plus bias; the scatter that was asked for; 100 Hz time stamps."""
    angle = np.radians(2.0)
    tilted = ((1.0, 0.0, 0.0), (0.0, np.cos(angle), -np.sin(angle)), (0.0, np.sin(angle), np.cos(angle)))
    sensor = Accelerometer((1e-3, 2e-3, 3e-3), (0.1, 0.0, 0.0), 0.0, 1e-6, tilted)
    sampler = Sampler(sensor, static(), 100, 1)
    blocks = [sampler.block(START + k * NS_PER_S, 0, 100) for k in range(60)]
    samples = np.vstack([block.specific_force_m_s2 for block in blocks])
    g = STANDARD_GRAVITY_M_S2
    assert samples.mean(axis=0) == pytest.approx([0.1, g * np.sin(angle), g * np.cos(angle)], abs=2e-4)
    assert samples.std(axis=0) == pytest.approx([1e-3, 2e-3, 3e-3], rel=0.05)
    assert (blocks[1].t_first_gps_ns, blocks[1].interval_ns) == (START + NS_PER_S, 10_000_000)


def test_rtklib_finds_the_station(constellation: Constellation, tmp_path: Path) -> None:
    """Oracle: RTKLIB's convbin and rnx2rtkp: single point solutions a metre from the marker, as good as the broadcast.

    No ionosphere is simulated and none modelled: orbits, clocks, Earth's turn, relativity and troposphere must agree.
    """
    if not shutil.which("convbin") or not shutil.which("rnx2rtkp"):
        pytest.skip("RTKLIB's programs are not installed")
    plan = StationPlan("a", MARKER, errors=PERFECT)
    write_files(Scenario([plan], constellation, None), tmp_path, START, 60)
    begin = utc_from_gps(START + 18 * NS_PER_S)
    day, clock = begin.strftime("%Y/%m/%d"), begin.strftime("%H:%M:%S")
    obs, nav = tmp_path / "a.obs", tmp_path / "a.nav"
    command = ["convbin", "-r", "rtcm3", "-v", "3.04", "-tr", day, clock, "-o", obs, "-n", nav, tmp_path / "a.rtcm3"]
    subprocess.run(command, check=True, capture_output=True, timeout=60)
    (tmp_path / "single.conf").write_text(
        "pos1-posmode=single\npos1-ionoopt=off\npos1-tropopt=saas\npos1-navsys=41\nout-solformat=xyz\n"
    )
    out = tmp_path / "a.pos"
    subprocess.run(
        ["rnx2rtkp", "-k", tmp_path / "single.conf", "-o", out, obs, nav], check=True, capture_output=True, timeout=60
    )
    rows = [line.split() for line in out.read_text().splitlines() if not line.startswith("%")]
    positions = np.array([[float(part) for part in row[2:5]] for row in rows])
    assert len(positions) > 50
    assert np.linalg.norm(positions.mean(axis=0) - MARKER) < 2.5
    assert np.linalg.norm(positions.std(axis=0)) < 0.2


def test_demo_settings_are_valid(tmp_path: Path) -> None:
    """Oracle: the server's own reader of settings."""
    (tmp_path / "demo.toml").write_text(settings_toml(tmp_path / "data", Ports(19401, 19402)), encoding="utf-8")
    settings = read_server_settings(tmp_path / "demo.toml")
    assert [station.station for station in settings.stations] == ["corrections", *(plan.name for plan in plans())]
    assert settings.stations[0].device.heartbeat == r"$DTU,alive\x0d\x0a"
    assert {threshold.station for threshold in settings.thresholds} == {"main-span"}
    assert settings.ingest_port == 19402
