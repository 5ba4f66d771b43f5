"""Satellite and signal numbers: oracles are RTCM's and RINEX's tables."""

import numpy as np
import pytest

from plumbline import signals as sg
from plumbline.signals import System


@pytest.mark.parametrize(
    ("name", "system", "number"),
    [("G01", System.GPS, 1), ("R24", System.GLONASS, 24), ("S20", System.SBAS, 1), ("J03", System.QZSS, 3),
     ("C63", System.BEIDOU, 63), ("I07", System.NAVIC, 7), ("E36", System.GALILEO, 36)],
)  # fmt: skip
def test_satellite_names(name: str, system: System, number: int) -> None:
    satellite = sg.satellite_of_name(name)
    assert (sg.system_of(satellite), sg.number_of(satellite)) == (system, number)
    assert sg.satellite_name(satellite) == name


@pytest.mark.parametrize("name", ["G00", "G65", "X01", "S10"])
def test_names_that_are_none(name: str) -> None:
    with pytest.raises(ValueError):
        sg.satellite_of_name(name)


def test_frequencies() -> None:
    """RINEX 3.05: GPS L1/L2/L5, Galileo E6, BeiDou B1I/B3I, GLONASS channel −7 and +6."""

    def f(system: System, code: str, channel: int = 0) -> float:
        signal = sg.signal_id(system, code)
        assert signal is not None
        return sg.carrier_frequency_hz(signal, channel)

    assert f(System.GPS, "1C") == 154 * 10.23e6
    assert f(System.GPS, "2W") == 120 * 10.23e6
    assert f(System.GPS, "5Q") == 115 * 10.23e6
    assert f(System.GALILEO, "6C") == 125 * 10.23e6
    assert f(System.BEIDOU, "2I") == 1561.098e6
    assert f(System.BEIDOU, "6I") == pytest.approx(124 * 10.23e6)
    assert f(System.GLONASS, "1C", -7) == pytest.approx(1598.0625e6)
    assert f(System.GLONASS, "2C", 6) == pytest.approx(1248.625e6)
    assert np.isnan(sg.FREQUENCY_HZ).sum() == sg.N_SIGNALS - sum(len(c) for c in sg.MSM_SIGNAL_CODES.values())


def test_signals_unknown_to_msm() -> None:
    assert sg.signal_id(System.GPS, "1Y") is None
    signal = sg.signal_id(System.GALILEO, "5Q")
    assert signal == System.GALILEO * 32 + 22
    assert sg.signal_code(signal) == "5Q"
