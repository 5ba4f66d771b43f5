"""Which form a series is asked for in, and its bytes: JSON, CSV, MiniSEED."""

import asyncio
import csv
import io
import json
from collections.abc import AsyncIterator, Iterable, Mapping
from enum import StrEnum
from itertools import pairwise
from typing import Any, Final
from urllib.parse import urlencode

import numpy as np
from fastapi import HTTPException, Request, Response
from fastapi.responses import StreamingResponse

from plumbline.gps_time import NS_PER_S, unix_ns_from_gps
from plumbline.store import MotionSeries


class Format(StrEnum):
    """How a series can be written."""

    JSON = "json"
    CSV = "csv"
    MINISEED = "mseed"


MEDIA_TYPES: Final = {
    Format.JSON: "application/json",
    Format.CSV: "text/csv; charset=utf-8; header=present",
    Format.MINISEED: "application/vnd.fdsn.mseed",
}
PIECE_BYTES: Final = 262_144
_ACCEPTED: Final = {
    "application/json": Format.JSON,
    "application/*": Format.JSON,
    "*/*": Format.JSON,
    "text/csv": Format.CSV,
    "text/*": Format.CSV,
    "application/vnd.fdsn.mseed": Format.MINISEED,
}
#: SEED's band and instrument letters want a rate; these names keep to its orientation letters E, N, Z.
_SEED_CHANNELS: Final = (("L", "Y"), ("L", "V"), ("L", "N"))


def responses(description: str, *more: Format) -> dict[int | str, dict[str, Any]]:
    """The OpenAPI note that a route answers in these forms besides JSON."""
    content = {MEDIA_TYPES[f].split(";")[0]: {"schema": {"type": "string"}} for f in more}
    return {200: {"description": description, "content": content}}


def choose(request: Request, asked: Format | None, *offered: Format) -> Format:
    """The form to answer in: the ``format`` parameter, else the Accept header's best; 406 where none is on offer."""
    if asked is not None:
        if asked not in offered:
            raise HTTPException(422, f"query.format: this is given as {', '.join(offered)}")
        return asked
    header = request.headers.get("accept", "*/*")
    wishes = [_wish(part) for part in header.split(",")]
    for media_type, quality in sorted(wishes, key=lambda wish: -wish[1]):
        found = _ACCEPTED.get(media_type)
        if quality > 0 and found in offered:
            return found
    raise HTTPException(406, f"this is given as {', '.join(MEDIA_TYPES[f].split(';')[0] for f in offered)}")


def _wish(part: str) -> tuple[str, float]:
    media_type, *parameters = part.strip().lower().split(";")
    for parameter in parameters:
        name, _, value = parameter.strip().partition("=")
        if name == "q":
            try:
                return media_type.strip(), float(value)
            except ValueError:
                return media_type.strip(), 0.0
    return media_type.strip(), 1.0


def response(form: Format, data: bytes, headers: Mapping[str, str]) -> Response:
    """A series' bytes, a long one piece by piece, so that compressing it does not hold up the live stream."""
    if not data:
        return Response(status_code=204)
    if len(data) <= PIECE_BYTES:
        return Response(data, 200, dict(headers), MEDIA_TYPES[form])

    async def pieces() -> AsyncIterator[bytes]:
        for begin in range(0, len(data), PIECE_BYTES):
            yield data[begin : begin + PIECE_BYTES]
            await asyncio.sleep(0)

    return StreamingResponse(pieces(), 200, dict(headers), MEDIA_TYPES[form])


def json_bytes(body: Mapping[str, Any]) -> bytes:
    """JSON straight from plain values."""
    return json.dumps(body, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()


def csv_bytes(names: Iterable[str], rows: Iterable[Iterable[Any]]) -> bytes:
    """CSV (RFC 4180) with a header line; what is missing is an empty field."""
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(names)
    writer.writerows(rows)
    return text.getvalue().encode()


def link_to_next(request: Request, **changes: str | None) -> dict[str, str]:
    """The Link header (RFC 8288) to the part that follows; none at the end (a change to None)."""
    if any(value is None for value in changes.values()):
        return {}
    query = urlencode(dict(request.query_params) | changes)
    return {"Link": f'<{request.url.path}?{query}>; rel="next"'}


def miniseed_bytes(series: MotionSeries) -> bytes:
    """Samples as MiniSEED in SI units: displacement (LY*), velocity (LV*), acceleration (LN*); a trace ends at a gap.

    SEED has five letters for a station: the id is cut. Times are UTC.
    """
    from obspy import Stream, Trace, UTCDateTime

    stream = Stream()
    vectors = (series.displacement_enu_m, series.velocity_enu_m_s, series.acceleration_enu_m_s2)
    for begin, end, interval_ns in even_runs(series):
        start = UTCDateTime(ns=unix_ns_from_gps(int(series.t_gps_ns[begin])))
        for (band, instrument), vector in zip(_SEED_CHANNELS, vectors, strict=True):
            for i, orientation in enumerate("ENZ"):
                values = np.ascontiguousarray(vector[begin:end, i])
                if np.isnan(values).any():
                    continue
                header = {
                    "network": "XX",
                    "station": "".join(c for c in series.station.upper() if c.isalnum())[:5],
                    "channel": band + instrument + orientation,
                    "starttime": start,
                    "delta": interval_ns / NS_PER_S,
                }
                stream.append(Trace(values, header))
    if not len(stream):
        return b""
    data = io.BytesIO()
    stream.write(data, format="MSEED", encoding="FLOAT64")
    return data.getvalue()


def even_runs(series: MotionSeries) -> list[tuple[int, int, int]]:
    """(begin, end, interval in ns) of every run of evenly spaced samples."""
    t = series.t_gps_ns
    intervals = {block.t_first_gps_ns // NS_PER_S: block.interval_ns for block in series.blocks}
    expected = np.array([intervals[second] for second in (t // NS_PER_S).tolist()], dtype=np.int64)
    if not len(t):
        return []
    breaks = np.flatnonzero((np.diff(t) != expected[:-1]) | (np.diff(expected) != 0)) + 1
    edges = [0, *breaks.tolist(), len(t)]
    return [(begin, end, int(expected[begin])) for begin, end in pairwise(edges)]
