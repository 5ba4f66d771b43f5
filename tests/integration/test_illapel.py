"""The Illapel earthquake of 2015-09-16 (Mw 8.3): accelerometer C1.CO03 and GNSS displacements PEDR, 8 m apart.

Oracles: GNSS epochs not yet seen (one-step innovations) and never seen (withheld), and the daily static offset.
"""

from pathlib import Path

import numpy as np
import pytest

from plumbline.config import FusionSettings
from plumbline.files.seismic import Series, read_components
from plumbline.fusion.offline import FusedSeries, fuse_series
from plumbline.gps_time import NS_PER_S
from plumbline.quality.doubt import Watch, accelerometer_says, own_shows
from plumbline.records import Floats, Solution, Status

pytestmark = pytest.mark.realdata

DOCUMENTED_ROTATION_DEG = 15.0  # E' = E cos + N sin


@pytest.fixture(scope="module")
def recording(data_dir: Path) -> tuple[Series, Series]:
    folder = data_dir / "illapel-2015"
    if not folder.is_dir():
        pytest.skip(f"no recordings at {folder}")
    gnss = read_components([folder / f"pedr.LX{c}.SAC" for c in "ENZ"])
    accelerometer = read_components(
        [folder / f"C1.CO03.HN{c}.sac" for c in "ENZ"], tuple(folder / f"SAC_PZs_C1_CO03_HN{c}___" for c in "ENZ")
    )
    return gnss, accelerometer


def fused(
    recording: tuple[Series, Series], rotation_deg: float, offset_s: float = 0.0, every: int = 1, **changes: float
) -> FusedSeries:
    gnss, accelerometer = recording
    c, s = float(np.cos(np.radians(rotation_deg))), float(np.sin(np.radians(rotation_deg)))
    settings = FusionSettings(
        rotation_enu_from_sensor=((c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)),
        inertial_time_offset_s=offset_s,
        **changes,
    )
    return fuse_series(
        gnss.t_gps_ns,
        gnss.values,
        accelerometer.t_first_gps_ns,
        accelerometer.interval_ns,
        accelerometer.values,
        settings,
        withheld=np.arange(len(gnss.values)) % every != 0,
        gravity_removed=True,
    )


def rms_mm(values: Floats) -> Floats:
    return np.asarray(1e3 * np.sqrt(np.nanmean(np.square(values), axis=0)), float)


def innovations(series: FusedSeries) -> Floats:
    assert all(v.applied for v in series.innovations)
    return np.array([v.innovation_enu_m for v in series.innovations])


def test_one_step_innovations(recording: tuple[Series, Series]) -> None:
    rms = rms_mm(innovations(fused(recording, DOCUMENTED_ROTATION_DEG)))
    print("one-step innovation RMS, mm:", rms)
    assert (rms <= [2.8, 2.7, 4.4]).all()


def test_three_of_four_epochs_withheld(recording: tuple[Series, Series]) -> None:
    gnss = recording[0]
    errors = gnss.values - fused(recording, DOCUMENTED_ROTATION_DEG, every=4).displacement_at(gnss.t_gps_ns)
    rms = rms_mm(errors[np.arange(len(errors)) % 4 != 0])
    print("error at withheld epochs, RMS mm:", rms)
    assert (rms <= [4.7, 3.7, 7.0]).all()


def test_the_data_themselves_say_rotation_and_clock(recording: tuple[Series, Series]) -> None:
    """Of rotations and time offsets, the documented ones (and UTC in both files) fit best within what 110 epochs
    resolve.
    """
    by_rotation = {a: rms_mm(innovations(fused(recording, a)))[:2].sum() for a in (0.0, 10.0, 15.0, 20.0, 30.0)}
    assert min(by_rotation, key=by_rotation.__getitem__) == DOCUMENTED_ROTATION_DEG
    by_offset = {dt: rms_mm(innovations(fused(recording, 15.0, dt)))[:2].sum() for dt in (-0.2, 0.0, 0.2)}
    assert min(by_offset, key=by_offset.__getitem__) == 0.0


def test_static_offset_remains(recording: tuple[Series, Series]) -> None:
    """Daily solutions of PEDR: −0.533 E, −0.100 N, −0.036 U m; a minute of 1 Hz data is good to some centimetres."""
    series = fused(recording, DOCUMENTED_ROTATION_DEG)
    end = series.displacement_at(recording[0].t_gps_ns[-5:]).mean(axis=0)
    np.testing.assert_allclose(end, [-0.533, -0.100, -0.036], atol=0.05)


def test_quality_control_takes_nothing_from_the_earthquake(recording: tuple[Series, Series]) -> None:
    """With the tests on as with a gate that refuses nothing: no solution and no sample is left out."""
    on = fused(recording, DOCUMENTED_ROTATION_DEG)
    off = fused(recording, DOCUMENTED_ROTATION_DEG, innovation_gate_sigma=1e6)
    np.testing.assert_array_equal(on.displacement_enu_m, off.displacement_enu_m)
    assert not any(name.startswith("motion_") for name in on.state.counters)


def test_the_earthquake_is_not_doubted(recording: tuple[Series, Series]) -> None:
    """The accelerometer felt it, with the wrong rotation, too; before it GNSS stood as in its first ten seconds."""
    gnss = recording[0]
    still = np.tile(gnss.values[:10], (15, 1))
    times = gnss.t_gps_ns[0] - NS_PER_S * np.arange(len(still), 0, -1)
    for rotation_deg in (DOCUMENTED_ROTATION_DEG, 0.0):
        unfelt = {v.t_gps_ns: v for v in fused(recording, rotation_deg).innovations}
        watch = Watch()
        for t, displacement in zip([*times, *gnss.t_gps_ns], [*still, *gnss.values], strict=True):
            solution = Solution("pedr", int(t), int(t), Status.PPP_FLOAT, "", displacement_enu_m=displacement)
            watch = own_shows(watch, solution, {}, 0.5)
            if int(t) in unfelt:
                found = unfelt[int(t)]
                watch = accelerometer_says(watch, int(t), found.innovation_enu_m, found.whitened)
            assert not watch.open, (rotation_deg, watch.open)
        assert watch.own.is_learnt
        departure = watch.own.departure_at(int(gnss.t_gps_ns[-1]))
        assert departure is not None
        assert np.linalg.norm(departure) > 0.1
