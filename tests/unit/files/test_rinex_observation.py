"""The observation reader on small files whose content is known."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from plumbline.errors import FileFormatError
from plumbline.files.rinex_observation import RinexObservations, parse_f14_3, read_observations
from plumbline.gps_time import NS_PER_S, gps_ns_from_calendar
from plumbline.records import UNKNOWN_CHANNEL
from plumbline.signals import System, satellite_of_name, signal_id


def header_line(text: str, label: str) -> str:
    return f"{text:<60}{label}\n"


V3 = (
    header_line("     3.04           OBSERVATION DATA    M", "RINEX VERSION / TYPE")
    + header_line("TEST", "MARKER NAME")
    + header_line("G    4 C1C L1C D1C S1C", "SYS / # / OBS TYPES")
    + header_line("R    2 C1C L1C", "SYS / # / OBS TYPES")
    + header_line("  1 R05  1", "GLONASS SLOT / FRQ #")
    + header_line("        0.2160        0.0010       -0.0020", "ANTENNA: DELTA H/E/N")
    + header_line("  2024     1     1     0     0    0.0000000     GPS", "TIME OF FIRST OBS")
    + header_line("", "END OF HEADER")
    + "> 2024 01 01 00 00 00.5000000  0  4\n"
    + "G07  20000000.123 1 105000000.45613     -1234.567          45.250\n"
    + "R05  21000000.000   112000000.000\n"
    + "R06  21000000.500\n"
    + "X99  1\n"
    + "> 2024 01 01 00 00 01.0000000  4  1\n"
    + header_line("an event", "COMMENT")
    + "> 2024 01 01 00 00 01.5000000  1  1\n"
    + "G07  2x000000.123   105000001.456\n"
)

V2 = (
    header_line("     2.11           OBSERVATION DATA    M", "RINEX VERSION / TYPE")
    + header_line("     7    C1    P1    L1    P2    L2    S1    S2", "# / TYPES OF OBSERV")
    + header_line("  2005     1     1     0     0    0.0000000     GPS", "TIME OF FIRST OBS")
    + header_line("", "END OF HEADER")
    + " 05  1  1  0  0 30.0000000  0  2G 3R 5\n"
    + "  20000000.100    20000000.200   105000000.1231   20000000.300    82000000.456 \n"
    + "        45.000          40.000\n"
    + "  21000000.100                   112000000.123\n"
    + "\n"
)


@pytest.fixture
def file(tmp_path: Path):
    def write(text: str, name: str = "test.rnx") -> Path:
        path = tmp_path / name
        path.write_bytes(gzip.compress(text.encode()) if name.endswith(".gz") else text.encode())
        return path

    return write


@pytest.mark.parametrize("name", ["test.rnx", "test.rnx.gz"])
def test_rinex_3(file, name: str) -> None:
    """Oracle: the text itself; what is malformed is missing, what is unknown is counted."""
    observations = RinexObservations(file(V3, name))
    first, second = list(observations)
    assert observations.header.antenna_delta_hen_m == (0.216, 0.001, -0.002)
    assert first.t_gps_ns == gps_ns_from_calendar(2024, 1, 1, 0, 0, NS_PER_S // 2)
    names = [satellite_of_name(name) for name in ("G07", "R05", "R06")]
    assert first.satellite.tolist() == names
    assert first.signal.tolist() == [signal_id(System.GPS, "1C"), *[signal_id(System.GLONASS, "1C")] * 2]
    assert first.pseudorange_m.tolist() == [20000000.123, 21000000.0, 21000000.5]
    np.testing.assert_array_equal(first.carrier_phase_cycles, [105000000.456, 112000000.0, np.nan])
    assert (first.doppler_hz[0], first.cn0_db_hz[0]) == (-1234.567, 45.25)
    assert first.loss_of_lock is not None
    assert first.loss_of_lock.tolist() == [True, False, False]
    assert first.half_cycle_ambiguous.tolist() == [False, False, False]
    assert first.glonass_channel.tolist() == [0, 1, UNKNOWN_CHANNEL]
    assert np.isnan(second.pseudorange_m[0])
    assert second.loss_of_lock is not None
    assert second.loss_of_lock.all()  # the receiver had lost power
    assert observations.skipped == {"unknown satellite": 1, "event record": 1}
    assert observations.fraction == 1.0


def test_rinex_2(file) -> None:
    """Oracle: the text itself, with RINEX 3's names of the signals."""
    (epoch,) = read_observations(file(V2, "test.05o"))
    g1c, g1w, g2w = (signal_id(System.GPS, code) for code in ("1C", "1W", "2W"))
    assert epoch.t_gps_ns == gps_ns_from_calendar(2005, 1, 1, 0, 0, 30 * NS_PER_S)
    assert epoch.signal.tolist() == [g1c, g1w, g2w, signal_id(System.GLONASS, "1C")]
    assert epoch.pseudorange_m.tolist() == [20000000.1, 20000000.2, 20000000.3, 21000000.1]
    np.testing.assert_array_equal(epoch.carrier_phase_cycles, [105000000.123, np.nan, 82000000.456, 112000000.123])
    np.testing.assert_array_equal(epoch.cn0_db_hz, [45.0, np.nan, 40.0, np.nan])
    assert epoch.loss_of_lock is not None
    assert epoch.loss_of_lock.tolist() == [True, False, False, False]


def test_glonass_and_beidou_time_scales(file) -> None:
    """Oracle: GPS time is 18 s ahead of UTC in 2024 and 14 s ahead of BDT, always."""
    for scale, ahead_s in (("GLO", 18), ("BDT", 14), ("GAL", 0)):
        observations = RinexObservations(file(V3.replace("     GPS ", f"     {scale} ")))
        assert (
            next(iter(observations)).t_gps_ns
            == gps_ns_from_calendar(2024, 1, 1, 0, 0, NS_PER_S // 2) + ahead_s * NS_PER_S
        )


def test_numbers_equal_python_s() -> None:
    """Oracle: Python's float of the same text."""
    rng = np.random.default_rng(1)
    texts = [f"{value:14.3f}" for value in rng.uniform(-99999999, 999999999, 500)] + [
        "        -0.001",
        "          .5  ",
    ]
    characters = np.array([list(text.encode()) for text in texts], np.uint8)
    values = parse_f14_3(characters)
    assert values[:-1].tolist() == [float(text) for text in texts[:-1]]
    assert np.isnan(values[-1])


@pytest.mark.parametrize(
    "text", ["", "nonsense\n", V3.split("> 2024")[0].replace("OBSERVATION", "NAVIGATION "), V3[:200]]
)
def test_other_files_are_refused(file, text: str) -> None:
    """Oracle: the contract: a FileFormatError that names the file."""
    with pytest.raises(FileFormatError, match=r"test\.rnx"):
        RinexObservations(file(text))
