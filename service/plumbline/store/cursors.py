"""Cursors of paged lists: the last key of a page, opaque to the reader."""

import base64
import json
from collections.abc import Sequence


def to_cursor(key: Sequence[str | int]) -> str:
    """A key as URL-safe text."""
    return base64.urlsafe_b64encode(json.dumps(list(key)).encode()).decode().rstrip("=")


def from_cursor(cursor: str, *kinds: type) -> list[str | int]:
    """The key of a cursor made of parts of these kinds; raises ``ValueError`` for text that is no such cursor."""
    try:
        raw = base64.b64decode(cursor.encode("ascii") + b"=" * (-len(cursor) % 4), altchars=b"-_", validate=True)
        key = json.loads(raw)
    except (ValueError, RecursionError) as error:
        raise ValueError("this is not a cursor of a list") from error
    fits = isinstance(key, list) and [type(part) for part in key] == list(kinds)
    if not fits or any(isinstance(part, int) and not -(2**63) <= part < 2**63 for part in key):
        raise ValueError("this is not a cursor of this list")
    if any(isinstance(part, str) and ("\x00" in part or not part.isprintable()) for part in key):
        raise ValueError("this is not a cursor of this list")
    return list(key)
