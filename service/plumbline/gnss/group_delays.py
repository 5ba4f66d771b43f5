"""Which clock a signal sees: the broadcast clock belongs to a reference pair, other signals need a group delay.

For a pseudorange on one signal the satellite's clock offset is the broadcast one *less* the group delay given here; for
a combination of signals, less the same combination of their delays. NaN where the message says nothing about a signal.

Sources: GPS, QZSS IS-GPS-200 20.3.3.3.3.2 (TGD of the L1P/L2P pair; differences between codes on one carrier and L5's
inter-signal correction are not in LNAV); Galileo OS SIS ICD 5.1.5; BDS-SIS-ICD B1I 5.2.4.10; GLONASS ICD 4.4 (Δτn);
NavIC ICD 6.2.1.5.
"""

import math

from plumbline.records import Ephemeris, GlonassEphemeris, KeplerEphemeris
from plumbline.signals import BAND_FREQUENCIES_HZ, System, signal_code, system_of


def _ratio(system: System, band_1: str, band_2: str) -> float:
    """(f1 / f2)² of two RINEX bands."""
    frequencies = BAND_FREQUENCIES_HZ[system]
    return (frequencies[band_1] / frequencies[band_2]) ** 2


def _galileo(message: str, delays_s: tuple[float, float], band: str) -> float:
    """Delay against the clock of the message's own pair: F/NAV E1-E5a, I/NAV E1-E5b."""
    e5a, e5b = delays_s  # BGD(E1, E5a), BGD(E1, E5b)
    own, other = (e5a, e5b) if message == "FNAV" else (e5b, e5a)
    own_band, other_band = ("5", "7") if message == "FNAV" else ("7", "5")
    if band == "1":
        return own
    if band == own_band:
        return _ratio(System.GALILEO, "1", own_band) * own
    if band == other_band:
        return own - other + _ratio(System.GALILEO, "1", other_band) * other
    return math.nan


def group_delay_s(ephemeris: Ephemeris, signal: int) -> float:
    """Group delay of a signal id, s, to be subtracted from the broadcast clock offset."""
    code = signal_code(signal)
    if not code:
        return math.nan
    band, system = code[0], system_of(ephemeris.satellite)
    if isinstance(ephemeris, GlonassEphemeris):
        return {"1": 0.0, "2": ephemeris.group_delay_s}.get(band, math.nan)
    return _kepler_delay(ephemeris, system, band)


def _kepler_delay(ephemeris: KeplerEphemeris, system: System, band: str) -> float:
    first, second = ephemeris.group_delay_s
    if system in (System.GPS, System.QZSS):
        return _ratio(system, "1", band) * first if band in "125" else math.nan
    if system is System.GALILEO:
        return _galileo(ephemeris.message, (first, second), band)
    if system is System.BEIDOU:
        return {"2": first, "7": second, "6": 0.0}.get(band, math.nan)
    if system is System.NAVIC:
        return {"9": first, "5": _ratio(system, "9", "5") * first}.get(band, math.nan)
    return 0.0
