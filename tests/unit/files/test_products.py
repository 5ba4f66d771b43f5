"""SP3, clocks, ANTEX, ocean loading, navigation and compact RINEX on small files whose content is known."""

from pathlib import Path

import hatanaka
import numpy as np
import pytest

from plumbline.errors import FileFormatError
from plumbline.files.antex import read_antex
from plumbline.files.blq import read_blq
from plumbline.files.rinex_clock import read_clocks
from plumbline.files.rinex_navigation import read_navigation, ura_index
from plumbline.files.rinex_observation import read_observations
from plumbline.files.sp3 import read_sp3
from plumbline.gps_time import DAY_NS, NS_PER_S, gps_ns_from_calendar
from plumbline.signals import satellite_of_name

SP3 = """#dP2024  1  {day}  0  0  0.00000000       1 ORBIT IGS20 HLM  TST
## 2295  86400.00000000   900.00000000 60310 0.0000000000000
+    2   G01R05
%c M  cc GPS ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc
%c cc cc ccc ccc cccc cccc cccc cccc ccccc ccccc ccccc ccccc
*  2024  1  {day}  0  0  0.00000000
PG01 -11562.163582  14053.114306  23345.128269   -884.707516
PR05      0.000000      0.000000      0.000000 999999.999999
EOF
"""


def test_sp3_days_are_merged(tmp_path: Path) -> None:
    """Oracle: the text; kilometres and microseconds, zero and nines mean missing."""
    for day in (2, 1):
        (tmp_path / f"{day}.sp3").write_text(SP3.format(day=day))
    orbits, clocks = read_sp3([tmp_path / "2.sp3", tmp_path / "1.sp3"])
    first = gps_ns_from_calendar(2024, 1, 1, 0, 0, 0)
    assert orbits.t_gps_ns.tolist() == [first, first + DAY_NS]
    assert orbits.satellite.tolist() == [satellite_of_name("G01"), satellite_of_name("R05")]
    np.testing.assert_allclose(orbits.position_ecef_m[1, 0], [-11562163.582, 14053114.306, 23345128.269], atol=1e-6)
    assert np.isnan(orbits.position_ecef_m[:, 1]).all()
    np.testing.assert_allclose(clocks.clock_s[:, 0], -884.707516e-6, atol=1e-18)
    assert np.isnan(clocks.clock_s[:, 1]).all()


def test_clock_file(tmp_path: Path) -> None:
    """Oracle: the text: satellite records only, and the wide-lane biases of the comments."""
    path = tmp_path / "test.clk"
    path.write_text(
        f"{'     3.00           CLOCK DATA          M':<60}RINEX VERSION / TYPE\n"
        f"{'WL G01  2020  6 25 12  0  0.000000  1   -0.110300E+01  0102':<60}COMMENT\n"
        f"{'':<60}END OF HEADER\n"
        "AR BRUX 2020  6 25  0  0  0.000000  1    0.1E-03\n"
        "AS G01  2020  6 25  0  0 30.000000  2   -0.884707516318D-03  0.337986288247E-10\n"
    )
    files = read_clocks([path])
    assert files.clocks.t_gps_ns.tolist() == [gps_ns_from_calendar(2020, 6, 25, 0, 0, 30 * NS_PER_S)]
    assert files.clocks.clock_s.tolist() == [[-0.884707516318e-3]]
    assert files.wide_lane_cycles == {satellite_of_name("G01"): -1.103}


def test_blq(tmp_path: Path) -> None:
    """Oracle: the text: radial, west, south; degrees to radians; comments skipped."""
    rows = "\n".join(" ".join(f"{row + k / 100:.5f}" for k in range(11)) for row in range(6))
    path = tmp_path / "ocean.blq"
    path.write_text(f"$$ Ocean loading\n  onsala\n$$ computed\n{rows}\n$$ END TABLE\n")
    loading = read_blq(path)["ONSALA"]
    assert loading.amplitude_m[:, 3].tolist() == pytest.approx([0.03, 1.03, 2.03])
    assert loading.phase_rad[:, 10].tolist() == pytest.approx(np.radians([3.1, 4.1, 5.1]).tolist())
    path.write_text("  onsala\n 1 2 3\n")
    with pytest.raises(FileFormatError):
        read_blq(path)


@pytest.mark.parametrize(
    ("metres", "index"), [(2.0, 0), (2.4, 0), (2.8, 1), (4.0, 2), (5.7, 3), (32.0, 7), (9999.0, 15)]
)
def test_accuracy_index(metres: float, index: int) -> None:
    """Oracle: IS-GPS-200, 20.3.3.3.1.3: an index holds for accuracies up to its limit."""
    assert ura_index(metres) == index


def test_readers_refuse_each_other_s_files(tmp_path: Path) -> None:
    """Oracle: the contract: a FileFormatError that names the file."""
    path = tmp_path / "strange.txt"
    path.write_bytes(bytes(range(256)) * 5)
    for read in (lambda p: read_sp3([p]), lambda p: read_clocks([p]), read_antex, read_blq, read_navigation):
        with pytest.raises(FileFormatError, match=r"strange\.txt"):
            read(path)
    with pytest.raises(FileFormatError, match="missing"):
        read_antex(tmp_path / "missing.atx")


@pytest.mark.realdata
def test_antex_of_the_recordings(data_dir: Path) -> None:
    """Oracle: the file's own lines for two of its antennas."""
    antennas = read_antex(data_dir / "esbc-2020-177" / "approx-igs14.atx")
    satellite = next(a for a in antennas if a.satellite == satellite_of_name("G02"))
    assert [p.frequency for p in satellite.patterns] == ["G01", "G02"]
    assert satellite.patterns[0].offset_m == (0.0, 0.0, 0.721)
    np.testing.assert_allclose(np.degrees(satellite.zenith_grid_rad), np.arange(18))
    receiver = next(a for a in antennas if a.antenna_type == "ASH701945E_M    SCIS")
    assert receiver.satellite is None


@pytest.mark.realdata
def test_compact_rinex_equals_plain(data_dir: Path, tmp_path: Path) -> None:
    """Oracle: the same epochs before and after Hatanaka's compression and .Z or gzip."""
    import gzip

    with gzip.open(data_dir / "esbc-2020-177" / "ESBC00DNK_R_20201770000_12H_30S_MO.rnx.gz", "rb") as file:
        plain = b"".join(line for _, line in zip(range(1000), file, strict=False))
    plain = plain[: plain.rindex(b"\n>") + 1]
    (tmp_path / "a.rnx").write_bytes(plain)
    (tmp_path / "a.crx.gz").write_bytes(gzip.compress(hatanaka.rnx2crx(plain)))
    expected, got = read_observations(tmp_path / "a.rnx"), read_observations(tmp_path / "a.crx.gz")
    assert len(expected) == len(got) > 10
    for a, b in zip(expected, got, strict=True):
        assert a.t_gps_ns == b.t_gps_ns
        np.testing.assert_array_equal(a.pseudorange_m, b.pseudorange_m)
        np.testing.assert_array_equal(a.carrier_phase_cycles, b.carrier_phase_cycles)
