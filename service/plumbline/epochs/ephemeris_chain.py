"""Two ephemeris books as one: a station's own stream first, then the streams that it shares with others."""

from dataclasses import dataclass
from typing import Protocol

from plumbline.epochs.ephemeris_book import Choice, Entry, Match
from plumbline.records import UNKNOWN_CHANNEL


class EphemerisLookup(Protocol):
    """What is asked of ephemerides: see :class:`~plumbline.epochs.ephemeris_book.EphemerisBook`."""

    def satellites(self) -> list[int]:
        """Satellite ids with any set, ascending."""
        ...

    def select(
        self,
        satellite: int,
        t_gps_ns: int,
        as_of_receive_ns: int,
        *,
        issue: int | None = None,
        issue_rule: str = "issue",
        message: str | None = None,
    ) -> Choice:
        """The set for a satellite at a time, from what had been received by ``as_of_receive_ns``."""
        ...

    def newest(self, satellite: int, as_of_receive_ns: int) -> Entry | None:
        """The set received last."""
        ...

    def glonass_channel(self, satellite: int, as_of_receive_ns: int) -> int:
        """Frequency channel of a GLONASS satellite, ``UNKNOWN_CHANNEL`` where not known."""
        ...


@dataclass(frozen=True, slots=True)
class EphemerisChain:
    """The first book's answer where it has one, else the second's."""

    first: EphemerisLookup
    second: EphemerisLookup

    def satellites(self) -> list[int]:
        """Satellite ids with any set in either book, ascending."""
        return sorted({*self.first.satellites(), *self.second.satellites()})

    def select(
        self,
        satellite: int,
        t_gps_ns: int,
        as_of_receive_ns: int,
        *,
        issue: int | None = None,
        issue_rule: str = "issue",
        message: str | None = None,
    ) -> Choice:
        """See :class:`EphemerisLookup`; of two refusals, the first book's, unless it holds nothing at all."""
        ours = self.first.select(
            satellite, t_gps_ns, as_of_receive_ns, issue=issue, issue_rule=issue_rule, message=message
        )
        if ours.match is Match.USABLE:
            return ours
        theirs = self.second.select(
            satellite, t_gps_ns, as_of_receive_ns, issue=issue, issue_rule=issue_rule, message=message
        )
        return theirs if theirs.match is Match.USABLE or ours.match is Match.NO_EPHEMERIS else ours

    def newest(self, satellite: int, as_of_receive_ns: int) -> Entry | None:
        """The set received last by either."""
        entries = [book.newest(satellite, as_of_receive_ns) for book in (self.first, self.second)]
        return max((e for e in entries if e), key=lambda entry: entry.first_receive_ns, default=None)

    def glonass_channel(self, satellite: int, as_of_receive_ns: int) -> int:
        """See :class:`EphemerisLookup`."""
        channel = self.first.glonass_channel(satellite, as_of_receive_ns)
        return channel if channel != UNKNOWN_CHANNEL else self.second.glonass_channel(satellite, as_of_receive_ns)
