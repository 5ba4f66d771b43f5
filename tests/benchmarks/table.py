"""The row that every benchmark answers with, and the table that they make together."""

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Row:
    """One job measured here and on a peer, same input, same run; ``ratio`` > 1 means faster than the peer."""

    job: str
    peer: str
    ours: float
    theirs: float
    unit: str
    ratio: float
    target: float | None = None  # the least ratio asked for


def rate_row(job: str, peer: str, ours: float, theirs: float, unit: str, target: float | None = None) -> Row:
    """A row of rates: more is better."""
    return Row(job, peer, ours, theirs, unit, ours / theirs, target)


def time_row(job: str, peer: str, ours: float, theirs: float, unit: str, target: float | None = None) -> Row:
    """A row of durations: less is better."""
    return Row(job, peer, ours, theirs, unit, theirs / ours, target)


def format_rows(rows: Iterable[Row]) -> str:
    """The rows as a Markdown table."""
    lines = ["| job | peer | ours | theirs | unit | ratio | asked |", "|---|---|---|---|---|---|---|"]
    for row in rows:
        asked = "–" if row.target is None else f"≥ {row.target:g}"
        cells = (row.job, row.peer, f"{row.ours:,.4g}", f"{row.theirs:,.4g}", row.unit, f"{row.ratio:.3g}", asked)
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)
