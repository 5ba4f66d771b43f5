"""Code biases of a correction service. Oracle: which of them the service has said, and which clocks refer to."""

import numpy as np
import pytest

from plumbline.config import PositioningSettings
from plumbline.epochs.correction_book import CorrectionBook
from plumbline.epochs.ephemeris_book import EphemerisBook
from plumbline.gps_time import NS_PER_S, gps_ns
from plumbline.positioning.broadcast_source import BroadcastSource
from plumbline.records import SsrCodeBias, SsrHeader
from plumbline.signals import System, satellite_of_name, signal_id

T_NS = gps_ns(2400, 100_800.0)
G05, E11, E12 = (satellite_of_name(name) for name in ("G05", "E11", "E12"))
C1W, C1C, C5Q = signal_id(System.GPS, "1W"), signal_id(System.GALILEO, "1C"), signal_id(System.GALILEO, "5Q")


@pytest.mark.parametrize(("spoken", "expected"), [((), [0.0, 0.0, 0.0, 0.0]), ((E11,), [3.2, np.nan, np.nan, 0.0])])
def test_silence_is_zero_only_where_the_service_says_nothing_of_the_system(
    spoken: tuple[int, ...], expected: list[float]
) -> None:
    book = CorrectionBook()
    if spoken:
        n = len(spoken)
        header = SsrHeader(T_NS, T_NS, 5.0, 1, 260, 1)
        book.add(SsrCodeBias(header, np.array(spoken, np.int16), np.full(n, C5Q, np.int16), np.full(n, 3.2)))
    source = BroadcastSource(EphemerisBook(), book, PositioningSettings())
    satellite, signal = np.array([E11, E12, E12, G05], np.int16), np.array([C5Q, C5Q, C1C, C1W], np.int16)
    found = source.biases(T_NS + NS_PER_S, T_NS + NS_PER_S, satellite, signal, precise=True)
    np.testing.assert_array_equal(found.code_m, expected)
