"""Opening, upgrading, waiting. Oracles: Alembic's comparison of tables and database; a second connection's lock."""

import asyncio
import sqlite3
import threading
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import Connection, inspect

from plumbline.config import ServerSettings, StationSettings
from plumbline.errors import StoreError
from plumbline.records import Solution, Status
from plumbline.store import Store
from plumbline.store import database_url as url_of
from plumbline.store.tables import metadata

SOLUTION = Solution("a", 10**18, 10**18, Status.NO_OBSERVATIONS, "nothing received")


def _shape(connection: Connection) -> list[object]:
    return list(compare_metadata(MigrationContext.configure(connection), metadata))


async def test_migrations_make_the_tables_of_the_code(store: Store) -> None:
    assert await store._read(_shape) == []
    names = await store._read(lambda connection: inspect(connection).get_table_names())
    assert set(names) == set(metadata.tables) | {"alembic_version"}


async def test_opening_again_keeps_everything(database_url: str) -> None:
    first = await Store.open(database_url)
    await first.create_station(StationSettings(station="a"))
    await first.write([SOLUTION])
    await first.close()
    again = await Store.open(database_url)
    assert len(await again.stations()) == 1
    assert (await again.solutions("a")).items == (SOLUTION,)
    await again.ping()
    await again.close()


async def test_many_processes_may_open_a_new_database_at_once(database_url: str) -> None:
    stores = await asyncio.gather(*(Store.open(database_url, readers=1) for _ in range(5)))
    await stores[3].create_station(StationSettings(station="a"))
    assert [len(await store.stations()) for store in stores] == [1] * 5
    for store in stores:
        await store.close()


async def test_a_locked_file_is_waited_for(tmp_path: Path) -> None:
    path = tmp_path / "dir" / "s.sqlite"
    store = await Store.open(f"sqlite:///{path}", wait_s=20.0)
    other = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    other.execute("BEGIN EXCLUSIVE")
    threading.Timer(0.5, lambda: other.execute("COMMIT")).start()
    await store.write([SOLUTION])
    assert len((await store.solutions("a")).items) == 1
    await store.close()
    other.close()


async def test_a_database_that_stays_away_is_a_store_error() -> None:
    with pytest.raises(StoreError, match="away"):
        await Store.open("postgresql://nobody@127.0.0.1:1/none", wait_s=0.2)


async def test_reading_goes_on_while_a_long_write_is_under_way(tmp_path: Path) -> None:
    path = tmp_path / "s.sqlite"
    store = await Store.open(f"sqlite:///{path}")
    await store.write([SOLUTION])
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    try:
        assert len((await asyncio.wait_for(store.solutions("a"), 2.0)).items) == 1
    finally:
        other.execute("COMMIT")
        other.close()
        await store.close()


def test_the_default_database_is_a_file_in_the_data_directory() -> None:
    assert url_of(ServerSettings(data_dir=Path("somewhere"))) == "sqlite:///somewhere/plumbline.sqlite"
    assert url_of(ServerSettings(database_url="postgresql://h/d")) == "postgresql://h/d"
