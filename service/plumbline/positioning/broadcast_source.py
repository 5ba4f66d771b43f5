"""Orbits and clocks from streams: broadcast ephemerides, and SSR corrections on top of them, as of the receive time."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from plumbline.config import PositioningSettings
from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.epochs.correction_book import AgeLimits, CorrectionBook
from plumbline.epochs.ephemeris_book import Choice
from plumbline.epochs.ephemeris_chain import EphemerisLookup
from plumbline.epochs.matched_corrections import matched
from plumbline.gnss.group_delays import group_delay_s
from plumbline.gnss.orbits_broadcast import SatelliteStates as KernelStates
from plumbline.gnss.orbits_broadcast import empty_row
from plumbline.gnss.satellite_states import StateStatus, broadcast_at_transmission, corrected_at_transmission
from plumbline.positioning.precise_source import REFERENCE_SIGNALS
from plumbline.positioning.satellites import Cause, SatelliteStates, SignalBiases
from plumbline.records import Floats, SatelliteIds, SignalIds
from plumbline.signals import N_SIGNALS, SATELLITES_PER_SYSTEM, signal_id

_BROADCAST_SIGMA_M: Final = 2.0  # orbit and clock along the line of sight; GLONASS and BeiDou up to twice that
_SSR_SIGMA_FLOOR_M: Final = 0.03  # real-time orbits and clocks, whatever accuracy the service claims
_NO_AGE: Final = np.nan

_IS_REFERENCE: Final = np.zeros(N_SIGNALS, np.bool_)
for _system, _codes in REFERENCE_SIGNALS.items():
    for _code in _codes:
        _IS_REFERENCE[signal_id(_system, _code)] = True


class BroadcastSource:
    """A :class:`~plumbline.positioning.satellites.SatelliteSource` of ephemeris and correction books."""

    def __init__(
        self, ephemerides: EphemerisLookup, corrections: CorrectionBook, settings: PositioningSettings
    ) -> None:
        self._ephemerides = ephemerides
        self._corrections = corrections
        self._limits = AgeLimits.of(settings)
        self._galileo_message = settings.galileo_message
        self._centre_of_mass = settings.corrections_refer_to == "centre_of_mass"

    def precise(self, t_gps_ns: int, t_receive_ns: int, satellite: SatelliteIds, range_m: Floats) -> SatelliteStates:
        """Broadcast ephemerides with the corrections that belong to them."""
        match = matched(
            self._ephemerides,
            self._corrections,
            satellite,
            t_gps_ns,
            t_receive_ns,
            self._limits,
            self._galileo_message,
        )
        states = corrected_at_transmission(match.rows, match.corrections, t_gps_ns, range_m)
        return SatelliteStates(
            satellite=satellite,
            cause=_causes(match.match, states),
            position_ecef_m=states.position_ecef_m,
            velocity_ecef_m_s=states.velocity_ecef_m_s,
            clock_m=states.clock_s * SPEED_OF_LIGHT_M_S,
            sigma_m=np.maximum(np.nan_to_num(match.ura_m), _SSR_SIGMA_FLOOR_M),
            age_s=match.clock_age_s,
            centre_of_mass=self._centre_of_mass,
            limit_s=self._limits.clock_s,
        )

    def broadcast(self, t_gps_ns: int, t_receive_ns: int, satellite: SatelliteIds, range_m: Floats) -> SatelliteStates:
        """Broadcast ephemerides alone."""
        choices = [self._choose(number, t_gps_ns, t_receive_ns) for number in satellite.tolist()]
        rows = np.array([choice.entry.row if choice.entry else empty_row() for choice in choices])
        states = broadcast_at_transmission(rows.reshape(len(choices), empty_row().size), t_gps_ns, range_m)
        return SatelliteStates(
            satellite=satellite,
            cause=_causes(np.array([choice.match for choice in choices], np.int8), states),
            position_ecef_m=states.position_ecef_m,
            velocity_ecef_m_s=states.velocity_ecef_m_s,
            clock_m=states.clock_s * SPEED_OF_LIGHT_M_S,
            sigma_m=np.full(satellite.size, _BROADCAST_SIGMA_M),
            age_s=np.full(satellite.size, _NO_AGE),
            centre_of_mass=False,
        )

    def _choose(self, satellite: int, t_gps_ns: int, t_receive_ns: int) -> Choice:
        return self._ephemerides.select(satellite, t_gps_ns, t_receive_ns, message=self._galileo_message)

    def biases(
        self, t_gps_ns: int, t_receive_ns: int, satellite: SatelliteIds, signal: SignalIds, *, precise: bool
    ) -> SignalBiases:
        """With corrections: the service's biases.

        Of a system without any, the usual reference signals' are zero; of one that has some, those of satellites that
        the service is silent about are not known: its clocks may refer to other signals.
        """
        n = satellite.size
        if not precise:
            return SignalBiases(
                self._group_delays_m(t_gps_ns, t_receive_ns, satellite, signal),
                np.full(n, np.nan),
                np.full(n, -1, np.int16),
            )
        code = self._corrections.code_biases(satellite, signal, t_gps_ns, t_receive_ns, self._limits).bias_m
        phase = self._corrections.phase_biases(satellite, signal, t_gps_ns, t_receive_ns, self._limits)
        system = satellite // SATELLITES_PER_SYSTEM
        silent = ~np.isin(system, system[np.isfinite(code)])
        code = np.where(np.isnan(code) & silent & _IS_REFERENCE[signal], 0.0, code)
        return SignalBiases(code, phase.bias_m, phase.discontinuity)

    def _group_delays_m(self, t_gps_ns: int, t_receive_ns: int, satellite: SatelliteIds, signal: SignalIds) -> Floats:
        """What is added to a code so that it belongs to the broadcast clock: its group delay, subtracted."""
        delays = np.full(satellite.size, np.nan)
        for i, (number, code) in enumerate(zip(satellite.tolist(), signal.tolist(), strict=True)):
            entry = self._choose(number, t_gps_ns, t_receive_ns).entry
            if entry is not None:
                delays[i] = -SPEED_OF_LIGHT_M_S * group_delay_s(entry.ephemeris, code)
        return delays

    def glonass_channels(self, t_receive_ns: int, satellite: SatelliteIds) -> NDArray[np.int8]:
        """Frequency channels as the ephemerides give them."""
        channels = [self._ephemerides.glonass_channel(number, t_receive_ns) for number in satellite.tolist()]
        return np.array(channels, np.int8)


def _causes(match: NDArray[np.int8], states: KernelStates) -> NDArray[np.int8]:
    """The books' reason where they have one (``Match`` and ``Cause`` agree in number), else the orbit's."""
    cause = np.array(match, np.int8)
    failed = (cause == Cause.USABLE) & (states.status != StateStatus.OK)
    cause[failed] = np.where(
        states.status[failed] == StateStatus.EPHEMERIS_TOO_OLD, Cause.EPHEMERIS_TOO_OLD, Cause.NO_EPHEMERIS
    )
    return cause
