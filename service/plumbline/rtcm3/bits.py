"""Big-endian bit fields, as every RTCM 10403 message is made of: a reader and a writer."""

from plumbline.errors import ContractError


class BitsExhausted(Exception):
    """A message ends before its fields do: the caller turns it into a ``Malformed`` value."""


class BitReader:
    """Reads fields from the left of a byte string; raises :class:`BitsExhausted` past its end."""

    __slots__ = ("data", "position", "total")

    def __init__(self, data: bytes, position: int = 0) -> None:
        self.data = data
        self.position = position
        self.total = 8 * len(data)

    @property
    def remaining(self) -> int:
        """Bits not read yet."""
        return self.total - self.position

    def unsigned(self, bits: int) -> int:
        """An unsigned integer of ``bits`` bits."""
        start, end = self.position, self.position + bits
        if end > self.total:
            raise BitsExhausted(f"{bits} bits wanted, {self.remaining} left")
        self.position = end
        value = int.from_bytes(self.data[start >> 3 : (end + 7) >> 3], "big") >> (-end & 7)
        return value & ((1 << bits) - 1)

    def signed(self, bits: int) -> int:
        """A two's complement integer of ``bits`` bits."""
        value = self.unsigned(bits)
        return value - (1 << bits) if value >> (bits - 1) else value

    def octets(self, count: int) -> bytes:
        """``count`` bytes, aligned or not."""
        return self.unsigned(8 * count).to_bytes(count, "big")


class BitWriter:
    """Collects fields; :meth:`to_bytes` pads the last byte with zero bits."""

    __slots__ = ("_bits", "_done", "_value")

    def __init__(self) -> None:
        self._done = bytearray()
        self._value = 0
        self._bits = 0

    def unsigned(self, value: int, bits: int) -> None:
        """Append an unsigned integer; raises :class:`ContractError` when it does not fit."""
        if not 0 <= value < 1 << bits:
            raise ContractError(f"{value} does not fit {bits} unsigned bits")
        self._value = self._value << bits | value
        self._bits += bits
        if self._bits >= 256:
            self._flush()

    def signed(self, value: int, bits: int) -> None:
        """Append a two's complement integer; raises :class:`ContractError` when it does not fit."""
        if not -(1 << (bits - 1)) <= value < 1 << (bits - 1):
            raise ContractError(f"{value} does not fit {bits} signed bits")
        self.unsigned(value & ((1 << bits) - 1), bits)

    def octets(self, data: bytes) -> None:
        """Append bytes, aligned or not."""
        self.unsigned(int.from_bytes(data, "big"), 8 * len(data))

    def to_bytes(self) -> bytes:
        """Everything appended so far, the last byte filled with zeros."""
        padding = -self._bits & 7
        return bytes(self._done) + (self._value << padding).to_bytes((self._bits + padding) // 8, "big")

    def _flush(self) -> None:
        left = self._bits & 7
        self._done += (self._value >> left).to_bytes(self._bits >> 3, "big")
        self._value &= (1 << left) - 1
        self._bits = left
