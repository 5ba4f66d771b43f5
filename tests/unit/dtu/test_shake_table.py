"""The shaking table: the paper's numbers, and streams that say what the truth says."""

import math
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from plumbline.fusion.strapdown import step_ecef
from plumbline.gnss.earth_frames import geodetic_from_ecef
from plumbline.gnss.orbits_broadcast import broadcast_states, pack
from plumbline.gps_time import NS_PER_S, WEEK_NS
from plumbline.rtcm3 import InertialMessage, Observations, decode, scan_frames
from plumbline.signals import System, satellite_id
from plumbline_dtu.shake_table import imu, receiver
from plumbline_dtu.shake_table.experiment import (
    HEADING_DEG,
    PERFECT,
    PERFECT_IMU,
    START_GPS_NS,
    Experiment,
    ImuErrors,
    lever_arms_body_m,
    rotation_enu_from_body,
    schedule,
    table_direction_enu,
    table_motion,
)
from plumbline_dtu.shake_table.sky import constellation
from plumbline_dtu.shake_table.surroundings import Surroundings, multipath, surroundings
from plumbline_dtu.shake_table.write import simulate
from plumbline_dtu.simulation.geosynchronous import GEOSTATIONARY_DEG, is_beidou_2

SHORT = schedule(rest_s=2.0, minute_s=6.0, pause_s=1.0, between_s=1.0)


def test_the_papers_numbers() -> None:
    """Oracle: Dai 2024, section 3: day and second, 50 m, 1 m triangle, ten minutes of rest, eight vibrations."""
    experiment = Experiment()
    assert START_GPS_NS % WEEK_NS == 122_400 * NS_PER_S
    assert np.linalg.norm(experiment.base_ecef_m - experiment.platform_ecef_m) == pytest.approx(50.0, abs=0.5)
    arms = lever_arms_body_m()
    for i, j in ((0, 1), (1, 2), (2, 0)):
        assert np.linalg.norm(arms[i] - arms[j]) == pytest.approx(1.0, abs=1e-12)
    plan = experiment.schedule
    assert plan.vibrations[0].start_s == plan.rest_s == 600.0
    assert [v.lasting_s for v in plan.vibrations] == [60.0, 60.0, 240.0, 60.0] * 2
    assert [v.parts for v in plan.vibrations[:4]] == [v.parts for v in plan.vibrations[4:]]
    assert [f for v in plan.vibrations[:4] for _, f in v.parts] == [0.50, 0.67, 0.11, 0.34, 0.80]
    assert plan.vibrations[4].start_s - plan.vibrations[3].start_s - 60.0 == 240.0
    forward = rotation_enu_from_body() @ [0.0, 1.0, 0.0]
    assert math.degrees(math.atan2(forward[0], forward[1])) == pytest.approx(HEADING_DEG)


def test_motion_is_consistent() -> None:
    """Oracle: central differences; the commanded amplitude along the table's direction, nothing across it."""
    plan, h = schedule(), 100_000
    times = START_GPS_NS + np.round(np.arange(595.0, 760.0, 0.013) * NS_PER_S).astype(np.int64)
    before, now, after = (table_motion(plan, times + shift) for shift in (-h, 0, h))
    step_s = 2.0 * h / NS_PER_S
    np.testing.assert_allclose(now.velocity_m_s, (after.displacement_m - before.displacement_m) / step_s, atol=2e-6)
    np.testing.assert_allclose(now.acceleration_m_s2, (after.velocity_m_s - before.velocity_m_s) / step_s, atol=2e-5)
    along = now.displacement_m @ table_direction_enu()
    assert np.abs(along).max() == pytest.approx(0.019, abs=1e-5)
    np.testing.assert_allclose(now.displacement_m, np.outer(along, table_direction_enu()), atol=1e-15)


def messages(data: list[tuple[int, bytes]]) -> list[object]:
    scan = scan_frames(b"".join(part for _, part in data))
    assert not scan.rejected_bytes
    return [decode(found.payload) for found in scan.frames]


def test_as_many_satellites_as_the_paper_saw() -> None:
    """Oracle: section 3: 8–9 GPS and 16–17 BeiDou at antennas 1 and 3 and the base, 8 of BeiDou-2 at antenna 2."""
    whole = Experiment(levels=PERFECT).schedule.duration_s
    times = START_GPS_NS + np.arange(0, round(whole), 30, dtype=np.int64) * NS_PER_S
    for station in (0, 1, 2, 3):
        satellites = receiver._satellites(Experiment(), station)
        seen, _, _, _ = receiver._geometry(Experiment(), station, satellites, times)
        up = receiver.visible(seen.azimuth_rad, seen.elevation_rad)
        gps = satellites.satellite < 64
        assert set(up[:, gps].sum(axis=1).tolist()) <= {8, 9}
        if station == 2:
            assert set(up[:, ~gps].sum(axis=1).tolist()) == {8}
            assert all(is_beidou_2(int(s)) for s in satellites.satellite[~gps])
        else:
            assert set(up[:, ~gps].sum(axis=1).tolist()) == {16, 17}
        low = np.degrees(seen.elevation_rad) < 30.0
        azimuth = np.degrees(seen.azimuth_rad)
        assert not (up & low & (azimuth > 90.0) & (azimuth < 180.0)).any()


def test_geostationary_satellites_stand_still() -> None:
    """Oracle: their table of longitudes, the equator; broadcast sets of other hours agree to metres."""
    sky = constellation()
    for hours in (0.0, 5.3):
        t_ns = START_GPS_NS + round(hours * 3600) * NS_PER_S
        sets = sky.broadcast(t_ns)
        for number, longitude in GEOSTATIONARY_DEG.items():
            satellite = satellite_id(System.BEIDOU, number)
            rows = np.array([pack(sky.truth[satellite]), pack(sets[satellite])])
            states = broadcast_states(rows, np.full(2, t_ns))
            place = geodetic_from_ecef(states.position_ecef_m[0])
            assert math.degrees(place[1]) == pytest.approx(longitude, abs=0.05)
            assert math.degrees(place[0]) == pytest.approx(0.0, abs=0.01)
            assert np.linalg.norm(states.position_ecef_m[1] - states.position_ecef_m[0]) < 6.0
            assert np.linalg.norm(states.velocity_ecef_m_s[0]) < 3.0


def test_perfect_samples_lead_along_the_truth() -> None:
    """Oracle: the table's displacement, after mechanising what a perfect IMU says."""
    experiment = Experiment(schedule=SHORT, imu=PERFECT_IMU)
    n = 200 * 20
    times = START_GPS_NS + 5_000_000 * np.arange(n + 1, dtype=np.int64)
    force, rate = imu.true_samples(experiment, times)
    nav = np.zeros(21)
    nav[0:3] = experiment.platform_ecef_m
    nav[6:15] = (experiment.enu.T @ rotation_enu_from_body()).ravel()
    path = np.empty((n, 3))
    for k in range(n):
        step_ecef(nav, 0.5 * (force[k] + force[k + 1]), 0.5 * (rate[k] + rate[k + 1]), 0.005, np.empty(3))
        path[k] = experiment.enu @ (nav[0:3] - experiment.platform_ecef_m)
    truth = table_motion(experiment.schedule, times[1:]).displacement_m
    assert np.abs(truth).max() > 0.015
    np.testing.assert_allclose(path, truth, atol=2e-5)


def test_imu_noise_is_table_1s() -> None:
    """Oracle: the density times the root of the rate is the scatter; the bias at the start is one of its kind."""
    experiment = Experiment(seed=4, schedule=replace(SHORT, duration_s=60.0))
    found = [m for m in messages(list(imu.sample(experiment))) if isinstance(m, InertialMessage)]
    force = np.vstack([m.specific_force_m_s2 for m in found])
    rate = np.vstack([m.angular_rate_rad_s for m in found if m.angular_rate_rad_s is not None])
    times = START_GPS_NS + 5_000_000 * np.arange(len(force), dtype=np.int64)
    true_force, true_rate = imu.true_samples(experiment, times)
    assert len(force) == 60 * 200
    assert found[1].tow_ms - found[0].tow_ms == 250
    assert found[0].interval_us == 5000
    density, rate_density = 0.046e-3 * 9.80665, math.radians(0.0035) / 60.0
    assert (force - true_force).std(axis=0) == pytest.approx([density * math.sqrt(200.0)] * 3, rel=0.03)
    assert (rate - true_rate).std(axis=0) == pytest.approx([rate_density * math.sqrt(200.0)] * 3, rel=0.03)
    assert np.abs((force - true_force).mean(axis=0)).max() < 5.0 * ImuErrors().start_factor * 0.0241e-3 * 9.8


def test_multipath_of_one_wall() -> None:
    """Oracle: the law of a single copy, written out; and a plain NumPy sum of several."""
    random = np.random.default_rng(3)
    unit = random.normal(size=(5, 4, 3))
    unit /= np.linalg.norm(unit, axis=2, keepdims=True)
    antenna, wavelength = random.normal(size=(5, 3)), np.full(4, 0.19)
    place = random.normal(size=(3, 3)) * 10.0
    strength, start = random.uniform(0.0, 0.2, (4, 3)), random.uniform(0.0, 6.0, (4, 3))
    phase, code = multipath(unit, antenna, place, strength, start, wavelength)
    away = place[None] - antenna[:, None]
    detour = np.linalg.norm(away, axis=2)[:, None, :] - np.einsum("esi,eki->esk", unit, away)
    gain = 0.3 + 0.7 * np.sqrt(1.0 - unit[..., 2] ** 2)
    copies = gain[..., None] * strength * np.exp(1j * (2 * np.pi * detour / 0.19 + start))
    np.testing.assert_allclose(phase, 0.19 / (2 * np.pi) * np.angle(1.0 + copies.sum(axis=2)), atol=1e-12)
    np.testing.assert_allclose(code, (copies.real * np.minimum(detour, 4.0)).sum(axis=2), atol=1e-12)
    none, _ = multipath(unit, antenna, place, 0.0 * strength, start, wavelength)
    assert not none.any()


def test_surroundings_are_of_the_seed() -> None:
    """Oracle: the same seed; and the strength asked for, root mean square, over many satellites."""

    def of(seed: int) -> Surroundings:
        return surroundings(400, 0.3, [seed])

    np.testing.assert_array_equal(of(1).strength, of(1).strength)
    assert not np.array_equal(of(1).scatterer_enu_m, of(2).scatterer_enu_m)
    assert np.sqrt((of(1).strength ** 2).sum(axis=1).mean()) == pytest.approx(0.3, rel=0.1)


def test_the_same_seed_gives_the_same_bytes() -> None:
    """Oracle: a second run; 20 Hz, one signal a system; locks count on."""
    experiment = Experiment(schedule=replace(SHORT, duration_s=3.0))
    first = list(receiver.receive(experiment, 1))
    assert first == list(receiver.receive(experiment, 1))
    assert first != list(receiver.receive(replace(experiment, seed=2), 1))
    assert [t for t, _ in first] == [START_GPS_NS + k * 50_000_000 for k in range(60)]
    found = [m for m in messages(first) if isinstance(m, Observations)]
    assert len(found) == 120
    assert {(int(m.system), int(s)) for m in found for s in m.signal} == {(0, 1), (5, 161)}
    assert min(m.lock_time_s.min() for m in found) >= 256.0


@pytest.mark.skipif(not shutil.which("rnx2rtkp"), reason="RTKLIB's programs are not installed")
def test_rtklib_follows_the_table(tmp_path: Path) -> None:
    """Oracle: RTKLIB fixes what perfect receivers send, antenna 1 against the base, and finds the table's motion."""
    experiment = Experiment(schedule=schedule(rest_s=5.0, minute_s=6.0, pause_s=1.0, between_s=1.0), levels=PERFECT)
    experiment = replace(experiment, schedule=replace(experiment.schedule, duration_s=20.0))
    simulate(experiment, tmp_path)
    for name in ("base", "antenna1"):
        subprocess.run(
            ["convbin", "-r", "rtcm3", "-v", "3.04", "-tr", "2023/11/13", "10:00:00", "-o", f"{name}.obs", "-n",
             f"{name}.nav", f"{name}.rtcm3"], cwd=tmp_path, check=True, capture_output=True, timeout=60,
        )  # fmt: skip
    (tmp_path / "k.conf").write_text(
        "pos1-posmode=kinematic\npos1-frequency=l1\npos1-elmask=10\npos1-navsys=33\npos1-tropopt=saas\n"
        "pos2-armode=continuous\npos2-bdsarmode=on\nout-solformat=xyz\n"
    )
    base = [f"{value:.5f}" for value in experiment.base_ecef_m]
    subprocess.run(
        ["rnx2rtkp", "-k", "k.conf", "-r", *base, "-o", "a.pos", "antenna1.obs", "base.obs", "base.nav"],
        cwd=tmp_path, check=True, capture_output=True, timeout=120,
    )  # fmt: skip
    rows = [line.split() for line in (tmp_path / "a.pos").read_text().splitlines() if not line.startswith("%")]
    assert len(rows) == 400
    assert {row[5] for row in rows[20:]} == {"1"}
    places = np.array([[float(part) for part in row[2:5]] for row in rows])
    times = START_GPS_NS + 50_000_000 * np.arange(400, dtype=np.int64)
    truth = table_motion(experiment.schedule, times).displacement_m
    found = (places - receiver.antenna_ecef_m(experiment, 1)) @ experiment.enu.T
    assert np.abs(truth[:, 0]).max() > 0.014
    error = np.abs(found - truth)[20:]
    assert error[:, :2].max() < 5e-4  # MSM7's phases come in steps of 0.14 mm
    assert error[:, 2].max() < 4e-3  # twelve metres of height in RTKLIB's own troposphere
