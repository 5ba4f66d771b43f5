"""Messages as tables: the rows of a table are the message's fields, and one table both decodes and encodes.

A table is a tuple of rows after the 12-bit message number (DF002), which the engine reads and writes itself::

    STATION = Table(1005, "station position", (
        unsigned("DF003", "station", 12),
        signed("DF025", "x_ecef_m", 38, 1e-4, sentinel=None),
        flag("DF364", "quarter_cycle"),
        text("DF029", "antenna_type"),                         # 8-bit length, then that many characters
        unsigned("DF387", "n_satellites", 6),
        Group("satellites", "n_satellites", (                  # a tuple of dicts, one each
            unsigned("DF068", "satellite", 6),
            unsigned("DF379", "n_biases", 5),
            Group("biases", "n_biases", (unsigned("DF380", "signal", 5), signed("DF383", "bias_m", 14, 0.01))),
        )),
        Values("cosine_tecu", lambda fields: …, signed("IDF039", "", 16, 0.005)),   # a tuple of plain values
    ))
    register(STATION)

* value = (raw + offset) · scale; without a scale it stays an ``int``. Kinds: ``unsigned``, ``signed`` (two's
  complement), ``sign_magnitude`` (GLONASS), ``flag`` (bool), ``text``, ``reserved`` (kept; zero unless given).
* ``sentinel`` is the raw wire value, signed where the row is, that means "not available": it decodes to None, and None
  or NaN encodes to it.
* a count is the name of an earlier row of the same or an enclosing scope (then encoding fills it in from the group's
  length), or a function of those fields. It is checked against the bits that are left before anything is looped over.
* a message type with subtypes (4076) gives ``Table(4076, …, subtype=21)`` and a row named ``subtype``, filled in on
  encoding; where the subtype stands in the payload is told once by :func:`register_subtypes`.

``decode_table(table, payload) -> Message | Malformed`` and ``encode_table(table, fields) -> bytes`` (which raises
``ContractError`` for a value that is missing or does not fit). ``Message.fields`` maps names to ``int | float | bool |
str | None``, for groups to a tuple of such mappings, for ``Values`` to a tuple of values. Re-encoding a decoded message
gives the same bytes.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final

from plumbline.errors import ContractError
from plumbline.rtcm3.bits import BitReader, BitsExhausted, BitWriter

Fields = Mapping[str, Any]
Count = str | Callable[[Fields], int]

MESSAGE_NUMBER_BITS: Final = 12
_REQUIRED: Final = "required"


class Kind(IntEnum):
    """How a row's bits make a number."""

    UNSIGNED = 0
    SIGNED = 1
    SIGN_MAGNITUDE = 2
    FLAG = 3


@dataclass(frozen=True, slots=True)
class Row:
    """One data field: DF number, snake_case name with its unit, width, kind, scale, offset and sentinel (raw)."""

    df: str
    name: str
    bits: int
    kind: Kind
    scale: float | None = None
    sentinel: int | None = None
    offset: int = 0
    default: Any = _REQUIRED  # what encoding takes where the field is not given


@dataclass(frozen=True, slots=True)
class Text:
    """A character string, its length in bytes standing before it in ``length_bits`` bits."""

    df: str
    name: str
    encoding: str = "latin-1"
    length_bits: int = 8


@dataclass(frozen=True, slots=True)
class Group:
    """Rows that repeat: a tuple of mappings under ``name``."""

    name: str
    count: Count
    rows: "tuple[Item, ...]"


@dataclass(frozen=True, slots=True)
class Values:
    """One row that repeats: a tuple of values under ``name``."""

    name: str
    count: Count
    row: Row


Item = Row | Text | Group | Values


def unsigned(
    df: str, name: str, bits: int, scale: float | None = None, *, sentinel: int | None = None, offset: int = 0
) -> Row:
    """Row of an unsigned integer (uint, bit)."""
    return Row(df, name, bits, Kind.UNSIGNED, scale, sentinel, offset)


def signed(df: str, name: str, bits: int, scale: float | None = None, *, sentinel: int | None = None) -> Row:
    """Row of a two's complement integer (int)."""
    return Row(df, name, bits, Kind.SIGNED, scale, sentinel)


def sign_magnitude(df: str, name: str, bits: int, scale: float, *, sentinel: int | None = None) -> Row:
    """Row of a sign-magnitude integer (intS); a negative zero survives as −0.0."""
    return Row(df, name, bits, Kind.SIGN_MAGNITUDE, scale, sentinel)


def flag(df: str, name: str) -> Row:
    """Row of one bit: a bool."""
    return Row(df, name, 1, Kind.FLAG)


def text(df: str, name: str, encoding: str = "latin-1", length_bits: int = 8) -> Text:
    """Row of a string with its length before it. UTF-8 that is none keeps its bytes as surrogates."""
    return Text(df, name, encoding, length_bits)


def reserved(bits: int, name: str = "reserved", default: int = 0) -> Row:
    """Row of bits without a meaning of their own: kept on decoding, zero unless given on encoding."""
    return Row("DF001", name, bits, Kind.UNSIGNED, default=default)


@dataclass(frozen=True, slots=True)
class Message:
    """A table-driven message: its number, its fields by name, and its subtype where its number has several."""

    number: int
    fields: Fields
    subtype: int | None = None

    def __getitem__(self, name: str) -> Any:
        return self.fields[name]


@dataclass(frozen=True, slots=True)
class Malformed:
    """A frame whose CRC is right and whose contents are not: counted under ``reason``."""

    number: int
    reason: str


@dataclass(frozen=True, slots=True)
class Unknown:
    """A well-framed message of a type that is not decoded here."""

    number: int
    subtype: int | None = None


@dataclass(frozen=True, slots=True)
class _Block:
    """Neighbouring fixed rows, read as one integer; a row that is a plain integer has no converter."""

    bits: int
    decoders: tuple[tuple[str, int, int, Callable[[int], Any] | None], ...]  # name, shift, mask, converter
    encoders: tuple[tuple[Row, int], ...]  # row, shift


@dataclass(frozen=True, slots=True)
class _Series:
    name: str
    count: Count
    row: Row
    convert: Callable[[int], Any]


@dataclass(frozen=True, slots=True)
class _Repeat:
    name: str
    count: Count
    plan: "_Plan"
    least_bits: int


_Step = _Block | _Repeat | _Series | Text
_Plan = tuple[_Step, ...]


@dataclass(frozen=True, slots=True)
class _Compiled:
    plan: _Plan
    counts: Mapping[str, str]  # count row -> the group whose length it is


class Table:
    """A message type: number, title, rows; compiled once into integer blocks.

    ``alternative`` is a second layout that streams in the field use under the same number. Decoding takes it where it
    fills the payload to less than a byte and the first does not; encoding takes it where the first lacks a field.
    """

    __slots__ = ("alternative", "compiled", "number", "rows", "subtype", "title")

    def __init__(
        self,
        number: int,
        title: str,
        rows: tuple[Item, ...],
        subtype: int | None = None,
        alternative: "Table | None" = None,
    ) -> None:
        self.number = number
        self.title = title
        self.rows = rows
        self.subtype = subtype
        self.alternative = alternative
        self.compiled = _Compiled(_compile(rows), _counts(rows))


def _compile(rows: tuple[Item, ...]) -> _Plan:
    steps: list[_Step] = []
    pending: list[Row] = []

    def close_block() -> None:
        if pending:
            steps.append(_block(tuple(pending)))
            pending.clear()

    for row in rows:
        if isinstance(row, Row):
            pending.append(row)
            continue
        close_block()
        if isinstance(row, Group):
            steps.append(_Repeat(row.name, row.count, _compile(row.rows), _least_bits(row.rows)))
        elif isinstance(row, Values):
            steps.append(_Series(row.name, row.count, row.row, _converter(row.row) or int))
        else:
            steps.append(row)
    close_block()
    return tuple(steps)


def _block(rows: tuple[Row, ...]) -> _Block:
    total = sum(row.bits for row in rows)
    shift, decoders, encoders = total, [], []
    for row in rows:
        shift -= row.bits
        decoders.append((row.name, shift, (1 << row.bits) - 1, _converter(row)))
        encoders.append((row, shift))
    return _Block(total, tuple(decoders), tuple(encoders))


def _least_bits(rows: tuple[Item, ...]) -> int:
    """Bits that one repetition takes at the very least."""
    return sum(r.bits if isinstance(r, Row) else r.length_bits if isinstance(r, Text) else 0 for r in rows)


def _counts(rows: tuple[Item, ...]) -> dict[str, str]:
    """Count rows of all scopes and the group whose length each is; names are unique within a table."""
    found: dict[str, str] = {}
    for row in rows:
        if isinstance(row, Group | Values) and isinstance(row.count, str):
            found[row.count] = row.name
        if isinstance(row, Group):
            found |= _counts(row.rows)
    return found


# --------------------------------------------------------------------------------------------- decoding


def decode_table(table: Table, payload: bytes) -> Message | Malformed:
    """Decode a payload (message number included) by its table."""
    fields, remaining = _decode_layout(table, payload)
    if table.alternative is not None and (fields is None or remaining >= 8):
        other, other_remaining = _decode_layout(table.alternative, payload)
        if other is not None and other_remaining < 8:
            fields = other
    if fields is None:
        return Malformed(table.number, "too_short")
    return Message(table.number, fields, table.subtype)


def _decode_layout(table: Table, payload: bytes) -> tuple[dict[str, Any] | None, int]:
    """Fields by one layout (None: the payload is too short for it) and the bits left unread."""
    reader = BitReader(payload, MESSAGE_NUMBER_BITS)
    fields: dict[str, Any] = {}
    try:
        _decode_plan(table.compiled.plan, reader, fields, {})
    except BitsExhausted:
        return None, 0
    return fields, reader.remaining


def _decode_plan(plan: _Plan, reader: BitReader, out: dict[str, Any], outer: Fields) -> None:
    for step in plan:
        if isinstance(step, _Block):
            _decode_block(step, reader.unsigned(step.bits), out)
        elif isinstance(step, Text):
            octets = reader.octets(_bounded(reader, reader.unsigned(step.length_bits), 8))
            out[step.name] = octets.decode(step.encoding, "surrogateescape")
        elif isinstance(step, _Series):
            n = _bounded(reader, _count(step.count, out, outer), step.row.bits)
            out[step.name] = tuple([step.convert(reader.unsigned(step.row.bits)) for _ in range(n)])
        else:
            n = _bounded(reader, _count(step.count, out, outer), step.least_bits)
            repeats: tuple[dict[str, Any], ...] = tuple([{} for _ in range(n)])
            if len(step.plan) == 1 and isinstance(block := step.plan[0], _Block):
                bits = reader.unsigned(n * block.bits)
                for i, repeat in enumerate(repeats, 1):
                    _decode_block(block, bits >> (n - i) * block.bits, repeat)
            else:
                scope = {**outer, **out}
                for repeat in repeats:
                    _decode_plan(step.plan, reader, repeat, scope)
            out[step.name] = repeats


def _decode_block(block: _Block, bits: int, out: dict[str, Any]) -> None:
    """Fields of a block that stands in the lowest bits of an integer."""
    for name, shift, mask, convert in block.decoders:
        raw = bits >> shift & mask
        out[name] = raw if convert is None else convert(raw)


def _bounded(reader: BitReader, count: int, least_bits: int) -> int:
    if count * max(least_bits, 1) > reader.remaining:
        raise BitsExhausted(f"{count} repetitions of {least_bits} bits, {reader.remaining} left")
    return count


def _count(count: Count, fields: Fields, outer: Fields) -> int:
    if isinstance(count, str):
        return int(fields[count] if count in fields else outer[count])
    return count({**outer, **fields})


def _converter(row: Row) -> Callable[[int], Any] | None:
    """What turns a row's bits into its value; None where they are the value."""
    scale, offset, sentinel = row.scale, row.offset, row.sentinel
    top = 1 << (row.bits - 1)
    flip = top if row.kind is Kind.SIGNED else 0  # (raw ^ top) − top is two's complement

    def general(raw: int) -> Any:
        if row.kind is Kind.SIGN_MAGNITUDE and raw & top:
            magnitude = raw ^ top
            return None if sentinel == -magnitude else -float(magnitude) * (scale or 1.0)
        number = (raw ^ flip) - flip
        if number == sentinel:
            return None
        return number + offset if scale is None else (number + offset) * scale

    if row.kind is Kind.FLAG:
        return bool
    if row.kind is Kind.SIGN_MAGNITUDE or sentinel is not None:
        return general
    if scale is not None:
        shift = offset - flip
        return (lambda raw: ((raw ^ flip) + shift) * scale) if flip or offset else (lambda raw: raw * scale)
    return (lambda raw: (raw ^ flip) - flip + offset) if flip or offset else None


# --------------------------------------------------------------------------------------------- encoding


def encode_table(table: Table, fields: Fields) -> bytes:
    """Encode fields by a table; raises :class:`ContractError` for a field that is missing or does not fit."""
    if table.alternative is not None:
        try:
            return _encode_layout(table, fields)
        except ContractError:
            return _encode_layout(table.alternative, fields)
    return _encode_layout(table, fields)


def _encode_layout(table: Table, fields: Fields) -> bytes:
    writer = BitWriter()
    writer.unsigned(table.number, MESSAGE_NUMBER_BITS)
    if table.subtype is not None:
        fields = {**fields, "subtype": table.subtype}
    _encode_plan(table.compiled, table.compiled.plan, writer, fields, {})
    return writer.to_bytes()


def _encode_plan(compiled: _Compiled, plan: _Plan, writer: BitWriter, fields: Fields, outer: Fields) -> None:
    lengths = {count: len(fields[group]) for count, group in compiled.counts.items() if group in fields}
    fields = {**fields, **lengths}
    for step in plan:
        if isinstance(step, _Block):
            block = 0
            for row, shift in step.encoders:
                block |= _raw_of_value(row, _field(row, fields)) << shift
            writer.unsigned(block, step.bits)
        elif isinstance(step, Text):
            octets = _octets(step, _field(step, fields))
            writer.unsigned(len(octets), step.length_bits)
            writer.octets(octets)
        else:
            repeats = _field(step, fields)
            if callable(step.count) and len(repeats) != step.count({**outer, **fields}):
                raise ContractError(f"{step.name!r} has {len(repeats)} repetitions, its count says otherwise")
            if isinstance(step, _Series):
                for value in repeats:
                    writer.unsigned(_raw_of_value(step.row, value), step.row.bits)
            else:
                for repeat in repeats:
                    _encode_plan(compiled, step.plan, writer, repeat, {**outer, **fields})


def _field(item: Row | Text | _Series | _Repeat, fields: Fields) -> Any:
    try:
        return fields[item.name]
    except KeyError:
        if isinstance(item, Row) and item.default is not _REQUIRED:
            return item.default
        raise ContractError(f"field {item.name!r} is missing") from None


def _octets(row: Text, value: str) -> bytes:
    try:
        return value.encode(row.encoding, "surrogateescape")
    except UnicodeEncodeError:
        raise ContractError(f"{row.name!r} ({row.df}) has characters outside {row.encoding}: {value!r}") from None


def _raw_of_value(row: Row, value: Any) -> int:
    """The row's bits as an unsigned integer."""
    raw = row.sentinel
    if value is not None and not math.isnan(value):
        raw = (int(value) if row.scale is None else round(value / row.scale)) - row.offset
        if raw == row.sentinel:
            raise ContractError(f"{row.name!r} ({row.df}): {value!r} is coded as 'not available'")
    if raw is None:
        raise ContractError(f"{row.name!r} ({row.df}) has no way to say 'not available'")
    top = 1 << (row.bits - 1)
    if row.kind == Kind.SIGNED:
        fits, encoded = -top <= raw < top, raw & (2 * top - 1)
    elif row.kind == Kind.SIGN_MAGNITUDE:
        negative = raw < 0 or (raw == 0 and value is not None and math.copysign(1.0, value) < 0)
        fits, encoded = abs(raw) < top, abs(raw) | (top if negative else 0)
    else:
        fits, encoded = 0 <= raw < 2 * top, raw
    if not fits:
        raise ContractError(f"{row.name!r} ({row.df}) does not fit {row.bits} bits: {value!r}")
    return encoded


# --------------------------------------------------------------------------------------------- registry

_TABLES: Final[dict[tuple[int, int | None], Table]] = {}
_SUBTYPE_PLACES: Final[dict[int, tuple[int, int]]] = {}


def register(*tables: Table) -> None:
    """Make tables known to :func:`plumbline.rtcm3.decode`; called at import by the modules that define them."""
    for table in tables:
        key = (table.number, table.subtype)
        if key in _TABLES:
            raise ContractError(f"message {key} is registered twice")
        _TABLES[key] = table


def register_subtypes(number: int, first_bit: int, bits: int) -> None:
    """Say where in the payload of message ``number`` its subtype stands (4076: bit 15, 8 bits)."""
    _SUBTYPE_PLACES[number] = (first_bit, bits)


def subtype_of(number: int, payload: bytes) -> int | None:
    """Subtype of a payload, or None where the message has none (or is too short to tell)."""
    place = _SUBTYPE_PLACES.get(number)
    if place is None or 8 * len(payload) < sum(place):
        return None
    return BitReader(payload, place[0]).unsigned(place[1])


def table_of(number: int, subtype: int | None = None) -> Table | None:
    """The registered table of a message type."""
    return _TABLES.get((number, subtype))
