"""The header of a RINEX observation file (RINEX 3.05, table A2; RINEX 2.11, table A1)."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from plumbline.files.calendar_time import fractional_second_ns, gps_ns_of_calendar
from plumbline.files.text import LineSource
from plumbline.signals import System, satellite_of_name, system_of_letter


@dataclass(frozen=True, slots=True)
class RinexObservationHeader:
    """Facts of an observation file. Positions and heights as the file's author knew them: often metres off."""

    version: float
    marker_name: str = ""
    receiver_type: str = ""
    antenna_serial: str = ""
    antenna_type: str = ""  # antenna and radome, 20 characters stripped: "ASH701945E_M    SCIS"
    approximate_position_ecef_m: tuple[float, float, float] | None = None
    antenna_delta_hen_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # reference point above the marker; east; north
    interval_s: float | None = None
    time_scale: str = "GPS"
    t_first_gps_ns: int | None = None
    t_last_gps_ns: int | None = None
    glonass_channels: Mapping[int, int] = field(default_factory=dict)  # satellite id → −7…+6
    phase_shifts_cycles: Mapping[tuple[str, str], float] = field(default_factory=dict)  # ("G", "2W") → applied shift
    observation_types: Mapping[System, tuple[str, ...]] = field(default_factory=dict)  # RINEX 3
    observation_types_v2: tuple[str, ...] = ()  # RINEX 2: common to all systems
    scale_factors: Mapping[tuple[System, str], float] = field(default_factory=dict)  # values are divided by them


def read_observation_header(source: LineSource) -> RinexObservationHeader:
    """Consume the header; raises FileFormatError where the file is no RINEX 2 or 3 observation file."""
    lines = _header_lines(source)
    first = lines[0][1] if lines else ""
    if not lines or lines[0][0] != "RINEX VERSION / TYPE" or first[20:21] != "O":
        raise source.error("not a RINEX observation file")
    version = float(first[:9])
    if not 2.0 <= version < 4.1:
        raise source.error(f"RINEX version {version} is not supported")
    by_label: dict[str, list[str]] = {}
    for label, text in lines:
        by_label.setdefault(label, []).append(text)
    try:
        return _header(version, by_label)
    except (ValueError, IndexError) as error:
        raise source.error(f"damaged header: {error}") from error


def _header_lines(source: LineSource) -> list[tuple[str, str]]:
    lines: list[tuple[str, str]] = []
    for raw in source:
        text = raw.decode("ascii", "replace")
        label = text[60:80].strip()
        if label == "END OF HEADER":
            return lines
        lines.append((label, text[:60]))
        if lines[0][0] != "RINEX VERSION / TYPE":
            break
    raise source.error("no RINEX header")


def _header(version: float, by_label: dict[str, list[str]]) -> RinexObservationHeader:
    def one(label: str) -> str:
        return by_label.get(label, [" " * 60])[0].ljust(60)

    scale, t_first = _time(one("TIME OF FIRST OBS"))
    _, t_last = _time(one("TIME OF LAST OBS"), scale)
    position = _triple(one("APPROX POSITION XYZ"))
    interval = one("INTERVAL")[:10].strip()
    return RinexObservationHeader(
        version=version,
        marker_name=one("MARKER NAME").strip(),
        receiver_type=one("REC # / TYPE / VERS")[20:40].strip(),
        antenna_serial=one("ANT # / TYPE")[:20].strip(),
        antenna_type=one("ANT # / TYPE")[20:40].rstrip(),
        approximate_position_ecef_m=position if position and any(position) else None,
        antenna_delta_hen_m=_triple(one("ANTENNA: DELTA H/E/N")) or (0.0, 0.0, 0.0),
        interval_s=float(interval) if interval else None,
        time_scale=scale,
        t_first_gps_ns=t_first,
        t_last_gps_ns=t_last,
        glonass_channels=_glonass_channels(by_label.get("GLONASS SLOT / FRQ #", [])),
        phase_shifts_cycles=_phase_shifts(by_label.get("SYS / PHASE SHIFT", [])),
        observation_types=_observation_types(by_label.get("SYS / # / OBS TYPES", [])),
        observation_types_v2=tuple(
            code for text in by_label.get("# / TYPES OF OBSERV", []) for code in text[6:60].split()
        ),
        scale_factors=_scale_factors(by_label.get("SYS / SCALE FACTOR", [])),
    )


def _triple(text: str) -> tuple[float, float, float] | None:
    if not text.strip():
        return None
    return float(text[:14]), float(text[14:28]), float(text[28:42])


def _time(text: str, scale: str = "") -> tuple[str, int | None]:
    if not text.strip():
        return scale or "GPS", None
    scale = text[48:51].strip() or scale or "GPS"
    year, month, day, hour, minute = (int(text[i : i + 6]) for i in range(0, 30, 6))
    return scale, gps_ns_of_calendar(scale, year, month, day, hour, minute, fractional_second_ns(text[30:43]))


def _observation_types(texts: list[str]) -> dict[System, tuple[str, ...]]:
    types: dict[System, tuple[str, ...]] = {}
    system: System | None = None
    for text in texts:
        if text[0] != " ":
            system = system_of_letter(text[0])
        if system is not None:
            types[system] = types.get(system, ()) + tuple(text[7:60].split())
    return types


def _glonass_channels(texts: list[str]) -> dict[int, int]:
    channels: dict[int, int] = {}
    for text in texts:
        for start in range(4, 60, 7):
            name, channel = text[start : start + 3], text[start + 3 : start + 6].strip()
            if name.strip() and channel:
                channels[satellite_of_name(name)] = int(channel)
    return channels


def _phase_shifts(texts: list[str]) -> dict[tuple[str, str], float]:
    shifts = {}
    for text in texts:
        if text[2:5].strip():
            shifts[text[0], text[3:5]] = float(text[6:14].strip() or 0.0)
    return shifts


def _scale_factors(texts: list[str]) -> dict[tuple[System, str], float]:
    factors: dict[tuple[System, str], float] = {}
    system, factor = System.GPS, 1.0
    for text in texts:
        if text[0] != " ":
            system, factor = system_of_letter(text[0]), float(text[2:6])
        for code in text[10:58].split():
            factors[system, code] = factor
    return factors
