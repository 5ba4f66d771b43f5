"""Which station a device's first bytes stand for: lookups built once from the stations' settings."""

import hmac
import re
from collections.abc import Iterable
from types import MappingProxyType

from plumbline.config import StationSettings

_ESCAPE = re.compile(rb"\\x([0-9A-Fa-f]{2})")


def unescape(text: str) -> bytes:
    r"""Bytes of a settings text, in which ``\xNN`` stands for a byte."""
    return _ESCAPE.sub(lambda match: bytes((int(match[1], 16),)), text.encode("utf-8"))


def escape(data: bytes) -> str:
    r"""Inverse of :func:`unescape`: printable ASCII as it is, every other byte (and the backslash) as ``\xNN``."""
    return "".join(chr(byte) if 32 <= byte < 127 and byte != 0x5C else f"\\x{byte:02x}" for byte in data)


def tokens_agree(given: bytes, wanted: str | None) -> bool:
    """Whether a token is the wanted one (None: any is), in a time that does not tell how much of it was right."""
    return hmac.compare_digest(given, given if wanted is None else wanted.encode("utf-8"))


class Directory:
    """An immutable view of all stations for recognising devices; make a new one when a station changes."""

    def __init__(self, stations: Iterable[StationSettings] = ()) -> None:
        ordered = sorted(stations, key=lambda station: station.station)
        self.stations = MappingProxyType({station.station: station for station in ordered})
        self.ports = MappingProxyType({s.device.port: s for s in ordered if s.device.port is not None})
        by_registration: dict[bytes, list[StationSettings]] = {}
        for station in ordered:
            for text in station.device.registrations:
                by_registration.setdefault(unescape(text), []).append(station)
        by_registration.pop(b"", None)
        self._by_registration = {key: tuple(found) for key, found in by_registration.items()}
        self._longest_first = sorted(self._by_registration, key=len, reverse=True)
        self._by_first_byte: dict[int, list[bytes]] = {}
        for registration in self._longest_first:
            self._by_first_byte.setdefault(registration[0], []).append(registration)

    def beginning_with(self, data: bytes) -> tuple[bytes | None, bool]:
        """The longest configured registration that ``data`` begins with; whether more bytes could make a longer one."""
        found, undecided = None, False
        for registration in self._by_first_byte.get(data[0], ()) if data else self._longest_first:
            if len(registration) > len(data):
                undecided = undecided or registration.startswith(data)
            elif data.startswith(registration):
                found = registration
                break
        return found, undecided

    def of_registration(self, registration: bytes) -> tuple[StationSettings, ...]:
        """The stations that share a configured registration, in order of their ids."""
        return self._by_registration.get(registration, ())

    def of_name(self, name: str) -> tuple[StationSettings, ...]:
        """The station of an id or mount point, or the stations of a configured registration of that text."""
        station = self.stations.get(name)
        return (station,) if station is not None else self.of_registration(name.encode("utf-8"))
