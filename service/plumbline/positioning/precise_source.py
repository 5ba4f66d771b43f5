"""Orbits and clocks from files: SP3 and CLK products, with broadcast ephemerides (where given) for the start."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.gnss.orbits_precise import build_tables
from plumbline.gnss.satellite_states import StateStatus, precise_at_transmission
from plumbline.positioning.satellites import Cause, SatelliteStates, SignalBiases
from plumbline.records import UNKNOWN_CHANNEL, Floats, PreciseClocks, PreciseOrbits, SatelliteIds, SignalIds
from plumbline.signals import N_SATELLITES, N_SIGNALS, System, signal_id

#: Signals that the analysis centres' clocks refer to: their biases are zero by definition (IGS clock products: GPS
#: P1/P2, GLONASS P1/P2, Galileo E1/E5a, BeiDou B1I/B3I, QZSS C1C/C2L).
REFERENCE_SIGNALS: Final[dict[System, tuple[str, ...]]] = {
    System.GPS: ("1W", "1P", "2W", "2P"),
    System.GLONASS: ("1P", "2P"),
    System.GALILEO: ("1C", "1X", "5Q", "5X"),
    System.BEIDOU: ("2I", "6I"),
    System.QZSS: ("1C", "2L", "2X"),
}
_SIGMA_M: Final = 0.02  # final products, orbit and clock together

_CAUSE_OF_STATUS: Final = np.full(16, Cause.NO_PRECISE_ORBIT, np.int8)
_CAUSE_OF_STATUS[StateStatus.OK] = Cause.USABLE
for _status in (StateStatus.NO_CLOCK, StateStatus.CLOCK_OUTSIDE, StateStatus.CLOCK_GAP, StateStatus.CLOCK_JUMP):
    _CAUSE_OF_STATUS[_status] = Cause.NO_PRECISE_CLOCK


def _code_biases(known: Mapping[tuple[int, int], float]) -> Floats:
    """Table (satellite, signal) of code biases, m: zero for the reference signals, NaN where not known."""
    table = np.full((N_SATELLITES, N_SIGNALS), np.nan)
    for system, codes in REFERENCE_SIGNALS.items():
        for code in codes:
            table[system * 64 : (system + 1) * 64, signal_id(system, code)] = 0.0
    for (satellite, signal), bias_m in known.items():
        table[satellite, signal] = bias_m
    return table


class PreciseSource:
    """A :class:`~plumbline.positioning.satellites.SatelliteSource` of precise products; centres of mass."""

    def __init__(
        self,
        orbits: PreciseOrbits,
        clocks: PreciseClocks,
        glonass_channels: Mapping[int, int] | None = None,
        code_biases_m: Mapping[tuple[int, int], float] | None = None,
    ) -> None:
        """``code_biases_m`` by (satellite, signal) are added to the codes; ``glonass_channels`` by satellite id."""
        self._tables = build_tables(orbits, clocks)
        self._code_bias_m = _code_biases(code_biases_m or {})
        self._channel = np.full(N_SATELLITES, UNKNOWN_CHANNEL, np.int8)
        for satellite, channel in (glonass_channels or {}).items():
            self._channel[satellite] = channel

    def precise(self, t_gps_ns: int, t_receive_ns: int, satellite: SatelliteIds, range_m: Floats) -> SatelliteStates:
        """See the protocol; products have no age."""
        states = precise_at_transmission(self._tables, satellite, t_gps_ns, range_m)
        n = satellite.size
        return SatelliteStates(
            satellite, _CAUSE_OF_STATUS[states.status], states.position_ecef_m, states.velocity_ecef_m_s,
            states.clock_s * SPEED_OF_LIGHT_M_S, np.full(n, _SIGMA_M), np.full(n, np.nan), centre_of_mass=True,
        )  # fmt: skip

    def broadcast(self, t_gps_ns: int, t_receive_ns: int, satellite: SatelliteIds, range_m: Floats) -> SatelliteStates:
        """The precise states: they are the best there is."""
        return self.precise(t_gps_ns, t_receive_ns, satellite, range_m)

    def biases(
        self, t_gps_ns: int, t_receive_ns: int, satellite: SatelliteIds, signal: SignalIds, *, precise: bool
    ) -> SignalBiases:
        """Code biases of the clocks' reference signals (zero) and those given; no phase biases."""
        n = satellite.size
        return SignalBiases(self._code_bias_m[satellite, signal], np.full(n, np.nan), np.full(n, -1, np.int16))

    def glonass_channels(self, t_receive_ns: int, satellite: SatelliteIds) -> NDArray[np.int8]:
        """See the protocol."""
        return self._channel[satellite]


def channels_of_ephemerides(ephemerides: Sequence[object]) -> dict[int, int]:
    """GLONASS frequency channels by satellite id, as broadcast ephemerides give them."""
    return {int(e.satellite): int(e.frequency_channel) for e in ephemerides if hasattr(e, "frequency_channel")}  # type: ignore[attr-defined]
