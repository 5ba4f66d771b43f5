"""What travels on the bus besides bare records, and its bytes.

A stream of results must arrive whole: every message of a worker about a station carries the worker's run and a count,
and a checkpoint is stored only if the messages since the last one stored were all seen.
"""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from plumbline.bus import codec
from plumbline.config import StationSettings
from plumbline.records import Chunk, Severity, Threshold

_CHUNK_HEAD = struct.Struct("<qq12s")
_RECORD_HEAD = struct.Struct("<qqI")
_REPLY_HEAD = struct.Struct("<qqq")
_NUMBER_HEAD = struct.Struct("<16sQ")


@dataclass(frozen=True, slots=True)
class Tick:
    """An ingest's clock: everything that it received up to ``t_receive_ns`` was published before this.

    A new ``generation`` says that something may not have been published: what is missing is in the archive.
    """

    archive: str
    generation: int
    t_receive_ns: int


@dataclass(frozen=True, slots=True)
class Numbered:
    """A worker's message about a station: ``number`` counts from 0 within ``run`` (16 hexadecimal digits)."""

    run: str
    number: int
    body: bytes


@dataclass(frozen=True, slots=True)
class CheckpointMessage:
    """A station's state after all inputs up to ``t_receive_ns``, and the offsets that it has consumed up to."""

    station: str
    t_receive_ns: int
    state: bytes
    consumed: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class StationConfig:
    """What a station is to be from ``changed_gps_ns`` on; ``settings`` None: it is deleted."""

    station: str
    settings: StationSettings | None
    thresholds: tuple[Threshold, ...] = ()
    created_gps_ns: int = 0
    changed_gps_ns: int = 0


@dataclass(frozen=True, slots=True)
class ArchiveReply:
    """Chunks of a stream, its present end, and the ingest's clock at that moment."""

    end: int
    generation: int
    t_now_ns: int
    chunks: tuple[Chunk, ...]


@dataclass(frozen=True, slots=True)
class Report:
    """What a process says of itself: counters and gauges, and, by the name of the part, why one does not work now."""

    role: str
    process: str
    counters: Mapping[str, int]
    failing: Mapping[str, str]


def encode_chunk(chunk: Chunk) -> bytes:
    """A chunk without its station, which is in the key."""
    return _CHUNK_HEAD.pack(chunk.offset, chunk.t_receive_ns, chunk.archive.encode("ascii")) + chunk.data


def decode_chunk(station: str, data: bytes) -> Chunk:
    """Inverse of :func:`encode_chunk`; raises ``ValueError`` when the bytes are too few."""
    if len(data) < _CHUNK_HEAD.size:
        raise ValueError("a chunk without its head")
    offset, t_receive_ns, archive = _CHUNK_HEAD.unpack_from(data)
    return Chunk(archive.rstrip(b"\\0").decode("ascii"), station, offset, t_receive_ns, data[_CHUNK_HEAD.size :])


def encode_numbered(message: Numbered) -> bytes:
    """Head and body."""
    return _NUMBER_HEAD.pack(message.run.encode("ascii"), message.number) + message.body


def decode_numbered(data: bytes) -> Numbered:
    """Inverse of :func:`encode_numbered`; raises ``ValueError`` when the bytes are too few."""
    if len(data) < _NUMBER_HEAD.size:
        raise ValueError("a numbered message without its head")
    run, number = _NUMBER_HEAD.unpack_from(data)
    return Numbered(run.decode("ascii"), number, data[_NUMBER_HEAD.size :])


def encode_archive_reply(reply: ArchiveReply) -> bytes:
    """Head of the reply, then each chunk's offset, receive time, length and bytes."""
    parts = [_REPLY_HEAD.pack(reply.end, reply.generation, reply.t_now_ns)]
    for chunk in reply.chunks:
        parts += (_RECORD_HEAD.pack(chunk.offset, chunk.t_receive_ns, len(chunk.data)), chunk.data)
    return b"".join(parts)


def decode_archive_reply(archive: str, station: str, data: bytes) -> ArchiveReply:
    """Inverse of :func:`encode_archive_reply`; raises ``ValueError`` when it is cut short."""
    try:
        end, generation, t_now_ns = _REPLY_HEAD.unpack_from(data)
        chunks, position = [], _REPLY_HEAD.size
        while position < len(data):
            offset, t_receive_ns, length = _RECORD_HEAD.unpack_from(data, position)
            position += _RECORD_HEAD.size
            chunks.append(Chunk(archive, station, offset, t_receive_ns, data[position : position + length]))
            position += length
    except struct.error as error:
        raise ValueError("an archive reply that is cut short") from error
    return ArchiveReply(end, generation, t_now_ns, tuple(chunks))


def encode_fields(message: Tick | CheckpointMessage | Report) -> bytes:
    """Any of the small messages, as the list of its fields."""
    return codec.encode([getattr(message, name) for name in message.__slots__])


def decode_tick(data: bytes) -> Tick:
    """Inverse of :func:`encode_fields`; raises ``ValueError`` for anything else."""
    return Tick(*_list(data, 3))


def decode_checkpoint(data: bytes) -> CheckpointMessage:
    """Inverse of :func:`encode_fields`; raises ``ValueError`` for anything else."""
    return CheckpointMessage(*_list(data, 4))


def decode_report(data: bytes) -> Report:
    """Inverse of :func:`encode_fields`; raises ``ValueError`` for anything else."""
    return Report(*_list(data, 4))


def _list(data: bytes, length: int) -> list[Any]:
    value = codec.decode(data)
    if not isinstance(value, list) or len(value) != length:
        raise ValueError(f"expected a list of {length}")
    return value


def encode_configs(configs: Sequence[StationConfig]) -> bytes:
    """Stations' settings (as JSON, which checks itself) and thresholds."""
    return codec.encode(
        [
            [
                config.station,
                config.settings.model_dump_json() if config.settings is not None else None,
                [[getattr(threshold, name) for name in Threshold.__slots__] for threshold in config.thresholds],
                config.created_gps_ns,
                config.changed_gps_ns,
            ]
            for config in configs
        ]
    )


def decode_configs(data: bytes) -> tuple[StationConfig, ...]:
    """Inverse of :func:`encode_configs`; raises ``ValueError`` for anything else."""
    try:
        return tuple(_config(*fields) for fields in codec.decode(data))
    except TypeError as error:
        raise ValueError(f"not a list of stations: {error}") from error


def _config(
    station: str, settings: str | None, thresholds: list[list[Any]], created: int, changed: int
) -> StationConfig:
    named = (dict(zip(Threshold.__slots__, values, strict=True)) for values in thresholds)
    return StationConfig(
        station,
        StationSettings.model_validate_json(settings) if settings is not None else None,
        tuple(Threshold(**values | {"severity": Severity(values["severity"])}) for values in named),
        created,
        changed,
    )
