"""The table of `make bench`: one row a job, each a ratio measured in one run on the same bytes."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Row:
    """A job done by plumbline and by a peer; ``ratio`` is how many times better plumbline is."""

    job: str
    peer: str
    ours: float
    theirs: float
    unit: str
    ratio: float
