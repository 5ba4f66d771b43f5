"""Whose station is it? Rendezvous hashing: all who know the same workers know the same answer, without a word."""

import hashlib
from collections.abc import Iterable


def owner(key: str, workers: Iterable[str]) -> str | None:
    """The worker of highest weight for a key (Thaler and Ravishankar 1998); None when there is no worker.

    When a worker goes, only its own keys move; when one comes, it takes only what becomes its own.
    """
    return max(workers, key=lambda worker: (_weight(key, worker), worker), default=None)


def _weight(key: str, worker: str) -> bytes:
    return hashlib.blake2b(f"{worker}\0{key}".encode(), digest_size=8).digest()
