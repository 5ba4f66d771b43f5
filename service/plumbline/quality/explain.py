"""Why a station's last epochs have no solution or a poor one, in words that an engineer can act on.

Every finding names what was seen, how often, and what to do. The most frequent cause comes first; a station that is
well has none.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from plumbline.gps_time import NS_PER_S
from plumbline.quality.receiver_events import CONNECTIONS
from plumbline.records import QualityReport, Solution, StationStatus, Status, Verdict
from plumbline.signals import satellite_name

_OLD_CORRECTIONS_S: Final = 20.0
_LATE_S: Final = 3.0
_CN0_DROP_DB: Final = 6.0
_OFTEN: Final = 0.2  # share of epochs in which a satellite's observations were left out
_SECTOR_DEG: Final = 45
_SECTOR_SHARE: Final = 0.05
_FEW_IN_SECTOR: Final = 20
_SECTORS: Final = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")
_MANY_CONNECTIONS: Final = 5
_CLOCK_STEP_S: Final = 0.5e-3
_DOUBTFUL: Final = "doubtful: "  # as :mod:`plumbline.judgement` marks them
_FEW_SATELLITES: Final = 4
_REFLECTED: Final = 2.5  # times the usual scatter of code minus carrier
_REFLECTED_LEAST_M: Final = 0.3  # at the zenith
_POOR: Final = frozenset({Status.CONVERGING, Status.SINGLE_POINT})
_ADVICE: Final = {
    Status.NO_EPHEMERIS: "have the device send broadcast ephemerides (1019, 1020, 1042, 1046), or add a stream of them",
    Status.NO_CORRECTIONS: "check the correction stream: is it connected, and for the systems that are observed?",
    Status.TOO_FEW_SATELLITES: "look for what hides the sky, or lower the elevation mask, or enable more systems",
    Status.NO_OBSERVATIONS: "check that the device sends observations (MSM) of the systems wanted",
    Status.NO_BASE: "check the base station: its data, its position message, its latency",
    Status.REJECTED: "see which satellites contradict the others; look for reflectors near the antenna, for jamming",
    Status.SINGLE_POINT: "precise positions need corrections for the satellites observed",
    Status.CONVERGING: "wait: a position converges within half an hour of uninterrupted data",
    Status.DIVERGED: "the filter began anew; if it happens again, check the reference position",
}


@dataclass(frozen=True, slots=True)
class Finding:
    """One cause, and what can be done."""

    cause: str  # a word: "corrections", "silence", "interference" …
    text: str
    advice: str
    share: float  # of the epochs looked at


def explain(
    solutions: Sequence[Solution], reports: Sequence[QualityReport], status: StationStatus | None
) -> tuple[Finding, ...]:
    """Findings about a station's last epochs, the most frequent first; ``reports`` are of the same span."""
    found = [*_silence(status), *_waiting(solutions, status), *_power(status)]
    found += [*_statuses(solutions), *_doubts(solutions), *_ages(solutions), *_latencies(solutions), *_clock(solutions)]
    found += [*_satellites(reports), *_sectors(reports), *_reflections(reports), *_interference(reports)]
    found += [*_events(reports), *_counters(status)]
    return tuple(sorted(found, key=lambda finding: -finding.share))


def _silence(status: StationStatus | None) -> Iterable[Finding]:
    if status is None or status.state != "receiving":
        text = "nothing received yet" if status is None else f"{status.state}: {status.reason}"
        advice = "check the device's power, antenna and modem, and the server address that it is set to"
        yield Finding("silence", text, advice, 1.0)


def _waiting(solutions: Sequence[Solution], status: StationStatus | None) -> Iterable[Finding]:
    """Observations without any epoch: the status says what they wait for."""
    if not solutions and status is not None and status.state == "receiving" and status.reason:
        yield Finding("waiting", status.reason, _ADVICE[Status.NO_EPHEMERIS], 1.0)


def _power(status: StationStatus | None) -> Iterable[Finding]:
    """A device that calls again and again."""
    n = 0 if status is None else status.counters.get(CONNECTIONS, 0)
    if n >= _MANY_CONNECTIONS:
        text = f"the device has connected {n} times within an hour"
        advice = "a device that starts anew so often lacks power: check battery, solar panel and cable; else the modem"
        yield Finding("power", text, advice, 1.0)


def _doubts(solutions: Sequence[Solution]) -> Iterable[Finding]:
    """Displacements that a witness contradicts."""
    reasons = Counter(s.reason[s.reason.index(_DOUBTFUL) :] for s in solutions if _DOUBTFUL in s.reason)
    for reason, n in reasons.items():
        advice = "go and see the antenna and its mount; compare with the neighbours and the reference station"
        yield Finding("contradicted", f"{n} of {len(solutions)} epochs {reason}", advice, n / len(solutions))


def _clock(solutions: Sequence[Solution]) -> Iterable[Finding]:
    """Steps of the receiver's clock by whole milliseconds."""
    clocks = [s.receiver_clock_s for s in solutions if s.receiver_clock_s is not None]
    n = sum(abs(after - before) > _CLOCK_STEP_S for before, after in pairwise(clocks))
    if n:
        text = f"the receiver's clock jumped {n} times by a millisecond or more"
        advice = "usual for some receivers, and harmless: the ambiguities carry on; if often, have it steer its clock"
        yield Finding("clock", text, advice, n / len(solutions))


def _statuses(solutions: Sequence[Solution]) -> Iterable[Finding]:
    """Every (status, reason) that is not a good solution."""
    counts = Counter(
        (s.status, s.reason)
        for s in solutions
        if not s.status.has_position or s.status in _POOR or (s.reason and not s.reason.startswith(_DOUBTFUL))
    )
    for (state, reason), n in counts.items():
        text = f"{n} of {len(solutions)} epochs {state.value}" + (f": {reason}" if reason else "")
        yield Finding(state.value, text, _ADVICE.get(state, "see the reason"), n / len(solutions))


def _ages(solutions: Sequence[Solution]) -> Iterable[Finding]:
    old = [s.correction_age_s for s in solutions if (s.correction_age_s or 0.0) > _OLD_CORRECTIONS_S]
    if old:
        text = f"corrections up to {max(a for a in old if a is not None):.0f} s old in {len(old)} epochs"
        yield Finding("age", text, "check the correction stream's latency", len(old) / len(solutions))


def _latencies(solutions: Sequence[Solution]) -> Iterable[Finding]:
    late = [(s.t_receive_ns - s.t_gps_ns) / NS_PER_S for s in solutions]
    n = sum(_LATE_S < value < 3600.0 for value in late)  # later ones are replays
    if n:
        text = f"{n} epochs arrived more than {_LATE_S:.0f} s late, the middle one {np.median(late):.1f} s"
        yield Finding("latency", text, "check the modem's signal and the device's transmission interval", n / len(late))


def _satellites(reports: Sequence[QualityReport]) -> Iterable[Finding]:
    """Satellites left out often, and by which test."""
    counts: Counter[tuple[int, bool]] = Counter()
    for report in reports:
        for i in np.flatnonzero(report.verdict != Verdict.ACCEPTED):
            counts[int(report.satellite[i]), bool(report.is_phase[i])] += 1
    for (satellite, phase), n in counts.items():
        if n / len(reports) >= _OFTEN:
            kind = "phase" if phase else "code"
            text = (
                f"the {kind} of {satellite_name(satellite)} was left out in {n} of {len(reports)} epochs by the w-test"
            )
            yield Finding(
                "satellite", text, "one satellite alone: nothing to do; it may be unhealthy", n / len(reports)
            )


def _sectors(reports: Sequence[QualityReport]) -> Iterable[Finding]:
    """Codes that stray in one direction of the sky: reflections."""
    total, bad = np.zeros(len(_SECTORS)), np.zeros(len(_SECTORS))
    for report in reports:
        sector = (np.round(np.degrees(report.azimuth_rad) / _SECTOR_DEG) % len(_SECTORS)).astype(int)
        codes = ~report.is_phase
        np.add.at(total, sector[codes], 1.0)
        np.add.at(bad, sector[codes & (report.verdict != Verdict.ACCEPTED)], 1.0)
    for k in np.flatnonzero((bad > _SECTOR_SHARE * total) & (total >= _FEW_IN_SECTOR)):
        text = f"{bad[k]:.0f} of {total[k]:.0f} codes from the {_SECTORS[k]} stray: multipath"
        yield Finding(
            "multipath", text, f"look for walls, cables or water {_SECTORS[k]} of the antenna", bad[k] / total[k]
        )


def _reflections(reports: Sequence[QualityReport]) -> Iterable[Finding]:
    """Code minus carrier of each satellite about its own mean, by where in the sky it is.

    The difference of the innovations of a satellite's code and phase is free of geometry, clock and troposphere; what
    is left beside the constant ambiguity is the code's noise and multipath, which grow towards the horizon as the
    sine of the elevation falls.
    """
    by_satellite: dict[int, list[tuple[float, float, float]]] = {}
    for report in reports:
        phase = {int(report.satellite[i]): report.residual_m[i] for i in np.flatnonzero(report.is_phase)}
        for i in np.flatnonzero(~report.is_phase):
            satellite = int(report.satellite[i])
            if satellite in phase and np.isfinite(report.residual_m[i] - phase[satellite]):
                sample = (
                    float(report.residual_m[i] - phase[satellite]),
                    float(report.azimuth_rad[i]),
                    float(report.elevation_rad[i]),
                )
                by_satellite.setdefault(satellite, []).append(sample)
    spread = {s: np.array(rows) for s, rows in by_satellite.items() if len(rows) >= _FEW_IN_SECTOR}
    sizes = {s: float(np.std(rows[:, 0]) * np.sin(rows[:, 2].mean())) for s, rows in spread.items()}
    usual = float(np.median(list(sizes.values()))) if len(sizes) >= _FEW_SATELLITES else np.inf
    for satellite, size in sizes.items():
        if size > _REFLECTED * usual and size > _REFLECTED_LEAST_M:
            azimuth, elevation = np.degrees(spread[satellite][:, 1:].mean(axis=0))
            where = _SECTORS[int(np.round(azimuth / _SECTOR_DEG)) % len(_SECTORS)]
            text = (
                f"code minus carrier of {satellite_name(satellite)}, {where} at {elevation:.0f}° elevation, scatters "
                f"{size / usual:.1f} times as much as the others': multipath"
            )
            advice = f"look for walls, cables or water {where} of the antenna"
            yield Finding("multipath", text, advice, 1.0 / len(sizes))


def _interference(reports: Sequence[QualityReport]) -> Iterable[Finding]:
    """Signals of all satellites weaker at once."""
    strengths = np.array([report.tests.get("cn0_db_hz", np.nan) for report in reports])
    if not np.isfinite(strengths).any():
        return
    low = strengths < np.nanpercentile(strengths, 90) - _CN0_DROP_DB
    if low.any():
        drop = np.nanpercentile(strengths, 90) - np.nanmin(strengths)
        text = f"the signals of all satellites were weaker by up to {drop:.0f} dB at once, in {low.sum()} epochs"
        advice = "interference, or the antenna's cable or power: look for transmitters, check the connectors"
        yield Finding("interference", text, advice, float(low.mean()))


def _events(reports: Sequence[QualityReport]) -> Iterable[Finding]:
    slips = [event for report in reports for event in report.events if event.startswith("cycle slip")]
    if len(slips) > max(2, len(reports) // 20):
        text = f"{len(slips)} cycle slips, the last one: {slips[-1]}"
        yield Finding("slips", text, "look for obstructions, vibration of the mount, or interference", 0.1)


def _counters(status: StationStatus | None) -> Iterable[Finding]:
    """What the decoder refused: a disturbed line."""
    counters: Mapping[str, int] = {} if status is None else status.counters
    bad = sum(n for name, n in counters.items() if "crc" in name)
    if bad:
        yield Finding(
            "line", f"{bad} frames damaged on the way", "check the serial line and the modem's settings", 0.05
        )
