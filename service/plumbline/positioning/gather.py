"""All that an epoch needs before the filter sees it: signal pairs, satellites, the model of what they measure."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit

from plumbline.config import PositioningSettings
from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.gnss.earth_frames import geodetic_from_ecef, rotation_enu_from_ecef
from plumbline.gnss.orbits_broadcast import SatelliteStates as KernelStates
from plumbline.gnss.sun_moon import sun_moon_ecef
from plumbline.gnss.tides import ocean_loading_enu_m, solid_earth_tide_ecef_m
from plumbline.gnss.troposphere import troposphere_site
from plumbline.gps_time import gps_minus_utc_s
from plumbline.positioning.facts import StationFacts
from plumbline.positioning.ppp_model import model_rows
from plumbline.positioning.ppp_noise import Tuning
from plumbline.positioning.preprocess import signal_pairs, wanted_systems
from plumbline.positioning.satellites import Cause, SatelliteSource, SatelliteStates
from plumbline.positioning.spp import PointSolution, single_point
from plumbline.positioning.state import Records
from plumbline.records import UNKNOWN_CHANNEL, Epoch, Floats
from plumbline.signals import SATELLITES_PER_SYSTEM, SYSTEM_LETTERS, System

_CODE_SIGMA_M: Final = 1.0  # of an ionosphere-free code at the zenith
_ONE_FREQUENCY_SIGMA_M: Final = 6.0  # the ionosphere is not modelled
_UNKNOWN_BIAS_SIGMA_M: Final = 2.0
_GLONASS_SIGMA_M: Final = 3.0  # inter-channel biases


@dataclass(frozen=True, slots=True)
class Inputs:
    """An epoch with its satellites, and everything else that a step knows."""

    epoch: Epoch
    pairs: Records
    states: SatelliteStates  # precise ones
    settings: PositioningSettings
    facts: StationFacts
    tuning: Tuning
    missing: str  # why systems do not contribute

    @property
    def max_gap_ns(self) -> int:
        """Longest interruption of a satellite that its ambiguity may survive."""
        return round(self.settings.max_gap_s * 1e9)


@dataclass(frozen=True, slots=True)
class Site:
    """The antenna at one instant."""

    reference_point_ecef_m: Floats  # (3,) marker + antenna height + tides
    rotation_enu: Floats  # (3, 3) east, north, up from Earth-fixed, at the marker
    troposphere: Floats  # row of plumbline.gnss.troposphere
    sun_ecef_m: Floats  # (3,)


def select_rows(epoch: Epoch, systems: str) -> Epoch:
    """The epoch with the rows of the systems asked for alone."""
    keep = wanted_systems(systems)[epoch.satellite // SATELLITES_PER_SYSTEM]
    if keep.all():
        return epoch
    return Epoch(
        epoch.t_gps_ns, epoch.t_receive_ns, epoch.satellite[keep], epoch.signal[keep], epoch.pseudorange_m[keep],
        epoch.carrier_phase_cycles[keep], epoch.doppler_hz[keep], epoch.cn0_db_hz[keep], epoch.lock_time_s[keep],
        epoch.half_cycle_ambiguous[keep], epoch.glonass_channel[keep], epoch.antenna,
        None if epoch.loss_of_lock is None else epoch.loss_of_lock[keep],
    )  # fmt: skip


def pairs_of(
    epoch: Epoch, source: SatelliteSource, arcs: Records, *, precise: bool, systems: str = SYSTEM_LETTERS
) -> Records:
    """Signal pairs of an epoch's wanted systems, with the biases of the precise or the broadcast clocks."""
    channel = epoch.glonass_channel
    if (channel == UNKNOWN_CHANNEL).any():
        known = source.glonass_channels(epoch.t_receive_ns, epoch.satellite)
        channel = np.where(channel == UNKNOWN_CHANNEL, known, channel).astype(np.int8)
    biases = source.biases(epoch.t_gps_ns, epoch.t_receive_ns, epoch.satellite, epoch.signal, precise=precise)
    return signal_pairs(epoch, channel, biases, arcs, systems)


def site_of(marker_ecef_m: Floats, facts: StationFacts, t_gps_ns: int) -> Site:
    """Where the antenna reference point is at an instant, solid Earth tide and ocean loading (where given) added."""
    leap_s = float(gps_minus_utc_s(t_gps_ns))
    place, rotation, sun, tide_m = _place(marker_ecef_m, t_gps_ns, leap_s)
    offset_enu = np.array(facts.antenna_offset_enu_m)
    if facts.ocean_loading is not None:
        offset_enu += ocean_loading_enu_m(
            facts.ocean_loading.amplitude_m, facts.ocean_loading.phase_rad, t_gps_ns, leap_s
        )  # fmt: skip
    point = marker_ecef_m + offset_enu @ rotation + tide_m
    return Site(point, rotation, troposphere_site(place[0], place[1], place[2], t_gps_ns), sun)


@njit(cache=True)
def _place(marker_ecef_m: Floats, t_gps_ns: int, leap_s: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Geodetic coordinates, rotation to east, north, up, the Sun and the solid Earth tide (3,) of a place."""
    place = geodetic_from_ecef(marker_ecef_m)
    sun, moon = sun_moon_ecef(t_gps_ns, leap_s)
    tide_m = solid_earth_tide_ecef_m(marker_ecef_m, sun, moon, t_gps_ns, leap_s)
    return place, rotation_enu_from_ecef(place[0], place[1]), sun, tide_m


def model_of(
    pairs: Records, states: SatelliteStates, site: Site, facts: StationFacts, arcs: Records, mask_rad: float
) -> Records:
    """Model rows of the pairs at a site, one a pair; not usable where the satellite is not."""
    n = pairs.size
    kernel_states = KernelStates(
        states.position_ecef_m, states.velocity_ecef_m_s, states.clock_m / SPEED_OF_LIGHT_M_S, np.zeros(n), np.zeros(n),
        states.cause.astype(np.int64),
    )  # fmt: skip
    rows: Records = model_rows(
        kernel_states, pairs, arcs, states.clock_m, site.reference_point_ecef_m, site.troposphere, site.sun_ecef_m,
        facts.antennas, states.centre_of_mass, mask_rad,
    )  # fmt: skip
    return rows


def point_of(pairs: Records, states: SatelliteStates, start_ecef_m: Floats | None) -> PointSolution | None:
    """Single-point position of the antenna from the codes of pairs."""
    sigma = np.where(pairs["frequency_2_hz"] > 0.0, _CODE_SIGMA_M, _ONE_FREQUENCY_SIGMA_M)
    sigma += np.where(pairs["bias_known"], 0.0, _UNKNOWN_BIAS_SIGMA_M)
    sigma += np.where(pairs["system"] == System.GLONASS, _GLONASS_SIGMA_M, 0.0)
    sigma = np.hypot(sigma, states.sigma_m)
    clock = np.where(states.cause == Cause.USABLE, states.clock_m, np.nan)
    return single_point(states.position_ecef_m, clock, pairs["code_m"], sigma, pairs["system"], start_ecef_m)


def mask_rad_of(settings: PositioningSettings) -> float:
    """Elevation mask, rad."""
    return float(np.radians(settings.elevation_mask_deg))
