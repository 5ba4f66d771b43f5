"""Who is calling? The first bytes of a connection, read without any input or output (sans-IO).

Feed a :class:`Registrar` what comes; it answers None (more is needed), :class:`Admitted` or :class:`Refused`. Forms:

- bytes configured as a station's registration, whatever they are (an IMEI of 15 digits, an ICCID of 20, any packet);
- a line ``ID,TOKEN`` or ``ID``, ended by a line feed, by the first frame's 0xD3, or by silence;
- NTRIP version 1: ``SOURCE password mountpoint`` and a header;
- NTRIP version 2: ``POST /mountpoint HTTP/1.1`` with Basic authorisation, the body chunked or not.

A mount point and an ID are a station's id or one of its configured registrations. A token is demanded where the form
carries one and the station has one; configured bytes are accepted as such.
"""

import base64
import binascii
from dataclasses import dataclass

from plumbline.config import StationSettings
from plumbline.ingest.directory import Directory, escape, tokens_agree

MAX_REGISTRATION_BYTES = 4096
IDENTITY_BYTES = 64
_METHODS = (b"SOURCE ", b"POST ", b"GET ", b"PUT ")
_HTTP_TEXT = {
    200: "OK",
    400: "Bad Request",
    401: "Unauthorized",
    404: "Not Found",
    405: "Method Not Allowed",
    431: "Request Header Fields Too Large",
    503: "Service Unavailable",
}


@dataclass(frozen=True, slots=True)
class Admitted:
    """A device of these stations (one, or several that share a connection)."""

    stations: tuple[StationSettings, ...]
    form: str  # "bytes", "line", "ntrip1", "ntrip2", "port"
    identity: str
    rest: bytes = b""  # what came behind the registration
    reply: bytes = b""
    chunked: bool = False
    prefix: bytes = b""  # in prefix mode: what stands before every packet


@dataclass(frozen=True, slots=True)
class Refused:
    """Nobody we know, and why; ``reply`` is what the caller should see before the connection ends."""

    reason: str
    identity: str
    reply: bytes = b""


Verdict = Admitted | Refused


def http_reply(status: int, *extra: str) -> bytes:
    """The head of an NTRIP version 2 answer."""
    lines = [f"HTTP/1.1 {status} {_HTTP_TEXT[status]}", "Ntrip-Version: Ntrip/2.0", "Server: NTRIP plumbline", *extra]
    return "\r\n".join([*lines, "Connection: close", "", ""]).encode("ascii")


class Registrar:
    """Reads one connection's registration."""

    def __init__(self, directory: Directory) -> None:
        self._directory = directory
        self._buffer = b""

    def receive(self, data: bytes) -> Verdict | None:
        """Take the next bytes; a verdict as soon as there can be one."""
        self._buffer += data
        verdict = self._decide(silent=False)
        if verdict is None and len(self._buffer) > MAX_REGISTRATION_BYTES:
            return self._refuse("registration_too_long")
        return verdict

    def silence(self) -> Verdict | None:
        """No more bytes came for a while: decide on those that did, unless a longer form is still possible."""
        return self._decide(silent=True) if self._buffer else None

    def give_up(self, reason: str) -> Refused:
        """The deadline has passed, or the device has gone."""
        return self._refuse(reason)

    def _decide(self, silent: bool) -> Verdict | None:
        data = self._buffer
        known, undecided = self._directory.beginning_with(data)
        if known is not None and not (undecided and not silent):
            rest = data[len(known) :]
            if not rest.startswith(b","):
                return self._admit(self._directory.of_registration(known), "bytes", known, len(known))
        if undecided and not (silent and known is not None):
            return None
        if any(data.startswith(method) or method.startswith(data) for method in _METHODS):
            return self._request(silent)
        return self._line(silent)

    # ----------------------------------------------------------------------------------------- ID,TOKEN

    def _line(self, silent: bool) -> Verdict | None:
        """A line, ended by a line feed, by the first frame or by silence."""
        data = self._buffer
        stripped = data.lstrip(b"\r\n\0 ")
        skipped = len(data) - len(stripped)
        ends = [position for mark in (b"\n", b"\xd3") if (position := stripped.find(mark)) >= 0]
        if not ends and not silent:
            return None if all(32 <= byte < 127 or byte in b"\r\t" for byte in stripped) else self._refuse_unknown()
        end = min(ends, default=len(stripped))
        consumed = skipped + end + (1 if stripped[end : end + 1] == b"\n" else 0)
        name, comma, token = stripped[:end].rstrip(b"\r").partition(b",")
        stations = self._directory.of_name(name.decode("utf-8", "replace").strip())
        if not stations:
            return self._refuse_unknown(name)
        demanded = comma or not self._directory.of_registration(name)
        if demanded and not all(tokens_agree(token.strip(), station.device.token) for station in stations):
            return Refused("bad_token", escape(name[:IDENTITY_BYTES]))
        return self._admit(stations, "line", name, consumed)

    # ----------------------------------------------------------------------------------------- NTRIP

    def _request(self, silent: bool) -> Verdict | None:
        """An NTRIP request, once its header is whole."""
        head, end, rest = self._buffer.partition(b"\r\n\r\n")
        if not end:
            head, end, rest = self._buffer.partition(b"\n\n")
        version_1 = self._buffer.startswith(b"SOURCE ")
        if not end:
            first_line = b"\n" in self._buffer and version_1 and silent
            if not first_line:
                return None
            head, rest = self._buffer, b""
        lines = head.decode("latin-1").splitlines()
        words = lines[0].split()
        return self._source(words, rest) if version_1 else self._post(words, lines[1:], rest)

    def _source(self, words: list[str], rest: bytes) -> Verdict:
        if len(words) < 2:
            return self._refuse("malformed_request", reply=b"ERROR - Bad Request\r\n")
        password, mount = (words[1], words[2]) if len(words) > 2 else ("", words[1])
        stations = self._directory.of_name(mount.lstrip("/")) or self._directory.of_name(mount)
        if not stations:
            return Refused(
                "unknown_device",
                escape(mount.encode("latin-1")[:IDENTITY_BYTES]),
                b"ERROR - Mount Point Taken or Invalid\r\n",
            )
        mount = mount.lstrip("/")
        if not all(tokens_agree(password.encode("latin-1"), station.device.token) for station in stations):
            return Refused("bad_token", mount, b"ERROR - Bad Password\r\n")
        return Admitted(stations, "ntrip1", mount, rest, b"ICY 200 OK\r\n\r\n")

    def _post(self, words: list[str], header_lines: list[str], rest: bytes) -> Verdict:
        if len(words) != 3 or not words[2].startswith("HTTP/1."):
            return self._refuse("malformed_request", reply=http_reply(400))
        if words[0] not in ("POST", "PUT"):
            return self._refuse("malformed_request", reply=http_reply(405, "Allow: POST"))
        pairs = (line.partition(":") for line in header_lines)
        headers = {name.strip().lower(): value.strip() for name, _, value in pairs}
        mount = words[1].lstrip("/")
        stations = self._directory.of_name(mount)
        if not stations:
            return Refused("unknown_device", escape(mount.encode("latin-1")[:IDENTITY_BYTES]), http_reply(404))
        password = _basic_password(headers.get("authorization", ""))
        if not all(tokens_agree(password, station.device.token) for station in stations):
            return Refused("bad_token", mount, http_reply(401, 'WWW-Authenticate: Basic realm="plumbline"'))
        reply = b"HTTP/1.1 100 Continue\r\n\r\n" if headers.get("expect", "").lower() == "100-continue" else b""
        chunked = "chunked" in headers.get("transfer-encoding", "").lower()
        return Admitted(stations, "ntrip2", mount, rest, reply + http_reply(200), chunked)

    # ----------------------------------------------------------------------------------------- verdicts

    def _admit(self, stations: tuple[StationSettings, ...], form: str, name: bytes, consumed: int) -> Admitted:
        registration, rest = self._buffer[:consumed], self._buffer[consumed:]
        prefix = registration if any(station.device.prefix_mode for station in stations) else b""
        return Admitted(stations, form, escape(name[:IDENTITY_BYTES]), rest, prefix=prefix)

    def _refuse(self, reason: str, reply: bytes = b"") -> Refused:
        return Refused(reason, escape(self._buffer[:IDENTITY_BYTES]), reply)

    def _refuse_unknown(self, name: bytes | None = None) -> Refused:
        if self._buffer[:1] == b"\xd3":
            return Refused("data_before_registration", escape(self._buffer[:6]))
        shown = self._buffer if name is None else name
        return Refused("unknown_device", escape(shown[:IDENTITY_BYTES].strip()))


def _basic_password(authorisation: str) -> bytes:
    """The password of a Basic authorisation header; empty when there is none."""
    scheme, _, credentials = authorisation.partition(" ")
    if scheme.lower() != "basic":
        return b""
    try:
        return base64.b64decode(credentials, validate=True).partition(b":")[2]
    except (binascii.Error, ValueError):
        return b""
