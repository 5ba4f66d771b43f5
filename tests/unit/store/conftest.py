"""A store on SQLite in a temporary folder, and one on a private PostgreSQL cluster where the machine has the server."""

import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from uuid import uuid4

import pytest

from plumbline.store import Store


def _postgres_programs() -> Path | None:
    found = shutil.which("initdb")
    candidates = [Path(found).resolve().parent] if found else sorted(Path("/usr/lib/postgresql").glob("*/bin"))
    return candidates[-1] if candidates else None


def _unprivileged() -> list[str]:
    """PostgreSQL refuses to run as root: the command prefix that makes it somebody else."""
    return ["setpriv", "--reuid=postgres", "--regid=postgres", "--clear-groups"] if os.geteuid() == 0 else []


@pytest.fixture(scope="session")
def postgres_server() -> Iterator[str]:
    """The socket directory of a fresh PostgreSQL cluster that lives as long as the test session."""
    programs = _postgres_programs()
    if programs is None:
        pytest.skip("no PostgreSQL server programs (initdb, pg_ctl) on this machine")
    prefix = _unprivileged()
    if prefix and not shutil.which("setpriv"):
        pytest.skip("running as root, and no setpriv to start PostgreSQL as somebody else")
    home = Path(tempfile.mkdtemp(prefix="plumbline-pg-"))
    if prefix:
        account = pwd.getpwnam("postgres")
        os.chown(home, account.pw_uid, account.pw_gid)
    cluster = str(home / "cluster")
    run = [*prefix, str(programs / "initdb"), "-D", cluster, "-U", "plumbline", "-A", "trust", "-E", "UTF8", "-N"]
    subprocess.run(run, check=True, capture_output=True, cwd=home)
    options = f"-k {home} -c listen_addresses='' -c fsync=off -c max_connections=40"
    start = [*prefix, str(programs / "pg_ctl"), "-D", cluster, "-w", "-l", str(home / "log"), "-o", options, "start"]
    subprocess.run(start, check=True, capture_output=True, cwd=home)
    try:
        yield str(home)
    finally:
        stop = [*prefix, str(programs / "pg_ctl"), "-D", cluster, "-m", "immediate", "stop"]
        subprocess.run(stop, check=True, capture_output=True, cwd=home)
        shutil.rmtree(home)


@pytest.fixture
def postgres_url(postgres_server: str) -> str:
    """The URL of an empty database."""
    import psycopg

    name = f"test_{uuid4().hex}"
    with psycopg.connect(f"host={postgres_server} user=plumbline dbname=postgres", autocommit=True) as connection:
        connection.execute(f'CREATE DATABASE "{name}"')
    return f"postgresql://plumbline@/{name}?host={postgres_server}"


@pytest.fixture(params=["sqlite", "postgresql"])
def database_url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """The URL of an empty database of either kind."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'store.sqlite'}"
    return str(request.getfixturevalue("postgres_url"))


@pytest.fixture
async def store(database_url: str) -> AsyncIterator[Store]:
    """An open store on either database."""
    opened = await Store.open(database_url, readers=2, wait_s=5.0)
    try:
        yield opened
    finally:
        await opened.close()
