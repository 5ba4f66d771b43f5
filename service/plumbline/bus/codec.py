"""Records as MessagePack and back: the class's name and its fields by name, arrays as their bytes. No pickle anywhere.

An array is extension type 1: one byte dtype code, one byte number of dimensions, each dimension as uint32, the
C-ordered little-endian bytes. Times stay integers. Unknown fields are ignored and absent ones take their defaults, so
that processes of neighbouring versions understand each other.
"""

import struct
from collections.abc import Callable, Mapping
from enum import Enum
from functools import cache
from typing import Any, get_args, get_type_hints

import msgspec
import numpy as np

from plumbline import records
from plumbline.errors import ContractError

_ARRAY = 1
_DTYPES = ("<f8", "<i8", "<i2", "|i1", "|b1", "<f4", "<i4")
_CODE_OF_DTYPE = {np.dtype(name): code for code, name in enumerate(_DTYPES)}
_CLASSES: dict[str, Any] = {
    cls.__name__: cls
    for cls in (
        records.Solution,
        records.Motion,
        records.AlertEvent,
        records.StationStatus,
        records.Threshold,
        records.QualityReport,
    )
}


def _encode_array(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        array = np.ascontiguousarray(value)
        code = _CODE_OF_DTYPE.get(array.dtype)
        if code is None:
            raise ContractError(f"no array of {array.dtype} travels on the bus")
        head = struct.pack(f"<BB{array.ndim}I", code, array.ndim, *array.shape)
        return msgspec.msgpack.Ext(_ARRAY, head + array.tobytes())
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Mapping):
        return dict(value)
    raise ContractError(f"{type(value).__name__} does not travel on the bus")


def _decode_array(code: int, data: memoryview) -> Any:
    if code != _ARRAY:
        raise msgspec.DecodeError(f"unknown extension type {code}")
    dtype, n_dimensions = data[0], data[1]
    shape = struct.unpack_from(f"<{n_dimensions}I", data, 2)
    array = np.frombuffer(data, _DTYPES[dtype], offset=2 + 4 * n_dimensions).reshape(shape)
    array.flags.writeable = False
    return array


_encoder = msgspec.msgpack.Encoder(enc_hook=_encode_array)
_decoder = msgspec.msgpack.Decoder(ext_hook=_decode_array)


def encode(value: Any) -> bytes:
    """MessagePack of plain values, arrays and (at the top) one record of :mod:`plumbline.records`.

    Raises ContractError for anything else.
    """
    cls = type(value)
    if _CLASSES.get(cls.__name__) is cls:
        value = {"": cls.__name__} | {name: getattr(value, name) for name in cls.__slots__}
    return _encoder.encode(value)


def decode(data: bytes | memoryview) -> Any:
    """What :func:`encode` was given. Raises ``ValueError`` for bytes that are no message of this kind."""
    try:
        value = _decoder.decode(data)
        if isinstance(value, dict) and "" in value:
            return _record(value)
    except (msgspec.DecodeError, struct.error, IndexError, KeyError, TypeError) as error:
        raise ValueError(f"not a message of the bus: {error}") from error
    return value


def _record(value: dict[str, Any]) -> Any:
    cls, enums = _class_and_enums(value.pop(""))
    known = {name: content for name, content in value.items() if name in enums}
    for name, content in known.items():
        enum = enums[name]
        if enum is not None and content is not None:
            known[name] = enum(content)
    return cls(**known)


@cache
def _class_and_enums(name: str) -> tuple[type, dict[str, Callable[[Any], Enum] | None]]:
    """The class of a name, and for each of its fields the enumeration it holds, or None."""
    cls = _CLASSES[name]
    found: dict[str, Callable[[Any], Enum] | None] = {}
    for field_name, hint in get_type_hints(cls).items():
        candidates = [hint, *get_args(hint)]
        found[field_name] = next((t for t in candidates if isinstance(t, type) and issubclass(t, Enum)), None)
    return cls, found
