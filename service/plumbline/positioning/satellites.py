"""What positioning asks of orbits, clocks and biases: one protocol, two implementations.

:class:`~plumbline.positioning.precise_source.PreciseSource` reads SP3 and CLK products;
:class:`~plumbline.positioning.broadcast_source.BroadcastSource` reads broadcast ephemerides and SSR corrections from
the books of :mod:`plumbline.epochs`, as of the epoch's receive time. A satellite that cannot be used is not left out:
its row carries the cause, so that a station's status can say what is missing.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from plumbline.records import Booleans, Floats, SatelliteIds, SignalIds


class Cause(IntEnum):
    """Why a satellite's orbit and clock cannot be used; USABLE when they can."""

    USABLE = 0
    NO_EPHEMERIS = 1
    EPHEMERIS_TOO_OLD = 2
    UNHEALTHY = 3
    NO_CORRECTIONS = 4
    CORRECTIONS_TOO_OLD = 5
    ISSUE_MISMATCH = 6  # the corrections refer to a broadcast set that has not been received
    NO_PRECISE_ORBIT = 7
    NO_PRECISE_CLOCK = 8
    NO_CHANNEL = 9  # GLONASS frequency channel unknown


@dataclass(frozen=True, slots=True)
class SatelliteStates:
    """Orbits and clocks at the instants of transmission, one row per satellite asked for; NaN where not usable."""

    satellite: SatelliteIds  # (n,)
    cause: NDArray[np.int8]  # (n,) Cause
    position_ecef_m: Floats  # (n, 3) in the Earth-fixed frame of the instant of transmission
    velocity_ecef_m_s: Floats  # (n, 3)
    clock_m: Floats  # (n,) satellite clock offset times c, the relativistic eccentricity term included
    sigma_m: Floats  # (n,) one sigma of orbit and clock along the line of sight
    age_s: Floats  # (n,) of the corrections (broadcast: of the ephemeris); NaN where meaningless or never received
    centre_of_mass: bool  # positions are centres of mass: the satellite antenna's offset is still to be applied
    limit_s: float = np.nan  # the age limit that CORRECTIONS_TOO_OLD refers to


@dataclass(frozen=True, slots=True)
class SignalBiases:
    """Biases of observation rows, *added* to the measured code and phase; NaN where the source knows none.

    Zero, not NaN, for the signals that the clocks refer to. ``discontinuity`` changes when a phase ambiguity must.
    """

    code_m: Floats  # (n,)
    phase_m: Floats  # (n,)
    discontinuity: NDArray[np.int16]  # (n,), −1 where no phase bias is known


class SatelliteSource(Protocol):
    """Orbits, clocks and biases for positioning. Answers are functions of the arguments alone (determinism)."""

    def precise(self, t_gps_ns: int, t_receive_ns: int, satellite: SatelliteIds, range_m: Floats) -> SatelliteStates:
        """Precise states for signals received at ``t_gps_ns`` (receiver clock) with pseudoranges ``range_m``.

        The instant of transmission is ``t_gps_ns`` − range/c − satellite clock. Only what was received by
        ``t_receive_ns`` may be used.
        """
        ...

    def broadcast(self, t_gps_ns: int, t_receive_ns: int, satellite: SatelliteIds, range_m: Floats) -> SatelliteStates:
        """The same from broadcast ephemerides alone (or, where there are none, from the best there is)."""
        ...

    def biases(
        self, t_gps_ns: int, t_receive_ns: int, satellite: SatelliteIds, signal: SignalIds, *, precise: bool
    ) -> SignalBiases:
        """Biases of (satellite, signal) rows, relative to the clocks of :meth:`precise` or :meth:`broadcast`."""
        ...

    def glonass_channels(self, t_receive_ns: int, satellite: SatelliteIds) -> NDArray[np.int8]:
        """Frequency channels of GLONASS satellites, ``UNKNOWN_CHANNEL`` where the source does not know."""
        ...


def usable(states: SatelliteStates) -> Booleans:
    """Rows that may be used, (n,)."""
    mask: Booleans = states.cause == Cause.USABLE
    return mask
