"""A base's stream into the books, and an eye on the base itself: its own precise position, once a second.

Two watches look at it. The :mod:`course <plumbline.quality.course>` shows a sudden displacement at once, to be compared
with what the rovers show; the CUSUM of :mod:`reference_watch <plumbline.quality.reference_watch>` finds a slow or small
one within hours and is told to every rover. Both see the same bytes in the same order on every worker, so that what the
books say as of a receive time is the same everywhere.
"""

from typing import Final

import numpy as np

from plumbline.config import PositioningSettings
from plumbline.epochs.reference_book import ReferenceBook, Shown
from plumbline.epochs.stream import Books, NavigationFeed
from plumbline.gps_time import NS_PER_S
from plumbline.positioning import ppp
from plumbline.positioning.broadcast_source import BroadcastSource
from plumbline.positioning.facts import StationFacts
from plumbline.positioning.state import PppState
from plumbline.quality.course import Course, extended
from plumbline.quality.doubt import TRUSTED
from plumbline.quality.reference_watch import Watch, watch
from plumbline.records import Epoch

_INTERVAL_NS: Final = NS_PER_S * 9 // 10
_SETTINGS: Final = PositioningSettings(converged_sigma_m=0.10)  # what it was a minute ago is known better than that
_SETTLED_M2: Final = 0.05**2  # trace of the covariance from which on the long watch learns


class ReferenceFeed(NavigationFeed):
    """A :class:`NavigationFeed` that also watches the base whose observations it carries, if it carries any."""

    def __init__(self, stream: str, books: Books) -> None:
        super().__init__(stream, books)
        self._position = PppState()
        self._course = Course()
        self._watch = Watch()
        self._t_watched_ns = 0

    def _keep(self, epochs: list[Epoch], t_receive_ns: int) -> None:
        super()._keep(epochs, t_receive_ns)
        for epoch in epochs:
            if not 0 <= epoch.t_gps_ns - self._t_watched_ns < _INTERVAL_NS:
                self._t_watched_ns = epoch.t_gps_ns
                self._look(epoch, t_receive_ns)

    def _look(self, epoch: Epoch, t_receive_ns: int) -> None:
        """Position the base, and note what that shows, known from a receive time on."""
        books = self._books
        source = BroadcastSource(books.ephemerides, books.corrections, _SETTINGS)
        facts = StationFacts(self.stream)
        self._position, solution = ppp.step(self._position, epoch, source, _SETTINGS, facts)
        if solution.status not in TRUSTED or solution.displacement_enu_m is None:
            return
        self._course = extended(self._course, solution.t_gps_ns, solution.displacement_enu_m, frozen=False)
        if solution.covariance_enu_m2 is not None and np.trace(solution.covariance_enu_m2) <= _SETTLED_M2:
            self._watch = watch(self._watch, solution)
        book = books.references.setdefault(self.stream, ReferenceBook())
        book.say(t_receive_ns, self._watch.moved)
        departure = self._course.departure_at(solution.t_gps_ns)
        if departure is not None:
            sigma = np.asarray(self._course.sigma_m)
            shown = Shown(solution.t_gps_ns, t_receive_ns, tuple(departure.tolist()), tuple(sigma.tolist()))
            book.add(shown)
