"""Every noun that passes between stages. All are frozen: a stage answers with new records and changes none.

Arrays are ``float64`` unless said otherwise, NaN means missing, and are not to be written to. Times are GPS time in
integer nanoseconds (``_gps_ns``) unless their name says otherwise; ``t_receive_ns`` is the GPS time at which ingest
received the last byte that the record was made of. Frames and units stand in the names; ``enu`` is east, north, up at
the station's reference position.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
SatelliteIds = NDArray[np.int16]
SignalIds = NDArray[np.int16]
Booleans = NDArray[np.bool_]


# --------------------------------------------------------------------------------------------- from the receiver


@dataclass(frozen=True, slots=True)
class Chunk:
    """Bytes of one stream as received and archived: (archive, station, offset) names the first byte for ever."""

    archive: str  # id of the archive that holds them: one an ingest
    station: str
    offset: int  # of the first byte, counted from the stream's first byte in that archive
    t_receive_ns: int  # strictly increasing within an archive
    data: bytes

    @property
    def end(self) -> int:
        """Offset of the byte after the last."""
        return self.offset + len(self.data)


@dataclass(frozen=True, slots=True)
class Epoch:
    """All observations of one antenna at one instant: struct of arrays, one row per (satellite, signal).

    Rows are sorted by satellite, then signal. Shapes are all (n,).
    """

    t_gps_ns: int
    t_receive_ns: int
    satellite: SatelliteIds
    signal: SignalIds
    pseudorange_m: Floats
    carrier_phase_cycles: Floats  # grows with distance, like the pseudorange (RINEX sign)
    doppler_hz: Floats  # positive when the satellite approaches (RINEX sign)
    cn0_db_hz: Floats
    lock_time_s: Floats  # the least time of uninterrupted lock, as the indicator guarantees it; NaN unknown
    half_cycle_ambiguous: Booleans
    glonass_channel: NDArray[np.int8]  # −7…+6 for GLONASS; UNKNOWN_CHANNEL where not known; 0 for the others
    antenna: int = 0  # RTCM station id (DF003) or antenna number that the rows came from
    loss_of_lock: Booleans | None = None  # RINEX loss-of-lock flag, where the source has one (None: it has not)


UNKNOWN_CHANNEL = -128


class InertialKind(StrEnum):
    """What an inertial sensor measures."""

    ACCELEROMETER = "accelerometer"
    IMU = "imu"  # accelerometer and gyroscope


@dataclass(frozen=True, slots=True)
class InertialBlock:
    """Evenly spaced samples of one sensor, in the sensor's own axes."""

    t_first_gps_ns: int
    t_receive_ns: int
    interval_ns: int
    specific_force_m_s2: Floats  # (n, 3): at rest the axis that points up reads +g
    angular_rate_rad_s: Floats | None = None  # (n, 3), None for an accelerometer alone
    sensor: int = 0
    temperature_c: float | None = None


@dataclass(frozen=True, slots=True)
class AntennaDescription:
    """What a stream says of its own antenna and receiver (1005–1008, 1013, 1033, 1230); None where it has not said."""

    antenna: int
    position_ecef_m: tuple[float, float, float] | None = None  # antenna reference point
    antenna_height_m: float | None = None  # of the reference point above the marker
    antenna_type: str | None = None
    antenna_serial: str | None = None
    receiver_type: str | None = None


# --------------------------------------------------------------------------------------------- from the satellites


@dataclass(frozen=True, slots=True)
class KeplerEphemeris:
    """A broadcast ephemeris in Keplerian elements: GPS, Galileo, QZSS, BeiDou, NavIC (their interface documents).

    Angles in radians, lengths in metres, times in seconds. ``toe``, ``toc`` are in GPS time whatever the system's own.
    """

    satellite: int
    message: str  # "LNAV", "INAV", "FNAV", "D1", "D2"
    t_receive_ns: int
    toe_gps_ns: int
    toc_gps_ns: int
    issue: int  # IODE (GPS, QZSS, NavIC: IODEC), IODnav (Galileo), AODE (BeiDou)
    issue_clock: int  # IODC (GPS, QZSS), AODC (BeiDou); IODnav for Galileo
    clock_bias_s: float
    clock_drift_s_s: float
    clock_drift_rate_s_s2: float
    sqrt_semi_major_axis_sqrt_m: float
    eccentricity: float
    mean_anomaly_rad: float  # M0
    mean_motion_difference_rad_s: float  # delta n
    inclination_rad: float  # i0
    inclination_rate_rad_s: float  # IDOT
    ascending_node_rad: float  # OMEGA0
    ascending_node_rate_rad_s: float  # OMEGA DOT
    argument_of_perigee_rad: float  # omega
    cuc_rad: float
    cus_rad: float
    crc_m: float
    crs_m: float
    cic_rad: float
    cis_rad: float
    group_delay_s: tuple[float, float]  # GPS TGD, 0; Galileo BGD E1/E5a, BGD E1/E5b; BeiDou TGD1, TGD2
    health: int  # zero is healthy, as the message codes it
    accuracy_index: int  # URA / SISA / URAI index
    fit_interval_h: float = 0.0


@dataclass(frozen=True, slots=True)
class GlonassEphemeris:
    """A GLONASS (1020) broadcast state vector in PZ-90, to be integrated."""

    satellite: int
    t_receive_ns: int
    toe_gps_ns: int  # t_b as GPS time
    issue: int  # t_b index: 15 min units of the day in UTC + 3 h
    frequency_channel: int  # −7…+6
    position_pz90_m: tuple[float, float, float]
    velocity_pz90_m_s: tuple[float, float, float]
    acceleration_pz90_m_s2: tuple[float, float, float]
    clock_bias_s: float  # −tau_n, so that it is added like the other systems' bias
    frequency_bias: float  # gamma_n
    group_delay_s: float  # delta tau_n
    health: int
    age_days: int = 0


Ephemeris = KeplerEphemeris | GlonassEphemeris


@dataclass(frozen=True, slots=True)
class SsrHeader:
    """What every SSR message begins with; the epoch already resolved to GPS time."""

    t_gps_ns: int
    t_receive_ns: int
    update_interval_s: float  # 0: the correction's reference time is t_gps_ns itself
    iod_ssr: int
    provider: int
    solution: int
    regional_datum: bool = False  # orbit messages: satellite reference datum, False = ITRF


@dataclass(frozen=True, slots=True)
class SsrOrbit:
    """Orbit corrections, shapes (n,) and (n, 3): radial, along-track, cross-track. They are *subtracted*."""

    header: SsrHeader
    satellite: SatelliteIds
    issue: Ints  # the broadcast ephemeris they refer to
    delta_rac_m: Floats
    delta_rate_rac_m_s: Floats
    issue_rule: str = "issue"  # how `issue` names its ephemeris: its own issue, or BeiDou's "toe_8s", "toe_720s"


@dataclass(frozen=True, slots=True)
class SsrClock:
    """Clock corrections c0 + c1 dt + c2 dt², as metres: satellite offset = broadcast offset + correction / c."""

    header: SsrHeader
    satellite: SatelliteIds
    polynomial_m: Floats  # (n, 3): m, m/s, m/s²
    high_rate: bool = False  # 1062 and kin: added to the last clock correction


@dataclass(frozen=True, slots=True)
class SsrCodeBias:
    """Code biases by satellite and signal, metres, *added* to the measured pseudorange. Shapes (n,)."""

    header: SsrHeader
    satellite: SatelliteIds
    signal: SignalIds
    bias_m: Floats


@dataclass(frozen=True, slots=True)
class SsrPhaseBias:
    """Phase biases by satellite and signal, metres, *added* to the measured phase. Shapes (n,)."""

    header: SsrHeader
    satellite: SatelliteIds
    signal: SignalIds
    bias_m: Floats
    integer: Booleans  # the ambiguity of this signal is an integer with it
    wide_lane_integer: Ints  # 0: none, 1 and 2: groups, as the message codes them
    discontinuity: Ints  # a new value means a new ambiguity
    yaw_angle_rad: Floats
    yaw_rate_rad_s: Floats
    dispersive_bias_consistent: bool = False
    mw_consistent: bool = False


@dataclass(frozen=True, slots=True)
class SsrUra:
    """User range accuracy by satellite, metres. Shapes (n,)."""

    header: SsrHeader
    satellite: SatelliteIds
    ura_m: Floats


@dataclass(frozen=True, slots=True)
class SsrVtec:
    """Vertical TEC in spherical harmonics by layer (1264 family and 4076_201)."""

    header: SsrHeader
    quality_tecu: float
    layer_height_km: tuple[float, ...]
    cosine_tecu: tuple[Floats, ...]  # by layer (degree + 1, order + 1), zero where order > degree
    sine_tecu: tuple[Floats, ...]


SsrCorrection = SsrOrbit | SsrClock | SsrCodeBias | SsrPhaseBias | SsrUra | SsrVtec


@dataclass(frozen=True, slots=True)
class PreciseOrbits:
    """Positions of the satellites' centres of mass on a common time grid (SP3), NaN where missing."""

    satellite: SatelliteIds  # (s,), ascending
    t_gps_ns: Ints  # (m,), strictly ascending
    position_ecef_m: Floats  # (m, s, 3)


@dataclass(frozen=True, slots=True)
class PreciseClocks:
    """Satellite clock offsets on a common time grid (CLK), NaN where missing; no periodic relativistic term in them."""

    satellite: SatelliteIds  # (s,), ascending
    t_gps_ns: Ints  # (m,), strictly ascending
    clock_s: Floats  # (m, s)


@dataclass(frozen=True, slots=True)
class AntennaPattern:
    """Phase centre of one antenna at one frequency, as ANTEX gives it; metres."""

    frequency: str  # ANTEX code: system letter and band, "G01", "E05"
    offset_m: tuple[float, float, float]  # receivers: north, east, up; satellites: x, y, z of the body
    variation_m: Floats  # (zenith or nadir grid,): without azimuth (NOAZI)
    variation_by_azimuth_m: Floats | None = None  # (azimuth grid, zenith grid), from azimuth 0 to 360° inclusive


@dataclass(frozen=True, slots=True)
class AntennaCalibration:
    """An ANTEX antenna: a receiver's type (``satellite`` None) or a satellite's for a span of time."""

    antenna_type: str  # "ASH701945E_M    SCIS": receivers antenna and radome, satellites the block
    serial: str  # receivers: empty for a type mean; satellites: the RINEX name (G05)
    zenith_grid_rad: Floats  # evenly spaced zenith angles (satellites: nadir angles)
    patterns: tuple[AntennaPattern, ...]
    satellite: int | None = None
    valid_from_gps_ns: int | None = None
    valid_until_gps_ns: int | None = None


# --------------------------------------------------------------------------------------------- results


class Status(StrEnum):
    """What became of an epoch. Everything but the first three is 'no solution', and its reason says what to do."""

    PPP_FLOAT = "ppp_float"
    PPP_FIXED = "ppp_fixed"
    CONVERGING = "ppp_converging"  # a position, not yet at the accuracy asked for
    SINGLE_POINT = "single_point"  # a metre-level position: no corrections needed
    RTK_FLOAT = "rtk_float"
    RTK_FIXED = "rtk_fixed"
    NO_OBSERVATIONS = "no_observations"
    NO_EPHEMERIS = "no_ephemeris"
    NO_CORRECTIONS = "no_corrections"
    TOO_FEW_SATELLITES = "too_few_satellites"
    NO_BASE = "no_base"
    REJECTED = "rejected_by_quality_control"
    DIVERGED = "diverged"
    COASTING = "coasting"  # motion without GNSS: carried by the accelerometer alone
    ALIGNING = "aligning"  # the platform's attitude is not known yet
    NO_INERTIAL = "no_inertial"  # the mode wants an IMU, and its samples do not come

    @property
    def has_position(self) -> bool:
        """Whether an epoch of this status carries a position."""
        return self in _WITH_POSITION


_WITH_POSITION = frozenset(
    {Status.PPP_FLOAT, Status.PPP_FIXED, Status.CONVERGING, Status.SINGLE_POINT, Status.RTK_FLOAT, Status.RTK_FIXED}
)


@dataclass(frozen=True, slots=True)
class Solution:
    """The position of one antenna at one epoch, or the reason why there is none."""

    station: str
    t_gps_ns: int
    t_receive_ns: int
    status: Status
    reason: str  # empty when all is well; else words that a user can act on
    n_satellites: int = 0
    position_ecef_m: Floats | None = None  # (3,)
    displacement_enu_m: Floats | None = None  # (3,) from the reference position
    covariance_enu_m2: Floats | None = None  # (3, 3)
    velocity_enu_m_s: Floats | None = None  # (3,)
    systems: str = ""  # letters of the systems used
    zenith_delay_m: float | None = None  # total tropospheric zenith delay
    receiver_clock_s: float | None = None
    correction_age_s: float | None = None
    pdop: float | None = None
    extras: Mapping[str, float] = field(default_factory=dict)
    noise_enu_m2: Floats | None = None  # (3, 3) the part of the covariance that is new in this epoch; None: all of it
    attitude_rad: Floats | None = None  # (3,) roll, pitch, heading; NaN where the antennas do not tell it
    sigma_attitude_rad: Floats | None = None  # (3,)


@dataclass(frozen=True, slots=True)
class Motion:
    """A block of fused motion, evenly sampled; a later ``revision`` of the same block replaces the earlier.

    All arrays (n, 3), ENU; the attitude's columns are roll, pitch, heading (body axes right, forward, up).
    """

    station: str
    t_first_gps_ns: int
    t_receive_ns: int
    interval_ns: int
    displacement_enu_m: Floats
    velocity_enu_m_s: Floats
    acceleration_enu_m_s2: Floats  # baseline and gravity removed
    sigma_displacement_enu_m: Floats
    status: Status
    revision: int = 0
    reason: str = ""  # empty when all is well; else words that a user can act on
    attitude_rad: Floats | None = None
    sigma_attitude_rad: Floats | None = None


class Severity(StrEnum):
    """How urgent an alert is."""

    WARNING = "warning"
    ALARM = "alarm"


class AlertState(StrEnum):
    """ISA-18.2, in short."""

    ACTIVE = "active"
    ACKNOWLEDGED = "acknowledged"
    CLEARED = "cleared"


@dataclass(frozen=True, slots=True)
class Threshold:
    """When a quantity of a station is alarming."""

    threshold_id: str
    station: str
    quantity: str  # "displacement_horizontal", "displacement_east" … (alerts.rules lists them)
    level: float  # SI
    severity: Severity = Severity.ALARM
    on_delay_s: float = 0.0
    off_delay_s: float = 0.0
    dead_band: float = 0.0  # clears below level − dead_band
    enabled: bool = True


@dataclass(frozen=True, slots=True)
class AlertEvent:
    """A threshold was crossed (ACTIVE) or left (CLEARED), in event time."""

    alert_id: str  # station, threshold and onset: the same crossing has the same id whenever it is computed
    station: str
    threshold_id: str
    state: AlertState
    severity: Severity
    t_gps_ns: int  # of this event
    t_onset_gps_ns: int
    t_receive_ns: int
    quantity: str
    value: float
    level: float
    text: str


@dataclass(frozen=True, slots=True)
class StationStatus:
    """A station's health in one look, made by its pipeline about once a second of receive time."""

    station: str
    t_receive_ns: int
    state: str  # "waiting", "receiving", "silent"; receiving means decoded epochs, not an open socket
    reason: str
    last_epoch_gps_ns: int | None
    solution_status: Status | None
    n_satellites: int
    counters: Mapping[str, int]


class Verdict(IntEnum):
    """What quality control made of an observation; everything but ACCEPTED means that it was left out."""

    ACCEPTED = 0
    OUTLIER = 1  # its own error explains the misfit best
    SLIP = 2  # a phase that came back different: its ambiguity begins anew
    UNDECIDED = 3  # a phase that is off, by an outlier or a slip: the next epochs tell which
    INSEPARABLE = 4  # it, or another one that the geometry cannot tell from it
    SLOW_BIAS = 5  # a bias too small for one epoch, found over a window
    EPOCH = 6  # the observations contradict each other and none could be named: the whole epoch


@dataclass(frozen=True, slots=True)
class QualityReport:
    """What an epoch's solution is worth (Lee 2016, section 2.3): its tests, and a row for each observation, (m,).

    ``tests`` names: ``statistic``, ``degrees_of_freedom`` and ``critical_value`` of the global test before anything was
    left out and, with the suffix ``_after``, of what remained; the same of the ``window``; ``significance``, ``power``,
    ``w_significance``, ``w_critical``, ``noncentrality``; ``variance_factor`` (posterior over prior). Statistics are
    over what is usual of the station; critical values allow for how much that varies.
    """

    station: str
    t_gps_ns: int
    t_receive_ns: int
    tests: Mapping[str, float]
    satellite: SatelliteIds
    is_phase: Booleans
    signals: SignalIds  # (m, 2) the two that the ionosphere-free combination is made of, −1: none
    residual_m: Floats  # innovation: measured less predicted
    sigma_m: Floats  # of the observation
    redundancy: Floats  # 0: nothing checks it, 1: all of an error shows in its residual
    mdb_m: Floats  # minimal detectable bias at the power stated
    w: Floats  # w-test, standard normal without an error
    external_enu_m: Floats  # (m, 3) what an error of the MDB's size does to the position
    qdop: Floats  # geometry's share in the observation, 0…1
    elevation_rad: Floats
    azimuth_rad: Floats  # clockwise from north
    verdict: NDArray[np.int8]  # Verdict
    hdop: float
    vdop: float
    pdop: float
    protection_horizontal_m: float  # bounds the position error at the integrity risk
    protection_vertical_m: float
    integrity_risk: float
    events: tuple[str, ...] = ()  # what quality control did beyond leaving out, in words


Output = Solution | Motion | AlertEvent | StationStatus | QualityReport
