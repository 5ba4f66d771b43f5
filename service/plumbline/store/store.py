"""The store's asynchronous face: every method is awaitable and runs on the writer thread or on one of a few readers."""

import asyncio
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Concatenate, ParamSpec, Self, TypeVar

from sqlalchemy import Connection, text

from plumbline.config import ServerSettings, StationSettings
from plumbline.quality.availability import Availability
from plumbline.records import AlertEvent, Motion, Output, QualityReport, Solution, StationStatus, Threshold
from plumbline.store import alert_log, availability_log, reading, registry, writing
from plumbline.store.engine import Engines, open_engines, run_with_retry
from plumbline.store.rows import AlertRow, Checkpoint, Device, MotionSeries, Page, StationRow

P = ParamSpec("P")
R = TypeVar("R")


def database_url(settings: ServerSettings) -> str:
    """The URL of the settings' database; without one, SQLite in the data directory."""
    return settings.database_url or f"sqlite:///{settings.data_dir / 'plumbline.sqlite'}"


class Store:
    """The database. Open it with :meth:`open`, close it with :meth:`close`; safe to use from one event loop.

    Every method raises :class:`plumbline.errors.StoreError` when the database cannot be reached for longer than the
    store is willing to wait; nothing of a failed write is stored.
    """

    def __init__(self, engines: Engines, readers: int) -> None:
        self._engines = engines
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="store-writer")
        self._readers = ThreadPoolExecutor(readers, thread_name_prefix="store-reader")

    @classmethod
    async def open(cls, url: str, readers: int = 4, wait_s: float = 60.0) -> Self:
        """Connect to a database and upgrade its tables; a busy or absent database is waited for up to ``wait_s``."""
        engines = await asyncio.to_thread(open_engines, url, readers, wait_s)
        return cls(engines, readers)

    async def close(self) -> None:
        """Finish what was asked for, then let go of every connection."""
        for pool in (self._writer, self._readers):
            await asyncio.to_thread(pool.shutdown)
        await asyncio.to_thread(self._engines.dispose)

    async def _write(self, work: Callable[Concatenate[Connection, P], R], *args: P.args, **keywords: P.kwargs) -> R:
        call = run_with_retry(self._engines.writer, self._engines.wait_s, work, *args, **keywords)
        return await asyncio.get_running_loop().run_in_executor(self._writer, call)

    async def _read(self, work: Callable[Concatenate[Connection, P], R], *args: P.args, **keywords: P.kwargs) -> R:
        call = run_with_retry(self._engines.reader, self._engines.wait_s, work, *args, **keywords)
        return await asyncio.get_running_loop().run_in_executor(self._readers, call)

    async def ping(self) -> None:
        """One trivial query on a reader."""
        await self._read(lambda connection: connection.execute(text("SELECT 1")).scalar_one())

    # ------------------------------------------------------------------------------------------- results and state

    async def write(self, batch: Sequence[Output], checkpoints: Sequence[Checkpoint] = ()) -> int:
        """Store a batch in one transaction; returns its rows. Writing the same batch twice changes nothing."""
        return await self._write(writing.write, batch, checkpoints)

    async def checkpoint(self, station: str) -> Checkpoint | None:
        """A station's last checkpoint."""
        return await self._read(registry.checkpoint, station)

    async def solutions(
        self,
        station: str,
        start_gps_ns: int | None = None,
        end_gps_ns: int | None = None,
        limit: int = 1000,
        cursor: str | None = None,
    ) -> Page[Solution]:
        """Solutions with start ≤ t < end in order of time; raises ``ValueError`` for a cursor it has not given."""
        return await self._read(reading.solutions, station, start_gps_ns, end_gps_ns, limit, cursor)

    async def latest_solution(self, station: str) -> Solution | None:
        """The newest solution row of a station, whatever its status."""
        return await self._read(reading.latest_solution, station)

    async def motion(
        self,
        station: str,
        start_gps_ns: int | None = None,
        end_gps_ns: int | None = None,
        max_points: int = 2000,
        bucket_ns: int | None = None,
    ) -> MotionSeries:
        """Motion with start ≤ t < end, at most ``max_points`` points.

        ``bucket_ns`` None: samples where they fit, else the finest buckets that do, over the whole span. 0: samples;
        a multiple of 1 s, 1 min, 1 h or 1 day: buckets; both from the start on, ``next_start_gps_ns`` says where to
        read on.
        """
        return await self._read(reading.motion, station, start_gps_ns, end_gps_ns, max_points, bucket_ns)

    async def quality(
        self,
        station: str,
        start_gps_ns: int | None = None,
        end_gps_ns: int | None = None,
        limit: int = 1000,
        cursor: str | None = None,
    ) -> Page[QualityReport]:
        """Quality reports with start ≤ t < end, in order of time; raises ``ValueError`` for a cursor of none."""
        return await self._read(reading.quality, station, start_gps_ns, end_gps_ns, limit, cursor)

    async def latest(self, station: str, limit: int) -> tuple[tuple[Solution, ...], tuple[QualityReport, ...]]:
        """The newest solutions and quality reports, in order of time."""
        solutions = await self._read(reading.latest_solutions, station, limit)
        return solutions, await self._read(reading.latest_quality, station, limit)

    async def motion_blocks(
        self, station: str, start_gps_ns: int | None = None, end_gps_ns: int | None = None, limit: int = 3600
    ) -> tuple[Motion, ...]:
        """Stored motion blocks with start ≤ first sample < end, in order of time."""
        return await self._read(reading.motion_blocks, station, start_gps_ns, end_gps_ns, limit)

    async def status(self, station: str) -> StationStatus | None:
        """The newest status of a station."""
        return (await self._read(registry.statuses, (station,))).get(station)

    async def statuses(self, stations: Sequence[str] | None = None) -> dict[str, StationStatus]:
        """The newest status of stations (None: of all) that have one."""
        return await self._read(registry.statuses, stations)

    # ------------------------------------------------------------------------------------------- stations

    async def stations(self) -> tuple[StationRow, ...]:
        """Every station, by id."""
        return (await self._read(registry.stations, None, None)).items

    async def stations_page(self, limit: int, cursor: str | None = None) -> Page[StationRow]:
        """Stations by id, ``limit`` at a time."""
        return await self._read(registry.stations, limit, cursor)

    async def station(self, station: str) -> StationRow | None:
        """One station."""
        return await self._read(registry.station, station)

    async def create_station(self, settings: StationSettings) -> StationRow | None:
        """Add a station, or None where the id is taken. A checkpoint left by an earlier one of that id is dropped."""
        return await self._write(registry.create_station, settings)

    async def change_station(self, settings: StationSettings, expected_version: int | None = None) -> StationRow | None:
        """Replace a station's settings; None where there is none or where it is not at ``expected_version``."""
        return await self._write(registry.change_station, settings, expected_version)

    async def delete_station(self, station: str, purge: bool = False) -> bool:
        """Remove a station, its thresholds, status and checkpoint (``purge``: and results); False: there is none."""
        return await self._write(registry.delete_station, station, purge)

    async def seed(self, stations: Sequence[StationSettings], thresholds: Sequence[Threshold] = ()) -> None:
        """Add the stations and thresholds that are not there yet; those that are keep their settings."""
        await self._write(registry.seed, stations, thresholds)

    # ------------------------------------------------------------------------------------------- thresholds

    async def thresholds(self, station: str | None = None) -> tuple[Threshold, ...]:
        """Thresholds of a station (None: of all), by id."""
        return await self._read(registry.thresholds, station)

    async def threshold(self, threshold_id: str) -> Threshold | None:
        """One threshold."""
        return await self._read(registry.threshold, threshold_id)

    async def create_threshold(self, threshold: Threshold) -> bool:
        """Add a threshold; False where the id is taken."""
        return await self._write(registry.create_threshold, threshold)

    async def change_threshold(self, threshold: Threshold) -> bool:
        """Replace a threshold; False where there is none of that id."""
        return await self._write(registry.change_threshold, threshold)

    async def delete_threshold(self, threshold_id: str) -> bool:
        """Remove a threshold; False where there is none."""
        return await self._write(registry.delete_threshold, threshold_id)

    # ------------------------------------------------------------------------------------------- alerts

    async def alerts(
        self,
        station: str | None = None,
        state: str | None = None,
        start_gps_ns: int | None = None,
        end_gps_ns: int | None = None,
        limit: int = 100,
        cursor: str | None = None,
    ) -> Page[AlertRow]:
        """Alerts, newest activation first, without their histories; ``state`` is an :class:`AlertState` value."""
        return await self._read(alert_log.alerts, station, state, start_gps_ns, end_gps_ns, limit, cursor)

    async def alert(self, alert_id: str) -> AlertRow | None:
        """One alert with its history."""
        return await self._read(alert_log.alert, alert_id)

    async def acknowledge(self, alert_id: str, by: str = "", text: str = "") -> AlertRow | None:
        """Acknowledge an alert (again: nothing changes); None where there is none."""
        return await self._write(alert_log.acknowledge, alert_id, by, text)

    async def comment(self, alert_id: str, by: str, text: str) -> AlertRow | None:
        """Add a comment to an alert; None where there is none."""
        return await self._write(alert_log.comment, alert_id, by, text)

    async def open_alert_events(self, station: str) -> tuple[AlertEvent, ...]:
        """The activation events of a station's alerts that are not cleared."""
        return await self._read(alert_log.open_events, station)

    # ------------------------------------------------------------------------------------------- availability

    async def note_alive(self, t_start_gps_ns: int, t_now_gps_ns: int) -> None:
        """The server that began at a time is up at another."""
        await self._write(availability_log.note_alive, t_start_gps_ns, t_now_gps_ns)

    async def downtimes(self) -> tuple[tuple[int, int], ...]:
        """(from, to) when no server wrote into this database, in order."""
        return await self._read(availability_log.downtimes)

    async def epoch_marks(
        self, station: str, start_gps_ns: int, end_gps_ns: int
    ) -> tuple[availability_log.EpochMark, ...]:
        """Solutions with start ≤ t < end, as far as counting goes, in order of time."""
        return await self._read(availability_log.marks, station, start_gps_ns, end_gps_ns)

    async def first_epoch(self, station: str) -> int | None:
        """The time of a station's first solution."""
        return await self._read(availability_log.first_epoch, station)

    async def save_day(self, station: str, day: Availability) -> None:
        """Keep what a station delivered in a day that is over."""
        await self._write(availability_log.save_day, station, day)

    async def days(self, station: str, start_gps_ns: int, end_gps_ns: int) -> dict[int, Availability]:
        """Kept days that begin in a span, by their beginning."""
        return await self._read(availability_log.days, station, start_gps_ns, end_gps_ns)

    async def last_day(self, station: str) -> int | None:
        """The beginning of the last day that is kept of a station."""
        return await self._read(availability_log.last_day, station)

    # ------------------------------------------------------------------------------------------- devices

    async def devices(self) -> tuple[Device, ...]:
        """Unknown and adopted devices, the newest first."""
        return await self._read(registry.devices)

    async def save_devices(self, devices: Sequence[Device]) -> None:
        """Remember devices that were refused; the station of an adopted one is kept."""
        await self._write(registry.save_devices, devices)

    async def adopt_device(self, device: Device, station: str) -> Device:
        """Note that a device is now a station's."""
        return await self._write(registry.adopt_device, device, station)
