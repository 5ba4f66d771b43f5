"""Settings: read once, checked, frozen. A station's live in the database, seeded from TOML; a server's in TOML."""

import tomllib
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from plumbline.errors import ConfigurationError

StationId = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,62}$")]
Vector3 = tuple[float, float, float]


class Mode(StrEnum):
    """How a station is processed."""

    PPP = "ppp"
    PPP_ACCEL = "ppp-accel"
    RTK = "rtk"  # against a base station's stream
    RTK_NETWORK = "rtk-network"  # against several bases, adjusted together
    RTK_IMU_LOOSE = "rtk-imu-loose"  # mode rtk, its positions and velocities fused with an IMU
    RTK_IMU_TIGHT = "rtk-imu-tight"  # one to N antennas' phases and range rates with an IMU in one filter
    CORRECTIONS = "corrections"  # not a station: a stream of ephemerides or SSR that others use


class AntennaMotion(StrEnum):
    """What the position filter expects of the antenna."""

    KINEMATIC = "kinematic"
    STATIC = "static"


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class DeviceSettings(_Frozen):
    """How a station's device is recognised and spoken to."""

    registrations: tuple[str, ...] = ()  # first bytes that name the station; \\xNN escapes allowed
    token: str | None = None  # for `ID,TOKEN` and NTRIP passwords; None: any
    port: int | None = Field(None, ge=1, le=65535)  # a listening port bound to this station alone
    prefix_mode: bool = False  # the registration stands before every data packet
    heartbeat: str | None = None  # bytes between frames that are a heartbeat (counted; anything else is noise)
    echo_heartbeat: bool = False
    rtcm_station_ids: tuple[int, ...] = ()  # on a shared connection: the DF003 values that are this station's
    inertial_message: int = Field(4001, ge=1, le=4095)


class PositioningSettings(_Frozen):
    """Settings of the position filter. Noise values are one sigma."""

    systems: str = Field("GREC", pattern=r"^[GRESJCI]+$")
    elevation_mask_deg: float = Field(7.0, ge=0, lt=90)
    motion: AntennaMotion = AntennaMotion.KINEMATIC
    ambiguity_resolution: Literal["off"] = "off"  # of PPP: float alone
    code_sigma_m: float = Field(0.15, gt=0)  # at the zenith, per signal; raised where the codes are noisier
    phase_sigma_m: float = Field(0.002, gt=0)
    static_process_noise_m_sqrt_h: float = Field(0.0, ge=0)
    zenith_delay_process_noise_m_sqrt_h: float = Field(0.008, ge=0)
    gradient_process_noise_m_sqrt_h: float = Field(0.0003, ge=0)
    max_correction_age_s: float = Field(30.0, gt=0)  # clock; orbits and biases have their own, longer, limits
    max_orbit_correction_age_s: float = Field(120.0, gt=0)
    max_bias_age_s: float = Field(7200.0, gt=0)
    galileo_message: Literal["INAV", "FNAV"] = "INAV"  # the ephemerides that the corrections' clocks refer to
    corrections_refer_to: Literal["phase_centre", "centre_of_mass"] = "phase_centre"  # the corrected orbits
    max_gap_s: float = Field(600.0, gt=0)  # the filter's ambiguities are kept over gaps up to this
    quality_control: Literal["on", "off"] = "on"  # off: nothing is left out
    test_significance: float = Field(0.05, gt=0, lt=1)  # of the global test, familywise
    test_power: float = Field(0.80, gt=0, lt=1)  # at which minimal detectable biases are found
    w_test_significance: float = Field(0.001, gt=0, lt=1)
    integrity_risk: float = Field(1e-5, gt=0, lt=0.1)  # that the position's error exceeds its protection level
    converged_sigma_m: float = Field(0.05, gt=0)  # three-dimensional sigma at which "converging" ends


class RtkSettings(_Frozen):
    """Settings of positioning against a base station. Noise values are one sigma, per receiver."""

    base_stream: StationId | None = None  # the stream that carries the base's observations
    base_streams: tuple[StationId, ...] = ()  # mode rtk-network: those of the bases; empty: all that there are
    base_position_ecef_m: Vector3 | None = None  # antenna reference point; None: the stream's 1005/1006
    moving_base: bool = False  # the base's own position is computed anew at every epoch
    max_base_age_s: float = Field(10.0, gt=0)  # older base data are not bridged
    base_wait_s: float = Field(0.3, ge=0)  # how long an epoch waits for the base's of the same instant
    frequencies: int = Field(2, ge=1, le=3)
    integers: Literal["off", "continuous", "instantaneous"] = "continuous"  # instantaneous: every epoch for itself
    hold: bool = True  # resolved integers are kept as long as nothing speaks against them
    partial: bool = True  # where not all integers can be resolved, resolve those that can
    min_ratio: float = Field(2.0, ge=1)
    min_success_rate: float = Field(0.999, ge=0, lt=1)
    ambiguity_memory_s: float = Field(600.0, gt=0)  # time over which the float ambiguities forget
    code_sigma_m: float = Field(0.30, gt=0)  # at the zenith
    phase_sigma_m: float = Field(0.002, gt=0)
    doppler_sigma_m_s: float = Field(0.05, gt=0)
    position_noise_m_sqrt_s: float | None = Field(None, gt=0)  # of a static antenna; None: kinematic, no memory


class FusionSettings(_Frozen):
    """Settings of the multirate filter (Wang 2023, eqs 1-8). Densities are one sigma."""

    rotation_enu_from_sensor: tuple[Vector3, Vector3, Vector3] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    inertial_time_offset_s: float = Field(0.0, ge=-10, le=10)  # added to the samples' time stamps
    acceleration_noise_m_s2_sqrt_hz: float = Field(2.6e-4, gt=0)  # two-sided; SCA3300: 37 µg/√Hz one-sided
    shaking_noise_sqrt_s: float = Field(
        2.0e-3, ge=0
    )  # times the acceleration, added to its noise: gain and axis errors
    baseline_drift_m_s2_sqrt_s: float = Field(1.0e-5, gt=0)
    shaking_drift_sqrt_hz: float = Field(5.0e-5, ge=0)  # times the acceleration, added to the drift: shaking tilts
    coasting_noise_m_s2_sqrt_hz: float = Field(0.05, gt=0)  # acceleration that nobody measures, without samples
    displacement_sigma_m: Vector3 | None = None  # None: the solution's own covariance
    innovation_gate_sigma: float = Field(6.0, gt=0)  # a solution further off its prediction is refused
    test_power: float = Field(0.80, gt=0, lt=1)  # at which minimal detectable biases of solutions are found
    max_refusals: int = Field(3, ge=1)  # this many in a row, and the filter starts anew from the solution
    accelerometer_timeout_s: float = Field(3.0, gt=0)  # samples later than this: motion from GNSS alone
    coasting_after_s: float = Field(10.0, gt=0)  # without a solution, motion is marked as coasting
    late_limit_s: float = Field(30.0, gt=0)  # how old a GNSS solution may be applied


class InertialSettings(_Frozen):
    """Settings of a platform with several antennas, an IMU or both. Densities are one sigma, two-sided.

    Body axes are right, forward, up. The defaults are those of a tactical MEMS unit (ADIS16495). Mode ``rtk`` gives the
    attitude where there is more than one lever arm; their origin does not matter then.
    """

    rotation_body_from_sensor: tuple[Vector3, Vector3, Vector3] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    lever_arms_body_m: tuple[Vector3, ...] = ((0.0, 0.0, 0.0),)  # IMU → phase centre of each antenna
    inertial_time_offset_s: float = Field(0.0, ge=-10, le=10)  # added to the samples' time stamps
    inertial_time_offset_sigma_s: float = Field(0.0, ge=0)  # loose: of that offset, estimated then; 0: as it is given
    inertial_time_drift_sigma: float = Field(3e-4, ge=0)  # s/s, of an estimated offset: a logger's clock
    inertial_time_walk_s_sqrt_s: float = Field(1e-4, ge=0)  # what an estimated offset wanders besides, in √s
    accelerometer_noise_m_s2_sqrt_hz: float = Field(1.4e-4, gt=0)
    gyroscope_noise_rad_s_sqrt_hz: float = Field(2.7e-5, gt=0)
    accelerometer_bias_sigma_m_s2: float = Field(2.0e-3, gt=0)
    accelerometer_bias_time_s: float = Field(3600.0, gt=0)
    gyroscope_bias_sigma_rad_s: float = Field(1.0e-5, gt=0)
    gyroscope_bias_time_s: float = Field(3600.0, gt=0)
    initial_accelerometer_bias_sigma_m_s2: float = Field(0.03, gt=0)
    initial_gyroscope_bias_sigma_rad_s: float = Field(2.0e-3, gt=0)
    shaking_force_sqrt_s: float = Field(0.0, ge=0)  # times the acceleration, added to its noise: gain and axis errors
    shaking_rate_sqrt_s: float = Field(0.0, ge=0)  # times the rate, added to the gyroscope's noise
    gap_acceleration_m_s2_sqrt_hz: float = Field(1.0, gt=0)  # while samples are missing
    heading_deg: float | None = None  # known heading of the body's forward axis; None: found from the motion
    heading_sigma_deg: float = Field(1.0, gt=0)  # of a known heading
    velocity_sigma_m_s: float = Field(0.05, gt=0)  # of a solution's velocity that carries none of its own
    velocity_delay_s: float = Field(0.0, ge=-1, le=1)  # a solution's velocity is the one of so long before its position
    position_sigma_floor_m: float = Field(0.0, ge=0)
    phase_correlation_s: float = Field(0.0, ge=0)  # tight: how long a phase's error (multipath) lasts; 0: white
    innovation_gate_sigma: float = Field(6.0, gt=0)
    max_refusals: int = Field(5, ge=1)  # this many in a row, and the filter believes them
    standstill: Literal["off", "on"] = "on"
    standstill_window_s: float = Field(0.5, gt=0)
    standstill_force_sigma_m_s2: float = Field(0.02, gt=0)  # spread of the samples in a window at rest, at most
    standstill_rate_sigma_rad_s: float = Field(0.002, gt=0)
    standstill_velocity_sigma_m_s: float = Field(0.005, gt=0)
    standstill_bias_sigma_rad_s: float = Field(1.0e-5, ge=0)  # of a window's mean rate as the gyroscope's bias
    late_limit_s: float = Field(5.0, gt=0)  # how old a GNSS measurement may be applied


class StationSettings(_Frozen):
    """Everything that a station's pipeline needs to know."""

    station: StationId
    name: str = ""
    mode: Mode = Mode.PPP_ACCEL
    reference_position_ecef_m: Vector3 | None = None  # None: the first converged position becomes it
    reference_frame: str = "ITRF2020"  # a note kept with the position
    antenna_type: str | None = None  # IGS name and radome; None: what the stream says
    antex: str | None = None  # path of a file of antenna calibrations
    antenna_height_m: float = 0.0  # reference point above the marker
    ocean_loading_blq: str | None = None  # path of a BLQ file
    epoch_deadline_s: float = Field(0.8, gt=0)  # how long an epoch waits for late constellations
    silent_after_s: float = Field(10.0, gt=0)
    neighbours: tuple[StationId, ...] = Field((), max_length=8)  # stations that move as this one does: its witnesses
    neighbour_share: float = Field(0.5, gt=0, le=1)  # of a displacement, that a neighbour must show to bear it out
    device: DeviceSettings = DeviceSettings()
    positioning: PositioningSettings = PositioningSettings()
    rtk: RtkSettings = RtkSettings()
    fusion: FusionSettings = FusionSettings()
    inertial: InertialSettings = InertialSettings()
    antenna_streams: tuple[StationId, ...] = ()  # of mode corrections: further antennas of the platform, one a stream
    inertial_stream: StationId | None = None  # of mode corrections: the IMU's; None: the station's own

    @property
    def n_antennas(self) -> int:
        """Antennas that are used: one a lever arm, in the modes that can use several."""
        several = self.mode in (Mode.RTK, Mode.RTK_IMU_LOOSE, Mode.RTK_IMU_TIGHT)
        return len(self.inertial.lever_arms_body_m) if several else 1

    @property
    def n_own_antennas(self) -> int:
        """How many of them come on the station's own stream."""
        return self.n_antennas - len(self.antenna_streams) if self.n_antennas > 1 else 1

    @model_validator(mode="after")
    def _antennas_are_named(self) -> Self:
        ids, streams, own = self.device.rtcm_station_ids, self.antenna_streams, self.n_own_antennas
        if not self.inertial.lever_arms_body_m:
            raise ValueError("inertial.lever_arms_body_m wants a lever arm for each antenna")
        if streams and self.rtk.base_stream is None:
            raise ValueError("antenna_streams want rtk.base_stream too: the base is one stream of several")
        if own < 1 or len(streams) > self.n_antennas - 1:
            arms = f"{self.n_antennas} lever arms and {len(streams)} antenna_streams"
            raise ValueError(f"{arms}: the station's own antenna comes first and wants one too")
        if own > 1 and len(ids) != own:
            raise ValueError(
                f"{own} antennas on the station's own stream: device.rtcm_station_ids has to name the station id "
                "(DF003) of each, in the order of inertial.lever_arms_body_m"
            )
        return self


class NtripSource(_Frozen):
    """A caster's mountpoint that the server fetches as a stream of its own."""

    station: StationId
    url: str = Field(pattern=r"^https?://")  # http://host:port/MOUNT
    user: str | None = None
    password: str | None = None
    version: Literal[1, 2] = 2
    send_position_ecef_m: Vector3 | None = None  # for a virtual reference station: sent as GGA every 10 s


class ThresholdSettings(_Frozen):
    """A threshold as the seeding file gives it; SI units."""

    threshold_id: StationId
    station: StationId
    quantity: str
    level: float
    severity: Literal["warning", "alarm"] = "alarm"
    on_delay_s: float = Field(0.0, ge=0)
    off_delay_s: float = Field(0.0, ge=0)
    dead_band: float = Field(0.0, ge=0)
    enabled: bool = True


class ServerSettings(_Frozen):
    """The server's own settings."""

    data_dir: Path = Path("plumbline-data")
    database_url: str | None = None  # None: SQLite in data_dir
    http_host: str = "0.0.0.0"
    http_port: int = Field(8000, ge=0, le=65535)
    ingest_host: str = "0.0.0.0"
    ingest_port: int = Field(9000, ge=0, le=65535)
    tls_certificate: Path | None = None
    tls_key: Path | None = None
    workers: int | None = Field(None, ge=1)  # None: cores − 1, at least 1
    bus_endpoint: str = "tcp/127.0.0.1:0"  # where the main process listens for zenoh peers; port 0: a free one
    bus_connect: tuple[str, ...] = ()  # routers or peers on other machines
    registration_deadline_s: float = Field(15.0, gt=0)
    idle_deadline_s: float = Field(120.0, gt=0)
    max_connections: int = Field(20_000, ge=1)
    max_connections_per_address: int = Field(2_000, ge=1)
    hold_back_s: float = Field(0.05, ge=0)  # how often ingest tells workers its clock
    checkpoint_interval_s: float = Field(10.0, gt=0)
    stations: tuple[StationSettings, ...] = ()
    thresholds: tuple[ThresholdSettings, ...] = ()
    ntrip: tuple[NtripSource, ...] = ()

    @model_validator(mode="after")
    def _tls_needs_both(self) -> Self:
        if (self.tls_certificate is None) != (self.tls_key is None):
            raise ValueError("tls_certificate and tls_key go together")
        return self


def read_server_settings(path: Path | None, **overrides: object) -> ServerSettings:
    """Settings from TOML (None: defaults) and non-None overrides; raises ConfigurationError saying what is wrong."""
    try:
        text = path.read_text(encoding="utf-8") if path else ""
        values = tomllib.loads(text) | {key: value for key, value in overrides.items() if value is not None}
        return ServerSettings.model_validate(values)
    except OSError as error:
        raise ConfigurationError(f"cannot read {path}: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, ValidationError) as error:
        raise ConfigurationError(f"{path or 'settings'}: {error}") from error
