"""Series as dictionaries of NumPy arrays."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Columns = dict[str, NDArray[Any]]

_TEXTS = ("status", "reason", "systems")
_LEFT_OUT = ("station", "extras", "time", "n_satellites", *_TEXTS)


def times(texts: Iterable[str]) -> NDArray[np.datetime64]:
    """ISO 8601 UTC as ``datetime64[ns]``."""
    return np.array([text.removesuffix("Z") for text in texts], dtype="datetime64[ns]")


def numbers(values: Iterable[float | None]) -> NDArray[np.float64]:
    """Numbers with NaN for null."""
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)


def motion_columns(body: Mapping[str, Any]) -> Columns:
    """A motion answer's columns."""
    columns: Columns = {"time": times(body["time"]), "count": np.array(body["count"], dtype=np.int64)}
    named = {name: values for name, values in body.items() if isinstance(values, list)}
    return columns | {name: numbers(named[name]) for name in named if name not in ("time", "count", "blocks")}


def solution_columns(items: list[dict[str, Any]]) -> Columns:
    """Solutions, one array a field; status, reason and systems as text."""
    columns: Columns = {"time": times(item["time"] for item in items)}
    columns |= {name: np.array([item[name] for item in items], dtype=np.str_) for name in _TEXTS}
    columns["n_satellites"] = np.array([item["n_satellites"] for item in items], dtype=np.int64)
    names = [name for name in items[0] if name not in _LEFT_OUT] if items else []
    return columns | {name: numbers(item[name] for item in items) for name in names}
