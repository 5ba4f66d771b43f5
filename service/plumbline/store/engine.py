"""Connections: the database's URL, SQLite's pragmas, one writing and one reading engine, and the upgrade at opening."""

import sqlite3
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

from alembic import command
from alembic.config import Config
from sqlalchemy import Connection, Engine, create_engine, event, make_url, text
from sqlalchemy.exc import DBAPIError, OperationalError
from sqlalchemy.pool import QueuePool

from plumbline.errors import StoreError

P = ParamSpec("P")
R = TypeVar("R")

BUSY_TIMEOUT_MS = 5_000
_UPGRADE_LOCK = 0x706C756D62  # "plumb": an arbitrary number that every plumbline process locks alike
_TRANSIENT_SQLITE = (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED)


@dataclass(frozen=True, slots=True)
class Engines:
    """One engine with a single connection that writes, one that only reads, and how long to wait for the database."""

    writer: Engine
    reader: Engine
    wait_s: float

    def dispose(self) -> None:
        """Close all connections."""
        self.reader.dispose()
        self.writer.dispose()


def open_engines(url: str, readers: int, wait_s: float) -> Engines:
    """Connect, and bring the tables to the newest form; raises StoreError when that fails for ``wait_s``."""
    parsed = make_url(url)
    if parsed.get_backend_name() == "sqlite":
        if parsed.database:
            Path(parsed.database).parent.mkdir(parents=True, exist_ok=True)
        engines = Engines(_sqlite(url, 1, "BEGIN IMMEDIATE"), _sqlite(url, readers, "BEGIN"), wait_s)
    else:
        parsed = parsed.set(drivername="postgresql+psycopg")
        writer = create_engine(parsed, pool_size=1, max_overflow=0, pool_pre_ping=True)
        engines = Engines(writer, create_engine(parsed, pool_size=readers, max_overflow=0, pool_pre_ping=True), wait_s)
    try:
        run_with_retry(engines.writer, wait_s, upgrade)()
    except BaseException:
        engines.dispose()
        raise
    return engines


def _sqlite(url: str, size: int, begin: str) -> Engine:
    """An engine that begins its transactions itself: DDL is inside them, and a writer never upgrades a read lock."""
    engine = create_engine(
        url, poolclass=QueuePool, pool_size=size, max_overflow=0, connect_args={"check_same_thread": False}
    )

    def prepare(connection: Any, _record: object) -> None:
        connection.isolation_level = None
        for pragma in (
            f"busy_timeout = {BUSY_TIMEOUT_MS}",
            "page_size = 8192",  # several summary rows a page; only a new file takes it
            "journal_mode = WAL",
            "synchronous = NORMAL",  # a power cut may undo the last commits; the archive replays them
            "temp_store = MEMORY",
            "cache_size = -65536",
        ):
            connection.execute(f"PRAGMA {pragma}")

    event.listen(engine, "connect", prepare)
    event.listen(engine, "begin", lambda connection: connection.exec_driver_sql(begin))
    return engine


def upgrade(connection: Connection) -> None:
    """Run the migrations that a database has not had, in the connection's transaction; one process at a time."""
    if connection.dialect.name == "postgresql":
        connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": _UPGRADE_LOCK})
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).with_name("migrations")))
    config.attributes["connection"] = connection
    command.upgrade(config, "head")


def run_with_retry(
    engine: Engine, wait_s: float, work: Callable[Concatenate[Connection, P], R], *args: P.args, **keywords: P.kwargs
) -> Callable[[], R]:
    """``work`` in one transaction, tried again while the database is locked or away; then StoreError."""
    return partial(_run, engine, wait_s, lambda connection: work(connection, *args, **keywords))


def _run(engine: Engine, wait_s: float, work: Callable[[Connection], R]) -> R:
    give_up = time.monotonic() + wait_s
    pause_s = 0.05
    while True:
        try:
            with engine.begin() as connection:
                return work(connection)
        except DBAPIError as error:
            if not _is_transient(error):
                raise StoreError(f"the database refused: {error.orig}") from error
            if time.monotonic() + pause_s > give_up:
                raise StoreError(f"the database is away since {wait_s:.0f} s: {error.orig}") from error
            time.sleep(pause_s)
            pause_s = min(2 * pause_s, 2.0)


def _is_transient(error: DBAPIError) -> bool:
    """Whether waiting may help: SQLite is locked, or PostgreSQL is down, restarting or asks to repeat."""
    if isinstance(error.orig, sqlite3.Error):
        return (getattr(error.orig, "sqlite_errorcode", 0) & 0xFF) in _TRANSIENT_SQLITE
    return isinstance(error, OperationalError) or error.connection_invalidated
