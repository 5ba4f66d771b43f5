"""Positions withheld from the loose filter, and how far off the series is without them."""

from collections.abc import Callable, Sequence

import numpy as np

from plumbline.errors import ConfigurationError
from plumbline.gnss.earth_frames import geodetic_from_ecef, rotation_enu_from_ecef
from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, Ints, Solution


def outages_of(text: str) -> tuple[tuple[float, float], ...]:
    """Spans ``START,LENGTH;…`` s; raises ConfigurationError for any other text."""
    try:
        spans = [tuple(float(number) for number in span.split(",")) for span in text.split(";") if span.strip()]
    except ValueError as error:
        raise ConfigurationError(f"--outages: {error}") from error
    if any(len(span) != 2 or span[1] <= 0.0 for span in spans):
        raise ConfigurationError("--outages wants spans of seconds after the first position: START,LENGTH;…")
    return tuple((span[0], span[1]) for span in spans)


class Track:
    """Where a series has the antenna, around the positions withheld."""

    def __init__(self) -> None:
        self._times: list[Ints] = []
        self._positions: list[Floats] = []

    def add(self, t_gps_ns: Ints, positions_ecef_m: Floats) -> None:
        """Positions (n, 3) at times (n,), after those before."""
        self._times.append(t_gps_ns)
        self._positions.append(positions_ecef_m)

    def horizontal_error_m(self, solution: Solution) -> float | None:
        """Distance from a solution's position, level; None where the series has not got there."""
        times = np.concatenate(self._times) if self._times else np.zeros(0, np.int64)
        t_ns, position = solution.t_gps_ns, solution.position_ecef_m
        if position is None or not times.size or not times[0] <= t_ns <= times[-1]:
            return None
        since = (times - t_ns).astype(float)
        there = np.array([np.interp(0.0, since, axis) for axis in np.concatenate(self._positions).T])
        place = geodetic_from_ecef(np.asarray(position, float))
        error = rotation_enu_from_ecef(place[0], place[1]) @ (there - position)
        return float(np.hypot(error[0], error[1]))


class Outages:
    """Splits solutions into those to use and those to compare with, and compares."""

    def __init__(self, spans_s: Sequence[tuple[float, float]], solutions: Sequence[Solution]) -> None:
        first_ns = solutions[0].t_gps_ns if solutions else 0
        spans = [(first_ns + round(a * NS_PER_S), first_ns + round((a + n) * NS_PER_S)) for a, n in spans_s]
        self._withheld = [[s for s in solutions if begin <= s.t_gps_ns < end] for begin, end in spans]
        out = {s.t_gps_ns for group in self._withheld for s in group}
        self.kept = [s for s in solutions if s.t_gps_ns not in out]
        self._spans = spans
        self.tracks = {"filter alone": Track(), "smoothed": Track()}

    def add(self, name: str, t_gps_ns: Ints, positions_ecef_m: Callable[[], Floats]) -> None:
        """Positions (n, 3) of the antenna in a series at times (n,), asked for where an outage is near."""
        near = [a - NS_PER_S <= t_gps_ns[-1] and t_gps_ns[0] <= b + NS_PER_S for a, b in self._spans if t_gps_ns.size]
        if any(near):
            self.tracks[name].add(t_gps_ns, positions_ecef_m())

    def figures(self) -> list[str]:
        """Errors in words, at the last position withheld and at the worst, of each outage."""
        lines = [f"outages: {len(self._spans)}, horizontal errors, m"] if self._spans else []
        for name, track in self.tracks.items():
            errors = [[e for s in group if (e := track.horizontal_error_m(s)) is not None] for group in self._withheld]
            errors = [group for group in errors if group]
            if errors:
                lines.append(_line(f"{name}, at their end", [group[-1] for group in errors]))
                lines.append(_line(f"{name}, at their worst", [max(group) for group in errors]))
        return lines


def _line(words: str, errors: Sequence[float]) -> str:
    return f"  {words}: median {np.median(errors):.3f} (" + " ".join(f"{error:.2f}" for error in errors) + ")"
