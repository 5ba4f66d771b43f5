"""What a receiver measured, as one observation message tells it: MSM1–MSM7 and the legacy 1001–1004, 1009–1012."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plumbline.gps_time import resolve_bdt_tow_ms, resolve_glonass_ms, resolve_tow_ms
from plumbline.records import Booleans, Floats, SatelliteIds, SignalIds
from plumbline.signals import System

LEGACY_ROLLOVER_CYCLES = 1500


class Observations(NamedTuple):  # and no dataclass: that takes as long to make as the message to decode
    """One message's observations: struct of arrays, a row per (satellite, signal), shapes (n,), NaN where missing.

    Rows run by satellite, then signal. A row may have a code and no phase, or a phase and no code; where its
    satellite's rough range is missing, it has neither. ``phase_range_m`` is the carrier phase in metres, whatever the
    channel; in cycles it is NaN where the GLONASS channel is unknown. Signs are RINEX's: ``phase_range_rate_m_s`` is
    positive when the range grows, ``doppler_hz`` when it falls.
    """

    number: int
    system: System
    station: int
    epoch_ms: int  # of the week of the system's own time (BeiDou: BDT); GLONASS: of the day in UTC + 3 h
    day_of_week: int | None  # GLONASS MSM: 0 = Sunday … 6; None unknown, and for the others
    multiple_message: bool  # more of the same station and epoch to come
    iods: int
    clock_steering: int
    external_clock: int
    smoothing: bool  # divergence-free
    smoothing_interval: int  # indicator (DF418 or DF008)
    satellite: SatelliteIds
    signal: SignalIds
    pseudorange_m: Floats
    phase_range_m: Floats
    carrier_phase_cycles: Floats
    phase_range_rate_m_s: Floats
    doppler_hz: Floats
    cn0_db_hz: Floats
    lock_time_s: Floats  # the least that the indicator guarantees
    half_cycle_ambiguous: Booleans
    glonass_channel: NDArray[np.int8]  # −7…+6; UNKNOWN_CHANNEL where not told; 0 for the others
    range_modulus_m: float = 0.0  # MSM1–3, 1001, 1003, 1009, 1011: ranges are known modulo this, and NaN above
    pseudorange_modulo_m: Floats | None = None  # there, and only there
    phase_range_modulo_m: Floats | None = None

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return int(self.satellite.size)

    def t_gps_ns(self, t_near_gps_ns: int) -> int:
        """GPS time of the observations, the one nearest to ``t_near_gps_ns``."""
        if self.system is System.GLONASS:
            return resolve_glonass_ms(self.day_of_week, self.epoch_ms, t_near_gps_ns)
        if self.system is System.BEIDOU:
            return resolve_bdt_tow_ms(self.epoch_ms, t_near_gps_ns)
        return resolve_tow_ms(self.epoch_ms, t_near_gps_ns)


def unroll_legacy_phase(previous_cycles: Floats, cycles: Floats) -> Floats:
    """Legacy phases made continuous: they jump by 1500 cycles when phase minus code leaves its field (DF012, note)."""
    jumps = np.round((previous_cycles - cycles) / LEGACY_ROLLOVER_CYCLES)
    continuous: Floats = cycles + LEGACY_ROLLOVER_CYCLES * np.where(np.isfinite(jumps), jumps, 0.0)
    return continuous
