"""SSR signal identifiers. Oracle: single identifiers taken from RTCM 10403.4 and IGS SSR 1.00 by hand."""

import pytest

from plumbline.rtcm3.ssr_signals import IGS_CODES, RTCM_CODES, identifier_of_signal, signal_of_identifier
from plumbline.signals import System, signal_code, signal_id


@pytest.mark.parametrize(
    ("system", "identifier", "code"),
    [
        *((System.GPS, 0, "1C"), (System.GPS, 2, "1W"), (System.GPS, 11, "2W"), (System.GPS, 15, "5Q")),
        *((System.GPS, 17, "1S"), (System.GLONASS, 2, "2C"), (System.GALILEO, 2, "1C"), (System.GALILEO, 6, "5Q")),
        *((System.GALILEO, 9, "7Q"), (System.GALILEO, 16, "6C"), (System.QZSS, 12, "1X"), (System.SBAS, 3, "5X")),
        *((System.BEIDOU, 0, "2I"), (System.BEIDOU, 3, "6I"), (System.BEIDOU, 6, "7I"), (System.BEIDOU, 13, "5P")),
    ],
)
def test_rtcm_identifiers(system, identifier, code):
    assert signal_code(signal_of_identifier(system, identifier, igs=False)) == code


def test_the_igs_differs_where_it_says_so():
    """Identifiers 3 and 4 of GPS are L1C's data and pilot (RTCM: Y and M code), combined modes are reserved."""
    assert signal_code(signal_of_identifier(System.GPS, 3, igs=True)) == "1S"
    assert signal_of_identifier(System.GPS, 3, igs=False) is None
    assert signal_of_identifier(System.GALILEO, 7, igs=True) is None
    assert signal_code(signal_of_identifier(System.GALILEO, 7, igs=False)) == "5X"


@pytest.mark.parametrize("igs", [False, True])
def test_identifiers_and_signals_are_inverse(igs):
    for system, codes in (IGS_CODES if igs else RTCM_CODES).items():
        for identifier, code in codes.items():
            signal = signal_of_identifier(system, identifier, igs=igs)
            assert signal == signal_id(system, code)
            if signal is not None:
                assert identifier_of_signal(signal, igs=igs) == identifier


def test_unknown_identifiers_have_no_signal():
    assert signal_of_identifier(System.GPS, 31, igs=False) is None
    assert identifier_of_signal(signal_id(System.NAVIC, "5A"), igs=False) is None
