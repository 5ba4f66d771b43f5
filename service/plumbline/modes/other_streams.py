"""What a station takes from streams of their own: a platform's further antennas, its IMU.

The shared books keep the last minute of them; here they become inputs in the order of their receive times.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from plumbline.config import StationSettings
from plumbline.epochs.stream import Books
from plumbline.records import Epoch, InertialBlock


@dataclass(frozen=True, slots=True)
class Arrival:
    """An epoch of an antenna, or a block of samples."""

    t_receive_ns: int
    antenna: int  # its number on the platform; of samples: after all antennas
    what: Epoch | InertialBlock


class OtherStreams:
    """The streams that a station's settings name."""

    def __init__(self, settings: StationSettings, books: Books) -> None:
        self._books = books
        self._antennas = {name: settings.n_own_antennas + k for k, name in enumerate(settings.antenna_streams)}
        self._inertial = settings.inertial_stream
        self._n_antennas = settings.n_antennas

    def until(self, t_receive_ns: int, pulled: dict[str, int]) -> Iterator[Arrival]:
        """Inputs received up to a time and after those that ``pulled`` (changed here) says; at first from now on."""
        arrivals = [a for name in self._antennas for a in self._new(name, t_receive_ns, pulled)]
        if self._inertial is not None:
            arrivals += self._new(self._inertial, t_receive_ns, pulled)
        return iter(sorted(arrivals, key=lambda arrival: (arrival.t_receive_ns, arrival.antenna)))

    def _new(self, name: str, until_ns: int, pulled: dict[str, int]) -> list[Arrival]:
        since_ns = pulled.setdefault(name, until_ns)
        pulled[name] = max(since_ns, until_ns)
        book = self._books.bases.get(name)
        antenna = self._antennas.get(name)
        found: list[Arrival] = []
        if antenna is not None and book is not None:
            found += [Arrival(e.t_receive_ns, antenna, e) for e in book.received_after(since_ns, until_ns)]
        if name == self._inertial:
            blocks = self._books.inertial.get(name, [])
            recent = (b for b in blocks if since_ns < b.t_receive_ns <= until_ns)
            found += [Arrival(b.t_receive_ns, self._n_antennas, b) for b in recent]
        return found
