"""A nominal constellation, its broadcast ephemerides, and the corrections that lead from these back to the truth.

The truth is a set of Keplerian elements a satellite that hold for ever, and a clock with a slow wave on it. Broadcast
sets are the truth brought to a reference time, with errors of about a metre, rounded as RTCM does. Corrections are
truth against broadcast.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Final

import numpy as np

from plumbline.constants import (
    BDT_BEHIND_GPST_S,
    EARTH_GM_BEIDOU_M3_S2,
    EARTH_GM_GALILEO_M3_S2,
    EARTH_GM_GPS_M3_S2,
    EARTH_ROTATION_RATE_BEIDOU_RAD_S,
    EARTH_ROTATION_RATE_RAD_S,
    SPEED_OF_LIGHT_M_S,
)
from plumbline.gnss.orbits_broadcast import broadcast_states, is_beidou_geo, pack
from plumbline.gnss.ssr_orbits import rotation_ecef_from_rac
from plumbline.gps_time import NS_PER_S, WEEK_NS
from plumbline.records import Floats, Ints, KeplerEphemeris, SatelliteIds, SsrHeader
from plumbline.signals import System, satellite_id, system_of
from plumbline_dtu.corrections import correction_of, zero_code_biases
from plumbline_dtu.encoding import as_received, correction_frames, ephemeris_frame
from plumbline_dtu.simulation.geosynchronous import geosynchronous_orbits

_EPHEMERIS_REPEAT_S: Final = 30
_BIAS_INTERVAL_S: Final = 30


@dataclass(frozen=True, slots=True)
class _Walker:
    """Planes × satellites a plane, and the circular orbit (ICDs' nominal constellations)."""

    first_number: int
    planes: int
    per_plane: int
    phasing: float  # satellite spacings by which a plane leads the one before
    semi_major_axis_m: float
    inclination_rad: float
    eccentricity: float
    period_of_sets_s: int
    message: str


WALKERS: Final[dict[System, _Walker]] = {
    System.GPS: _Walker(1, 6, 5, 0.6, 26_559_800.0, math.radians(55.0), 0.006, 7200, "LNAV"),
    System.GALILEO: _Walker(1, 3, 8, 1.0 / 3.0, 29_599_800.0, math.radians(56.0), 0.0003, 600, "INAV"),
    System.BEIDOU: _Walker(19, 3, 8, 1.0 / 3.0, 27_906_100.0, math.radians(55.0), 0.0006, 3600, "D1"),
}
_GM: Final = {
    System.GPS: EARTH_GM_GPS_M3_S2, System.GALILEO: EARTH_GM_GALILEO_M3_S2, System.BEIDOU: EARTH_GM_BEIDOU_M3_S2,
}  # fmt: skip
_WAVE_S: Final = 1e-9
_WAVE_PERIOD_S: Final = 7200.0


@dataclass(frozen=True)
class Constellation:
    """Satellites of the systems in ``letters`` (of G, E, C), and the seed of everything random about them.

    The true elements hold at ``reference_gps_ns``, which should lie within weeks of the simulation (float64).
    """

    reference_gps_ns: int
    letters: str = "GEC"
    seed: int = 1
    geosynchronous: bool = False  # BeiDou's geostationary and inclined satellites too, and BeiDou-2's medium ones
    truth: dict[int, KeplerEphemeris] = field(init=False)

    def __post_init__(self) -> None:
        found = {}
        for system, walker in WALKERS.items():
            if system.letter in self.letters:
                for index in range(walker.planes * walker.per_plane):
                    ephemeris = _truth(system, walker, index, self.seed, self.reference_gps_ns)
                    found[ephemeris.satellite] = ephemeris
                if self.geosynchronous and system is System.BEIDOU:
                    tow_s = _of_week_s(self.reference_gps_ns, system)
                    found |= {e.satellite: e for e in geosynchronous_orbits(ephemeris, tow_s, self.seed)}
        object.__setattr__(self, "truth", found)

    @property
    def satellites(self) -> SatelliteIds:
        """Satellite ids, ascending."""
        return np.array(sorted(self.truth), np.int16)

    def rows(self) -> Floats:
        """Packed truth for the kernels, in the order of :attr:`satellites`; :func:`clock_wave_s` comes on top."""
        return np.array([pack(self.truth[int(satellite)]) for satellite in self.satellites])

    def broadcast(self, t_gps_ns: int) -> dict[int, KeplerEphemeris]:
        """The sets on the air at a time, as a receiver decodes them."""
        sets = {}
        for satellite, truth in self.truth.items():
            period_ns = WALKERS[system_of(satellite)].period_of_sets_s * NS_PER_S
            sets[satellite] = _broadcast(truth, t_gps_ns // period_ns * period_ns, self.seed)
        return sets


def clock_wave_s(satellite: SatelliteIds, t_gps_ns: Ints) -> Floats:
    """The slow part of the satellites' clocks that no polynomial holds, s."""
    phase = 2.0 * math.pi * ((t_gps_ns % (7200 * NS_PER_S)) / (_WAVE_PERIOD_S * NS_PER_S) + satellite * 0.618)
    return np.asarray(_WAVE_S * np.sin(phase))


def _truth(system: System, walker: _Walker, index: int, seed: int, reference_gps_ns: int) -> KeplerEphemeris:
    satellite = satellite_id(system, walker.first_number + index)
    random = np.random.default_rng([seed, satellite])
    plane, slot = divmod(index, walker.per_plane)
    spacing = 2.0 * math.pi / walker.per_plane
    tow_s = _of_week_s(reference_gps_ns, system)
    rate = _earth_rate(system)
    return KeplerEphemeris(
        satellite=satellite,
        message=walker.message,
        t_receive_ns=reference_gps_ns,
        toe_gps_ns=reference_gps_ns,
        toc_gps_ns=reference_gps_ns,
        issue=0,
        issue_clock=0,
        clock_bias_s=float(random.uniform(-2e-4, 2e-4)),
        clock_drift_s_s=0.0,
        clock_drift_rate_s_s2=0.0,
        sqrt_semi_major_axis_sqrt_m=math.sqrt(walker.semi_major_axis_m),
        eccentricity=walker.eccentricity * float(random.uniform(0.3, 1.0)),
        mean_anomaly_rad=spacing * (slot + walker.phasing * plane) + float(random.uniform(-0.05, 0.05)),
        mean_motion_difference_rad_s=0.0,
        inclination_rad=walker.inclination_rad + float(random.uniform(-0.01, 0.01)),
        inclination_rate_rad_s=0.0,
        ascending_node_rad=2.0 * math.pi * plane / walker.planes + 0.3 * system + rate * tow_s,
        ascending_node_rate_rad_s=-8e-9,
        argument_of_perigee_rad=0.0,
        cuc_rad=0.0,
        cus_rad=0.0,
        crc_m=0.0,
        crs_m=0.0,
        cic_rad=0.0,
        cis_rad=0.0,
        group_delay_s=(0.0, 0.0),
        health=0,
        accuracy_index=0 if system is not System.GALILEO else 107,
        fit_interval_h=4.0,
    )


def _earth_rate(system: System) -> float:
    return EARTH_ROTATION_RATE_BEIDOU_RAD_S if system is System.BEIDOU else EARTH_ROTATION_RATE_RAD_S


def _of_week_s(t_gps_ns: int, system: System) -> float:
    behind_ns = BDT_BEHIND_GPST_S * NS_PER_S if system is System.BEIDOU else 0
    return (t_gps_ns - behind_ns) % WEEK_NS / NS_PER_S


@lru_cache(maxsize=4096)
def _cached_broadcast(key: tuple[int, int, int]) -> dict[str, float]:
    """Errors of a set, by field: about a metre in orbit and clock."""
    random = np.random.default_rng(list(key))
    return {
        "mean_anomaly_rad": float(random.normal(0.0, 3e-8)),
        "inclination_rad": float(random.normal(0.0, 1e-8)),
        "ascending_node_rad": float(random.normal(0.0, 1e-8)),
        "crs_m": float(random.normal(0.0, 0.5)),
        "crc_m": float(random.normal(0.0, 0.5)),
        "clock_bias_s": float(random.normal(0.0, 1.5e-9)),
    }


def _broadcast(truth: KeplerEphemeris, toe_gps_ns: int, seed: int) -> KeplerEphemeris:
    """The truth's elements brought to a reference time, with errors, through RTCM's rounding."""
    system = system_of(truth.satellite)
    if system is System.BEIDOU:
        toe_gps_ns += BDT_BEHIND_GPST_S * NS_PER_S  # round in BDT
    since_s = (toe_gps_ns - truth.toe_gps_ns) / NS_PER_S
    motion = math.sqrt(_GM[system] / truth.sqrt_semi_major_axis_sqrt_m**6)
    rate = _earth_rate(system)
    node_at_week = truth.ascending_node_rad - rate * _of_week_s(truth.toe_gps_ns, system)
    node = node_at_week + (truth.ascending_node_rate_rad_s - rate) * since_s + rate * _of_week_s(toe_gps_ns, system)
    perigee = truth.argument_of_perigee_rad
    if is_beidou_geo(truth.satellite):  # equatorial, in a frame that stops turning at the reference time
        node, perigee = node + rate * since_s, perigee - rate * since_s
    errors = _cached_broadcast((seed, truth.satellite, toe_gps_ns // NS_PER_S % 2**31))
    index = toe_gps_ns // (WALKERS[system].period_of_sets_s * NS_PER_S)
    issue = index % {System.GPS: 240, System.GALILEO: 1000, System.BEIDOU: 24}[system]
    moved = replace(
        truth,
        t_receive_ns=toe_gps_ns,
        toe_gps_ns=toe_gps_ns,
        toc_gps_ns=toe_gps_ns,
        issue=issue,
        issue_clock=issue,
        mean_anomaly_rad=_wrap(truth.mean_anomaly_rad + motion * since_s + errors["mean_anomaly_rad"]),
        ascending_node_rad=_wrap(node + errors["ascending_node_rad"]),
        argument_of_perigee_rad=_wrap(perigee),
        inclination_rad=truth.inclination_rad + errors["inclination_rad"],
        crs_m=errors["crs_m"],
        crc_m=errors["crc_m"],
        clock_bias_s=truth.clock_bias_s + errors["clock_bias_s"],
    )
    received = as_received(moved)
    assert isinstance(received, KeplerEphemeris)
    return received


def _wrap(angle_rad: float) -> float:
    return math.remainder(angle_rad, 2.0 * math.pi)


def simulate_corrections(
    constellation: Constellation, t_first_gps_ns: int, t_last_gps_ns: int, interval_s: int = 5
) -> Iterator[tuple[int, bytes]]:
    """Frames of the correction stream, (time, bytes), on the whole interval: ephemerides, orbits, clocks, biases.

    ``interval_s``: one of SSR's update intervals. The orbits' reference point is the truth's own (phase centres,
    without offsets).
    """
    step_ns = interval_s * NS_PER_S
    t_gps_ns = -(-t_first_gps_ns // step_ns) * step_ns
    sent: dict[int, tuple[int, int]] = {}
    while t_gps_ns <= t_last_gps_ns:
        data = bytearray()
        sets = constellation.broadcast(t_gps_ns)
        for satellite, ephemeris in sets.items():
            toe_ns, t_sent_ns = sent.get(satellite, (0, 0))
            if toe_ns != ephemeris.toe_gps_ns or t_gps_ns - t_sent_ns >= _EPHEMERIS_REPEAT_S * NS_PER_S:
                data += ephemeris_frame(ephemeris)
                sent[satellite] = (ephemeris.toe_gps_ns, t_gps_ns)
        first = t_gps_ns - step_ns < t_first_gps_ns
        with_biases = first or (t_gps_ns // NS_PER_S) % _BIAS_INTERVAL_S < interval_s
        header = SsrHeader(t_gps_ns, t_gps_ns, float(interval_s) if interval_s > 1 else 0.0, 0, 0, 0)
        for part in _corrections(constellation, sets, header, with_biases):
            data += part
        yield t_gps_ns, bytes(data)
        t_gps_ns += step_ns


def _corrections(
    constellation: Constellation, sets: dict[int, KeplerEphemeris], header: SsrHeader, with_biases: bool
) -> Iterator[bytes]:
    satellites = constellation.satellites
    rows = constellation.rows()
    span_s = max(header.update_interval_s, 1.0)
    packed = np.array([pack(sets[int(satellite)]) for satellite in satellites])
    first = _difference(satellites, rows, packed, header.t_gps_ns)
    last = _difference(satellites, rows, packed, header.t_gps_ns + round(span_s * NS_PER_S))
    rate = (last - first) / span_s
    reference = first + rate * (0.5 * header.update_interval_s)
    for system in WALKERS:
        own = np.array([system_of(int(satellite)) is system for satellite in satellites])
        if not own.any():
            continue
        ephemerides = {int(satellite): sets[int(satellite)] for satellite in satellites[own]}
        correction = correction_of(header, ephemerides, reference[own], rate[own])
        yield from correction_frames(correction.orbit)
        yield from correction_frames(correction.clock)
        if with_biases:  # behind the orbits, which tell the dialect of BeiDou's messages
            yield from correction_frames(zero_code_biases(header, satellites[own].tolist()))


def _difference(satellites: SatelliteIds, rows: Floats, broadcast_rows: Floats, t_gps_ns: int) -> Floats:
    """Broadcast minus true orbit in radial, along, cross, and true minus broadcast clock, m: (n, 4)."""
    times: Ints = np.full(len(satellites), t_gps_ns, np.int64)
    truth, broadcast = broadcast_states(rows, times), broadcast_states(broadcast_rows, times)
    out = np.empty((len(satellites), 4))
    for k in range(len(satellites)):
        rotation = rotation_ecef_from_rac(broadcast.position_ecef_m[k], broadcast.velocity_ecef_m_s[k])
        out[k, :3] = rotation.T @ (broadcast.position_ecef_m[k] - truth.position_ecef_m[k])
    out[:, 3] = (truth.clock_s + clock_wave_s(satellites, times) - broadcast.clock_s) * SPEED_OF_LIGHT_M_S
    return out
