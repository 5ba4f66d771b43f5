"""Compiles every kernel of this package that runs live, by positioning a made-up antenna for two epochs."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from plumbline.config import PositioningSettings
from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.positioning.facts import StationFacts
from plumbline.positioning.ppp import step
from plumbline.positioning.rtk_warm_up import Relative, warm_up_relative
from plumbline.positioning.satellites import Cause, SatelliteStates, SignalBiases
from plumbline.positioning.state import initial_state
from plumbline.records import Epoch, Floats, SatelliteIds, SignalIds
from plumbline.signals import FREQUENCY_HZ, System, satellite_id, signal_id

_T_NS: Final = 1_277_000_000 * 1_000_000_000
_RECEIVER_M: Final = np.array([4_075_580.0, 931_854.0, 4_801_568.0])
_N: Final = 8


class _StandingSatellites:
    """A source of satellites that hang over the antenna."""

    def __init__(self) -> None:
        up = _RECEIVER_M / np.linalg.norm(_RECEIVER_M)
        east = np.cross([0.0, 0.0, 1.0], up)
        north = np.cross(up, east)
        turn = 2.0 * np.pi * np.arange(_N) / _N
        lean = np.where(np.arange(_N) % 2 == 0, 0.5, 1.2)[:, None]
        sideways = np.sin(turn)[:, None] * east + np.cos(turn)[:, None] * north
        self.position_m = _RECEIVER_M + 2.2e7 * (np.cos(lean) * up + np.sin(lean) * sideways)

    def precise(self, t_gps_ns: int, t_receive_ns: int, satellite: SatelliteIds, range_m: Floats) -> SatelliteStates:
        n = satellite.size
        return SatelliteStates(
            satellite,
            np.full(n, Cause.USABLE, np.int8),
            self.position_m,
            np.full((n, 3), 1000.0),
            np.zeros(n),
            np.full(n, 0.02),
            np.full(n, np.nan),
            centre_of_mass=True,
        )

    def broadcast(self, t_gps_ns: int, t_receive_ns: int, satellite: SatelliteIds, range_m: Floats) -> SatelliteStates:
        return self.precise(t_gps_ns, t_receive_ns, satellite, range_m)

    def biases(
        self, t_gps_ns: int, t_receive_ns: int, satellite: SatelliteIds, signal: SignalIds, *, precise: bool
    ) -> SignalBiases:
        n = satellite.size
        return SignalBiases(np.zeros(n), np.full(n, np.nan), np.full(n, -1, np.int16))

    def glonass_channels(self, t_receive_ns: int, satellite: SatelliteIds) -> NDArray[np.int8]:
        return np.zeros(satellite.size, np.int8)


def _epoch(source: _StandingSatellites, t_gps_ns: int, loss_of_lock: bool) -> Epoch:
    first, second = signal_id(System.GPS, "1C"), signal_id(System.GPS, "2W")
    assert first is not None
    assert second is not None
    satellite = np.repeat(np.array([satellite_id(System.GPS, i + 1) for i in range(_N)], np.int16), 2)
    signal = np.tile(np.array([first, second], np.int16), _N)
    code = np.repeat(np.linalg.norm(source.position_m - _RECEIVER_M, axis=1), 2)
    n = satellite.size
    return Epoch(
        t_gps_ns,
        t_gps_ns,
        satellite,
        signal,
        code,
        code * FREQUENCY_HZ[signal] / SPEED_OF_LIGHT_M_S,
        np.zeros(n),
        np.full(n, 45.0),
        np.full(n, np.nan),
        np.zeros(n, np.bool_),
        np.zeros(n, np.int8),
        loss_of_lock=np.zeros(n, np.bool_) if loss_of_lock else None,
    )


def warm_up() -> None:
    """Call every kernel once with arguments of the types that the pipeline uses."""
    source, settings, facts = _StandingSatellites(), PositioningSettings(), StationFacts("warm-up")
    state = initial_state()
    for second in range(2):
        state, _ = step(state, _epoch(source, _T_NS + second * 1_000_000_000, second > 0), source, settings, facts)
    relative()


def relative() -> Relative:
    """The last of three made-up epochs against a base."""
    source = _StandingSatellites()
    epochs = [_epoch(source, _T_NS + second * 1_000_000_000, second > 0) for second in range(3)]
    return warm_up_relative(source, epochs, _RECEIVER_M)
