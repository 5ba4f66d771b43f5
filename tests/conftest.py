"""Fixtures shared by all tests."""

import os
from pathlib import Path

for _name in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # as workers run: sums over several threads differ in their last bits

import pytest  # noqa: E402

REPOSITORY = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of recordings; a test that needs it is skipped, with the missing path, where it is absent."""
    path = Path(os.environ.get("PLUMBLINE_DATA", REPOSITORY.parent / "shared" / "data"))
    if not path.is_dir():
        pytest.skip(f"no recordings at {path}")
    return path
