"""What the API asks of the rest of the server when something is changed through it."""

from collections.abc import Mapping, Sequence
from typing import Protocol

from plumbline.config import StationSettings
from plumbline.records import Threshold
from plumbline.store import Device


class Control(Protocol):
    """Called by the API after the store has the change; an exception here becomes a 500."""

    async def station_changed(self, station: str, settings: StationSettings | None) -> None:
        """A station was created or its settings replaced; None: it was deleted."""

    async def thresholds_changed(self, station: str, thresholds: Sequence[Threshold]) -> None:
        """All thresholds of a station, after one was created, changed or deleted."""

    async def devices(self) -> Sequence[Device]:
        """Unknown devices trying to talk to this server now, whether or not the store knows them."""

    async def not_ready(self) -> Mapping[str, str]:
        """Parts of the server that are not ready, each with its reason; empty when all are."""


class NoControl:
    """A control of a server without other parts: nothing to tell, always ready."""

    async def station_changed(self, station: str, settings: StationSettings | None) -> None:
        """Nothing to do."""

    async def thresholds_changed(self, station: str, thresholds: Sequence[Threshold]) -> None:
        """Nothing to do."""

    async def devices(self) -> Sequence[Device]:
        """None."""
        return ()

    async def not_ready(self) -> Mapping[str, str]:
        """Always ready."""
        return {}
