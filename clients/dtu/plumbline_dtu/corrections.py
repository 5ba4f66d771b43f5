"""SSR corrections from precise products: precise minus broadcast, such that applying them gives the products back.

The corrections refer to the broadcast sets as RTCM carries them (encoded and decoded once, so that both sides compute
with the same bits) and are linear in time over an update interval, from a reference time in its middle. Their reference
point is that of the orbits given: centres of mass as SP3 has them, or antenna phase centres when offsets are given.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from plumbline.constants import BDT_BEHIND_GPST_S, SPEED_OF_LIGHT_M_S
from plumbline.gnss.antenna import AntennaBook
from plumbline.gnss.attitude import ORBIT_NORMAL, body_axes
from plumbline.gnss.orbits_broadcast import N_COLUMNS, broadcast_states, pack
from plumbline.gnss.orbits_precise import PreciseTables
from plumbline.gnss.satellite_states import precise_states
from plumbline.gnss.ssr_orbits import rotation_ecef_from_rac
from plumbline.gnss.sun_moon import sun_moon_ecef
from plumbline.gps_time import NS_PER_S, gps_minus_utc_s
from plumbline.records import (
    Ephemeris,
    Floats,
    Ints,
    SatelliteIds,
    SsrClock,
    SsrCodeBias,
    SsrHeader,
    SsrOrbit,
    SsrPhaseBias,
)
from plumbline.signals import BAND_FREQUENCIES_HZ, System, signal_id, system_of

#: Signals that analysis centres' clocks refer to: sent with a bias of zero (as `positioning.precise_source` has it).
REFERENCE_SIGNALS: Final[dict[System, tuple[str, ...]]] = {
    System.GPS: ("1W", "2W"),
    System.GLONASS: ("1P", "2P"),
    System.GALILEO: ("1C", "5Q", "1X", "5X"),
    System.BEIDOU: ("2I", "6I"),
    System.QZSS: ("1C", "2L"),
}
#: The phases that integer clocks and their wide-lane biases are made of, by band (GPS L1 and L2 P(Y) have one bias
#: whether L1 is tracked by P(Y) or by C/A: RINEX aligns their phases).
INTEGER_PHASES: Final[dict[System, tuple[tuple[str, ...], tuple[str, ...]]]] = {
    System.GPS: (("1C", "1W"), ("2W",)),
    System.GALILEO: (("1C", "1X"), ("5Q", "5X")),
}
_WIDE_LANE_GROUP: Final = 2  # the indicator's "group one": all signals of a satellite form one group
_BANDS: Final = {
    System.GPS: (1, 2), System.GLONASS: (1, 2), System.GALILEO: (1, 5), System.BEIDOU: (2, 6), System.QZSS: (1, 2),
}  # fmt: skip
_LARGEST_M: Final = 209.7  # what DF365–DF367 and DF376 hold
_WEEK_S: Final = 604_800
#: How far from its reference time a broadcast set serves: beyond, its difference to the products bends too much in an
#: update interval (GLONASS sets are renewed every 30 min, the others' every 10 min to 2 h).
_REACH_NS: Final = {System.GLONASS: 2700 * NS_PER_S}
_REACH_OF_OTHERS_NS: Final = 7200 * NS_PER_S

#: Offsets of antenna phase centres from centres of mass, Earth-fixed metres (n, 3): satellite ids, GPS time, positions
#: (n, 3) and velocities (n, 3).
OffsetOf = Callable[[SatelliteIds, int, Floats, Floats], Floats]


class EphemerisShelf:
    """Which broadcast set a correction service would use: the newest on the air, per satellite."""

    def __init__(self, ephemerides: Iterable[Ephemeris]) -> None:
        self._by_satellite: dict[int, list[Ephemeris]] = {}
        for ephemeris in sorted(ephemerides, key=lambda e: (e.t_receive_ns, e.toe_gps_ns)):
            self._by_satellite.setdefault(ephemeris.satellite, []).append(ephemeris)

    def satellites(self) -> list[int]:
        """Satellite ids, ascending."""
        return sorted(self._by_satellite)

    def current(self, satellite: int, t_gps_ns: int) -> Ephemeris | None:
        """The last set transmitted by then; where that is none or too old, the next one if it is near; else None."""
        reach_ns = _REACH_NS.get(system_of(satellite), _REACH_OF_OTHERS_NS)
        past: Ephemeris | None = None
        coming: Ephemeris | None = None
        for ephemeris in self._by_satellite.get(satellite, ()):
            if ephemeris.t_receive_ns <= t_gps_ns:
                past = ephemeris
            else:
                coming = ephemeris
                break
        if past is not None and t_gps_ns - past.toe_gps_ns <= reach_ns:
            return past
        return coming if coming is not None and coming.toe_gps_ns - t_gps_ns <= reach_ns else None


@dataclass(frozen=True, slots=True)
class Correction:
    """Orbit and clock corrections of one system at one time, for the same satellites."""

    orbit: SsrOrbit
    clock: SsrClock


def corrections_at(
    tables: PreciseTables, ephemerides: Mapping[int, Ephemeris], header: SsrHeader, offset_of: OffsetOf | None = None
) -> Correction:
    """Corrections of one system over ``header``'s interval; what the products lack by its end is left out."""
    satellites: SatelliteIds = np.array(sorted(ephemerides), np.int16)
    rows = np.array([pack(ephemerides[int(satellite)]) for satellite in satellites]).reshape(-1, N_COLUMNS)
    span_ns = max(round(header.update_interval_s * NS_PER_S), NS_PER_S)
    first = _difference(tables, satellites, rows, header.t_gps_ns, offset_of)
    last = _difference(tables, satellites, rows, header.t_gps_ns + span_ns, offset_of)
    rate = (last - first) / (span_ns / NS_PER_S)
    reference = first + rate * (0.5 * header.update_interval_s)
    keep = (np.abs(reference) < _LARGEST_M).all(axis=1)  # False where NaN: a gap is not bridged
    return correction_of(header, {int(s): ephemerides[int(s)] for s in satellites[keep]}, reference[keep], rate[keep])


def correction_of(
    header: SsrHeader, ephemerides: Mapping[int, Ephemeris], reference: Floats, rate: Floats
) -> Correction:
    """Records of one system from radial, along, cross and clock (n, 4), m, at the reference time, and their rates."""
    satellites: SatelliteIds = np.array(sorted(ephemerides), np.int16)
    beidou = any(system_of(int(satellite)) is System.BEIDOU for satellite in satellites)
    issue = np.array([_issue(ephemerides[int(satellite)]) for satellite in satellites], np.int64)
    clock = np.column_stack([reference[:, 3], rate[:, 3], np.zeros(len(satellites))])
    rule = "toe_8s" if beidou else "issue"
    return Correction(
        SsrOrbit(header, satellites, issue, reference[:, :3], rate[:, :3], rule), SsrClock(header, satellites, clock)
    )


def _difference(
    tables: PreciseTables, satellites: SatelliteIds, rows: Floats, t_gps_ns: int, offset_of: OffsetOf | None
) -> Floats:
    """Broadcast minus precise orbit in radial, along, cross and precise minus broadcast clock, m: (n, 4)."""
    times: Ints = np.full(len(satellites), t_gps_ns, np.int64)
    precise = precise_states(tables, satellites, times)
    broadcast = broadcast_states(rows, times)
    position = precise.position_ecef_m
    if offset_of is not None:
        position = position + offset_of(satellites, t_gps_ns, position, precise.velocity_ecef_m_s)
    out = np.full((len(satellites), 4), np.nan)
    for k in range(len(satellites)):
        rotation = rotation_ecef_from_rac(broadcast.position_ecef_m[k], broadcast.velocity_ecef_m_s[k])
        out[k, :3] = rotation.T @ (broadcast.position_ecef_m[k] - position[k])
    out[:, 3] = (precise.clock_s - broadcast.clock_s) * SPEED_OF_LIGHT_M_S
    return out


def _issue(ephemeris: Ephemeris) -> int:
    """The issue that a correction names its broadcast set by: its own, or BeiDou's toe in units of 8 s modulo 1024."""
    if system_of(ephemeris.satellite) is not System.BEIDOU:
        return ephemeris.issue
    return (ephemeris.toe_gps_ns // NS_PER_S - BDT_BEHIND_GPST_S) % _WEEK_S // 8 % 1024


def phase_centre_offsets(book: AntennaBook) -> OffsetOf:
    """Offsets of the phase centre of each system's reference pair's ionosphere-free combination; no variations."""

    def offset_of(satellites: SatelliteIds, t_gps_ns: int, position: Floats, velocity: Floats) -> Floats:
        sun, _ = sun_moon_ecef(t_gps_ns, gps_minus_utc_s(t_gps_ns))
        out = np.zeros((len(satellites), 3))
        for k, satellite in enumerate(satellites):
            if np.isfinite(position[k]).all():
                system = system_of(int(satellite))
                first, second = _BANDS[system]
                f1, f2 = (BAND_FREQUENCIES_HZ[system][str(band)] ** 2 for band in (first, second))
                offset = book.satellite_offset_m[satellite]
                axes = body_axes(position[k], velocity[k], sun, bool(ORBIT_NORMAL[satellite]))
                out[k] = ((f1 * offset[first] - f2 * offset[second]) / (f1 - f2)) @ axes
        return out

    return offset_of


def zero_code_biases(header: SsrHeader, satellites: Iterable[int]) -> SsrCodeBias:
    """Biases of zero for the signals that the clocks refer to."""
    pairs = [
        (satellite, signal)
        for satellite in satellites
        for code in REFERENCE_SIGNALS.get(system_of(satellite), ())
        if (signal := signal_id(system_of(satellite), code)) is not None
    ]
    ids = np.array(pairs, np.int16).reshape(-1, 2)
    return SsrCodeBias(header, ids[:, 0].copy(), ids[:, 1].copy(), np.zeros(len(pairs)))


def integer_phase_biases(
    header: SsrHeader, satellites: Iterable[int], wide_lane_cycles: Mapping[int, float]
) -> SsrPhaseBias:
    """Phase biases that make ambiguities integers with integer-recovery clocks, of the satellites with a wide lane.

    Such clocks (Loyer and others, 2012, J. Geodesy 86) hold the phase biases' ionosphere-free part: narrow lanes are
    integers as they are, so the biases b₁, b₂ (m, added) must leave that combination alone, f₁² b₁ = f₂² b₂. The wide
    lane's satellite bias w is added to Melbourne-Wübbena: b₁/λ₁ − b₂/λ₂ = w with the reference codes' biases zero. So

        b₁ = −w λ_w f₂/f₁,  b₂ = −w λ_w f₁/f₂,  λ_w = c/(f₁ − f₂).

    They are constants of a satellite: the discontinuity counter stays zero. Yaw is sent as zero: no attitude is known.
    """
    rows = []
    for satellite in satellites:
        system = system_of(satellite)
        if satellite not in wide_lane_cycles or system not in INTEGER_PHASES:
            continue
        f1, f2 = (BAND_FREQUENCIES_HZ[system][str(band)] for band in _BANDS[system])
        wide_lane_m = wide_lane_cycles[satellite] * SPEED_OF_LIGHT_M_S / (f1 - f2)
        for codes, bias_m in zip(INTEGER_PHASES[system], (-wide_lane_m * f2 / f1, -wide_lane_m * f1 / f2), strict=True):
            rows += [(satellite, signal_id(system, code), bias_m) for code in codes]
    n = len(rows)
    return SsrPhaseBias(
        header,
        satellite=np.array([row[0] for row in rows], np.int16),
        signal=np.array([row[1] for row in rows], np.int16),
        bias_m=np.array([row[2] for row in rows], np.float64),
        integer=np.ones(n, np.bool_),
        wide_lane_integer=np.full(n, _WIDE_LANE_GROUP, np.int64),
        discontinuity=np.zeros(n, np.int64),
        yaw_angle_rad=np.zeros(n),
        yaw_rate_rad_s=np.zeros(n),
        mw_consistent=True,
    )
