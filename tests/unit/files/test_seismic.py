"""Series of displacement and acceleration from the formats they come in."""

from pathlib import Path

import numpy as np
import obspy
import pytest

from plumbline.errors import FileFormatError
from plumbline.files.seismic import read_components, read_sensitivity, read_series
from plumbline.gps_time import NS_PER_S, gps_ns_from_calendar


def test_csv_with_units_and_a_gap(tmp_path: Path) -> None:
    """Oracle: the table itself, millimetres to metres, NaN where a row is missing."""
    path = tmp_path / "series.csv"
    path.write_text("t_gps_s,e_mm,n_mm\n1277078400.10,1,2\n1277078400.20,3,4\n1277078400.40,5,6\n")
    series = read_series(path)
    assert (series.t_first_gps_ns, series.interval_ns, series.unit) == (
        1277078400 * NS_PER_S + NS_PER_S // 10,
        10**8,
        "m",
    )
    np.testing.assert_allclose(series.values, [[1e-3, 2e-3], [3e-3, 4e-3], [np.nan, np.nan], [5e-3, 6e-3]])
    assert series.components == ("e_mm", "n_mm")


def test_uneven_csv_is_refused(tmp_path: Path) -> None:
    """Oracle: the contract."""
    path = tmp_path / "series.csv"
    for text in ("t,x\n0,1\n1,2\n1.5,3\n2.5,1\n", "t,x\n1,1\n0,2\n", "t,x\nzero,1\n", "t,x\n1,2\n"):
        path.write_text(text)
        with pytest.raises(FileFormatError):
            read_series(path)


@pytest.mark.parametrize("format_name", ["SAC", "MSEED"])
def test_seismograms(tmp_path: Path, format_name: str) -> None:
    """Oracle: the trace that was written; UTC 2020-06-25 is 18 s behind GPS time."""
    trace = obspy.Trace(np.arange(50, dtype=np.float32), {"delta": 0.005, "starttime": obspy.UTCDateTime(2020, 6, 25)})
    trace.write(str(tmp_path / "a.dat"), format=format_name)
    series = read_series(tmp_path / "a.dat")
    assert series.t_first_gps_ns == gps_ns_from_calendar(2020, 6, 25, 0, 0, 18 * NS_PER_S)
    assert series.interval_ns == 5_000_000
    assert series.values[:, 0].tolist() == list(range(50))


def test_sensitivity_without_a_comment(tmp_path: Path) -> None:
    """Oracle: the gain at frequency zero of poles at −2 ± 1i, written out by hand: constant / |p|²."""
    path = tmp_path / "pz"
    path.write_text("ZEROS 0\nPOLES 2\n\t-2.0 1.0\n\t-2.0 -1.0\nCONSTANT 50.0\n")
    assert read_sensitivity(path) == pytest.approx(10.0)
    path.write_text("ZEROS 2\nPOLES 1\n\t-2.0 1.0\nCONSTANT 50.0\n")
    with pytest.raises(FileFormatError, match="accelerometer"):
        read_sensitivity(path)


@pytest.mark.realdata
def test_illapel(data_dir: Path) -> None:
    """Oracle: header and comments of the files: 31,000 samples at 100 Hz; both ways to the sensitivity agree."""
    folder = data_dir / "illapel-2015"
    poles = tuple(folder / f"SAC_PZs_C1_CO03_HN{c}___" for c in "ENZ")
    series = read_components([folder / f"C1.CO03.HN{c}.sac" for c in "ENZ"], poles)
    assert (series.values.shape, series.interval_ns, series.unit) == ((31000, 3), 10_000_000, "m/s2")
    raw = obspy.read(str(folder / "C1.CO03.HNZ.sac"))[0].data
    np.testing.assert_allclose(
        series.values[:, 2], raw[1:] / read_sensitivity(poles[2]), rtol=1e-6
    )  # it starts a sample early
    assert read_sensitivity(poles[0]) == 4.27991e5
    displacement = read_components([folder / f"pedr.LX{c}.SAC" for c in "ENZ"])
    assert displacement.values.shape == (110, 3)
    assert displacement.values[-1] == pytest.approx([-0.5331, -0.1002, -0.0364], abs=0.06)  # the daily static offsets
