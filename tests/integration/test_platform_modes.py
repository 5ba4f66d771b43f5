"""Platforms with several antennas and an IMU through the pipeline, chunk by chunk, as live streams come.

Oracles: the simulator's truth; and that the same bytes give the same series on one connection or on several, whenever
time is told, and wherever another worker takes over.
"""

import heapq
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from plumbline.config import Mode, StationSettings
from plumbline.epochs.recording import Piece, read_recording
from plumbline.epochs.stream import Books, NavigationFeed
from plumbline.evaluation import shake_table_files as files
from plumbline.pipeline import Pipeline
from plumbline.records import Floats, Motion, Output, Solution, Status
from plumbline_dtu.shake_table.experiment import HEADING_DEG, PITCH_DEG, ROLL_DEG

T_NEAR_NS = 1_383_904_800 * 10**9
ANGLES = np.array([ROLL_DEG, PITCH_DEG, HEADING_DEG])
OWN = ("imu", "antenna1", "antenna2", "antenna3")


@pytest.fixture(scope="module")
def folder(shaken_platform: Path) -> Path:
    """Simulated streams."""
    return shaken_platform


def settings(folder: Path, mode: Mode, **changes: object) -> StationSettings:
    """Three antennas on one connection."""
    description = files.read_description(folder)
    values: dict[str, object] = {
        "station": "platform",
        "mode": mode,
        "device": {"rtcm_station_ids": (1, 2, 3)},
        "reference_position_ecef_m": description["platform_ecef_m"],
        "positioning": {"systems": "GC", "elevation_mask_deg": 10.0},
        "rtk": {"base_stream": "base", "frequencies": 1, "phase_sigma_m": 0.003},
        "inertial": {
            "lever_arms_body_m": description["lever_arms_body_m"],
            "initial_gyroscope_bias_sigma_rad_s": 1e-5,
            "gyroscope_noise_rad_s_sqrt_hz": 2e-6,
        },
    }
    return StationSettings.model_validate(values | changes)


def merged(folder: Path, own: tuple[str, ...] = OWN) -> list[Piece]:
    """Every stream's frames, each stream with the delay of its own link; receive times never repeat."""
    delays = {"base": 45, "antenna1": 20, "antenna2": 26, "antenna3": 23, "imu": 300}
    parts = []
    for name in ("base", *own):
        pieces = read_recording(folder / f"{name}.rtcm3", name, t_near_ns=T_NEAR_NS)
        parts.append([Piece(p.t_ns + delays[name] * 1_000_000, name, p.data) for p in pieces])
    whole = list(heapq.merge(*parts, key=lambda piece: piece.t_ns))
    return [Piece(p.t_ns + k, p.stream, p.data) for k, p in enumerate(whole)]


def run(
    pieces: list[Piece], station: StationSettings, shared: tuple[str, ...] = ("base",), tick_ns: int | None = None,
    restart_at: Mapping[int, int] | None = None,
) -> list[Output]:  # fmt: skip
    """``restart_at``: piece → how many pieces before it the checkpoint was taken that a restart goes back to."""
    books = Books()
    feeds = {name: NavigationFeed(name, books) for name in shared}
    pipeline, outputs = Pipeline(station, (), books), list[Output]()
    last_ns = pieces[0].t_ns
    for k, piece in enumerate(pieces):
        if restart_at and k in restart_at:
            pipeline = Pipeline.restore(station, (), books, pipeline.snapshot())
        while tick_ns is not None and last_ns + tick_ns < piece.t_ns:
            last_ns += tick_ns
            outputs += pipeline.advance(last_ns)
        last_ns = piece.t_ns
        if piece.stream in feeds:
            feeds[piece.stream].receive(piece.data, piece.t_ns)
        else:
            outputs += pipeline.receive(piece.data, piece.t_ns)
    return outputs + pipeline.finish(pieces[-1].t_ns + 2 * 10**9)


def solutions(outputs: list[Output]) -> list[Solution]:
    """The last word on each epoch."""
    found = {o.t_gps_ns: o for o in outputs if isinstance(o, Solution)}
    return [found[t] for t in sorted(found)]


def motions(outputs: list[Output]) -> list[Motion]:
    """The last revision of each block."""
    found: dict[int, Motion] = {}
    for output in outputs:
        if isinstance(output, Motion):
            assert output.t_first_gps_ns not in found or output.revision > found[output.t_first_gps_ns].revision
            found[output.t_first_gps_ns] = output
    return [found[t] for t in sorted(found)]


def series(outputs: list[Output]) -> list[tuple[object, ...]]:
    """Every number of the final rows, to the bit."""
    rows: list[tuple[object, ...]] = [
        (s.t_gps_ns, s.status, s.reason, _bytes(s.displacement_enu_m), _bytes(s.attitude_rad))
        for s in solutions(outputs)
    ]
    return rows + [
        (m.t_first_gps_ns, m.status, m.reason, _bytes(m.displacement_enu_m), _bytes(m.attitude_rad))
        for m in motions(outputs)
    ]


def _bytes(values: Floats | None) -> bytes:
    return b"" if values is None else values.tobytes()


def off_truth_m(folder: Path, outputs: list[Output]) -> Floats:
    """Horizontal error (n, 2) of the motion samples against the table's, the mean taken out."""
    truth = np.loadtxt(folder / "truth.csv", delimiter=",", skiprows=1)
    blocks = motions(outputs)
    t_s = np.concatenate(
        [(b.t_first_gps_ns + b.interval_ns * np.arange(len(b.displacement_enu_m))) * 1e-9 for b in blocks]
    )
    place = np.concatenate([b.displacement_enu_m[:, :2] for b in blocks])
    error = place - np.column_stack([np.interp(t_s, truth[:, 0], truth[:, k]) for k in (2, 3)])
    late = t_s > t_s[0] + 4.0  # integers are held once they have been the same for a second
    return np.asarray(error[late] - error[late].mean(axis=0))


def test_tight_on_one_connection(folder: Path) -> None:
    outputs = run(merged(folder), settings(folder, Mode.RTK_IMU_TIGHT))
    found = solutions(outputs)
    assert len(found) == 400  # every epoch has a row
    assert all(s.reason for s in found if not s.status.has_position)
    fixed = [s for s in found if s.status is Status.RTK_FIXED]
    assert len(fixed) > 260
    errors_deg = np.degrees([s.attitude_rad for s in fixed[-100:]]) - ANGLES
    assert (np.abs(errors_deg.mean(axis=0)) < [0.1, 0.1, 0.2]).all()
    blocks = motions(outputs)
    assert {b.interval_ns for b in blocks} == {5_000_000}
    assert all(len(b.displacement_enu_m) == 200 for b in blocks[1:-1])
    assert all(b.attitude_rad is not None for b in blocks)
    scatter_mm = 1e3 * off_truth_m(folder, outputs).std(axis=0)
    print("tight, E N:", scatter_mm)
    assert (scatter_mm < 1.5).all()


def test_one_connection_or_several_give_the_same(folder: Path) -> None:
    pieces = merged(folder)
    together = series(run(pieces, settings(folder, Mode.RTK_IMU_TIGHT)))
    apart = settings(
        folder, Mode.RTK_IMU_TIGHT, device={}, antenna_streams=("antenna2", "antenna3"), inertial_stream="imu"
    )
    split = run(pieces, apart, shared=("base", "antenna2", "antenna3", "imu"), tick_ns=20_000_000)
    assert _without_the_end(series(split)) == _without_the_end(together)


def _without_the_end(rows: list[tuple[object, ...]]) -> list[tuple[object, ...]]:
    """The last second is left out: what a station's own stream does not bring is asked for when time is told."""
    limit = T_NEAR_NS + 18 * 10**9
    return [row for row in rows if isinstance(row[0], int) and row[0] < limit]


@pytest.mark.parametrize("mode", [Mode.RTK_IMU_TIGHT, Mode.RTK_IMU_LOOSE, Mode.RTK])
def test_however_time_is_told_and_wherever_it_is_taken_over(folder: Path, mode: Mode) -> None:
    pieces = [piece for piece in merged(folder) if piece.t_ns < T_NEAR_NS + 14 * 10**9]
    station = settings(folder, mode)
    undisturbed = series(run(pieces, station))
    assert series(run(pieces, station, tick_ns=17_000_000)) == undisturbed
    assert series(run(pieces, station, restart_at=dict.fromkeys(range(300, len(pieces), 701), 0))) == undisturbed


def test_the_attitude_of_antennas_alone(folder: Path) -> None:
    """Mode rtk: instantaneous attitude; with a baseline of a metre and phases of 2 mm a few tenths of a degree."""
    found = solutions(run(merged(folder), settings(folder, Mode.RTK)))
    turned = [s for s in found if s.attitude_rad is not None]
    assert len(turned) > 0.9 * len(found)
    assert all("attitude" in s.reason or s.reason for s in found if s.attitude_rad is None)
    errors_deg = np.degrees([s.attitude_rad for s in turned]) - ANGLES
    sigmas_deg = np.degrees([s.sigma_attitude_rad for s in turned])
    print("rms:", np.sqrt((errors_deg**2).mean(axis=0)), "claimed:", np.median(sigmas_deg, axis=0))
    assert (np.abs(np.median(errors_deg, axis=0)) < 0.3).all()
    assert (np.abs(errors_deg) < 6.0 * sigmas_deg).all()


def test_two_antennas_give_two_angles(folder: Path) -> None:
    arms = files.read_description(folder)["lever_arms_body_m"]
    pair = settings(folder, Mode.RTK, device={"rtcm_station_ids": (2, 3)}, inertial={"lever_arms_body_m": arms[1:]})
    turned = [s for s in solutions(run(merged(folder), pair)) if s.attitude_rad is not None]
    assert len(turned) > 300
    angles = np.degrees([s.attitude_rad for s in turned])
    assert np.isnan(angles[:, 1]).all()  # the line from antenna 2 to 3 is the right axis: pitch turns about it
    assert np.abs(np.median(angles[:, [0, 2]], axis=0) - ANGLES[[0, 2]]).max() < 0.5


def test_loose(folder: Path) -> None:
    """The point that moves is the first antenna; its motion is the table's."""
    arms = files.read_description(folder)["lever_arms_body_m"]
    inertial = {"lever_arms_body_m": arms[:1], "heading_deg": HEADING_DEG, "heading_sigma_deg": 0.1}
    station = settings(folder, Mode.RTK_IMU_LOOSE, device={"rtcm_station_ids": (1,)}, inertial=inertial)
    outputs = run(merged(folder), station)
    assert sum(s.status is Status.RTK_FIXED for s in solutions(outputs)) > 380
    blocks = motions(outputs)
    assert len(blocks) > 10
    scatter_mm = 1e3 * off_truth_m(folder, outputs).std(axis=0)
    print("loose, E N:", scatter_mm)
    assert (scatter_mm < 3.0).all()
    angles = np.degrees(np.concatenate([b.attitude_rad for b in blocks if b.attitude_rad is not None]))
    assert np.abs(angles[-400:].mean(axis=0) - ANGLES).max() < 0.3


def test_without_samples_the_rows_say_so(folder: Path) -> None:
    pieces = [p for p in merged(folder) if p.stream != "imu" or p.t_ns < T_NEAR_NS + 10 * 10**9]
    found = solutions(run(pieces, settings(folder, Mode.RTK_IMU_TIGHT)))
    last = found[-1]
    assert last.status is Status.NO_INERTIAL
    assert "no samples of the IMU for" in last.reason
    assert len(found) == 400
