"""The application over a fresh SQLite store, with a control that notes what it is told."""

from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import FastAPI

from plumbline.api import Feed, create_app
from plumbline.config import ServerSettings, StationSettings
from plumbline.records import Threshold
from plumbline.store import Device, Store


@dataclass
class NotingControl:
    """Remembers what the API said."""

    told: list[tuple[str, str, Any]] = field(default_factory=list)
    unknown: list[Device] = field(default_factory=list)
    waiting: dict[str, str] = field(default_factory=dict)

    async def station_changed(self, station: str, settings: StationSettings | None) -> None:
        """Note it."""
        self.told.append(("station", station, settings))

    async def thresholds_changed(self, station: str, thresholds: Sequence[Threshold]) -> None:
        """Note it."""
        self.told.append(("thresholds", station, tuple(thresholds)))

    async def devices(self) -> Sequence[Device]:
        """What the test put there."""
        return self.unknown

    async def not_ready(self) -> Mapping[str, str]:
        """What the test put there."""
        return self.waiting


@pytest.fixture
async def store(tmp_path: Path) -> AsyncIterator[Store]:
    """An open store."""
    opened = await Store.open(f"sqlite:///{tmp_path / 'api.sqlite'}", readers=2)
    yield opened
    await opened.close()


@pytest.fixture
def control() -> NotingControl:
    """A control that notes."""
    return NotingControl()


@pytest.fixture
def feed() -> Feed:
    """A small feed."""
    return Feed(ring_capacity=100, queue_capacity=10)


@pytest.fixture
def app(store: Store, feed: Feed, control: NotingControl, tmp_path: Path) -> FastAPI:
    """The application without a dashboard."""
    return create_app(store, feed, control, ServerSettings(data_dir=tmp_path), dashboard=tmp_path / "none")


@pytest.fixture
async def client(app: FastAPI) -> AsyncIterator[httpx.AsyncClient]:
    """A client that talks to the application without a socket."""
    transport = httpx.ASGITransport(app=app, raise_app_exceptions=False)
    async with httpx.AsyncClient(transport=transport, base_url="http://plumbline") as opened:
        yield opened
