"""Who is calling: every form of registration, whole, byte by byte and with data glued on; and what is nobody."""

import base64

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plumbline.config import DeviceSettings, StationSettings
from plumbline.ingest.directory import Directory, escape, tokens_agree, unescape
from plumbline.ingest.registration import MAX_REGISTRATION_BYTES, Admitted, Refused, Registrar, Verdict

IMEI, ICCID = "867322041234567", "89860318640220133897"
DATA = b"\xd3\x00\x13>\xd0"


def station(name: str, *registrations: str, **device: object) -> StationSettings:
    return StationSettings(station=name, device=DeviceSettings(registrations=registrations, **device))  # type: ignore[arg-type]


DIRECTORY = Directory(
    [
        station("imei", IMEI),
        station("iccid", ICCID),
        station("bytes", r"\x01\x02REG\xff"),
        station("short", "DTU-7"),
        station("long", "DTU-77"),
        station("closed", token="s3cret"),
        station("open"),
        station("gateway-1", "GATE", rtcm_station_ids=(1,)),
        station("gateway-2", "GATE", rtcm_station_ids=(2,)),
        station("prefixed", "PFX:", prefix_mode=True),
    ]
)
BASIC = base64.b64encode(b"user:s3cret").decode()
POST = "POST /closed HTTP/1.1\r\nHost: h\r\nNtrip-Version: Ntrip/2.0\r\nAuthorization: Basic {}\r\n{}\r\n"
CHUNKED = "Transfer-Encoding: chunked\r\n"

ADMITTED = [
    (IMEI.encode(), ["imei"], "bytes"),
    (ICCID.encode(), ["iccid"], "bytes"),
    (b"\x01\x02REG\xff", ["bytes"], "bytes"),
    (b"DTU-7\r\n", ["short"], "bytes"),
    (b"DTU-77", ["long"], "bytes"),
    (b"closed,s3cret\r\n", ["closed"], "line"),
    (b"open\n", ["open"], "line"),
    (b"open,whatever\n", ["open"], "line"),
    (b"GATE", ["gateway-1", "gateway-2"], "bytes"),
    (b"SOURCE s3cret /closed\r\nSource-Agent: NTRIP x\r\n\r\n", ["closed"], "ntrip1"),
    (b"SOURCE s3cret closed\r\nSource-Agent: NTRIP x\r\nSTR: \r\n\r\n", ["closed"], "ntrip1"),  # as RTKLIB sends it
    (POST.format(BASIC, CHUNKED).encode(), ["closed"], "ntrip2"),
    (POST.format(BASIC, "").encode(), ["closed"], "ntrip2"),
]
REFUSED = [
    (b"closed,wrong\r\n", "bad_token", b""),
    (b"closed\r\n", "bad_token", b""),
    (b"nobody,s3cret\n", "unknown_device", b""),
    (b"123456789012345", "unknown_device", b""),
    (b"\x00\x01\x02\x03", "unknown_device", b""),
    (DATA, "data_before_registration", b""),
    (b"SOURCE wrong /closed\r\n\r\n", "bad_token", b"ERROR - Bad Password\r\n"),
    (b"SOURCE s3cret /nobody\r\n\r\n", "unknown_device", b"ERROR - Mount Point Taken or Invalid\r\n"),
    (POST.format("d3Jvbmc6", "").encode(), "bad_token", b"HTTP/1.1 401 "),
    (POST.format("!!", "").encode(), "bad_token", b"HTTP/1.1 401 "),
    (b"POST /nobody HTTP/1.1\r\n\r\n", "unknown_device", b"HTTP/1.1 404 "),
    (b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", "malformed_request", b"HTTP/1.1 405 "),
    (b"POST nonsense\r\n\r\n", "malformed_request", b"HTTP/1.1 400 "),
]


def verdict(data: bytes, step: int) -> Verdict:
    registrar = Registrar(DIRECTORY)
    for begin in range(0, len(data), step):
        found = registrar.receive(data[begin : begin + step])
        if found is not None:
            return found
    found = registrar.silence()
    assert found is not None
    return found


@pytest.mark.parametrize(("data", "stations", "form"), ADMITTED, ids=lambda v: repr(v)[:30])
@pytest.mark.parametrize("step", [1, 3, 10_000])
def test_admitted(data: bytes, stations: list[str], form: str, step: int) -> None:
    found = verdict(data, step)
    assert isinstance(found, Admitted), found
    assert [s.station for s in found.stations] == stations
    assert found.form == form
    assert found.chunked == (CHUNKED.encode() in data)


@pytest.mark.parametrize(("data", "stations", "form"), ADMITTED, ids=lambda v: repr(v)[:30])
def test_data_behind_the_registration_is_kept(data: bytes, stations: list[str], form: str) -> None:
    found = verdict(data + DATA, 10_000)
    assert isinstance(found, Admitted), found
    assert [s.station for s in found.stations] == stations
    assert found.rest.endswith(DATA)
    assert len(found.rest) <= len(DATA) + 2  # at most the line end of a registration that needs none


@pytest.mark.parametrize(("data", "reason", "reply"), REFUSED, ids=lambda v: repr(v)[:30])
@pytest.mark.parametrize("step", [1, 10_000])
def test_refused_with_a_reason_that_a_crew_can_read(data: bytes, reason: str, reply: bytes, step: int) -> None:
    found = verdict(data, step)
    assert isinstance(found, Refused), found
    assert found.reason == reason
    assert found.reply.startswith(reply)
    assert "s3cret" not in found.identity
    assert "wrong" not in found.identity


def test_the_longer_of_two_registrations_is_waited_for() -> None:
    registrar = Registrar(DIRECTORY)
    assert registrar.receive(b"DTU-7") is None  # DTU-77 may yet come
    found = registrar.silence()
    assert isinstance(found, Admitted)
    assert found.stations[0].station == "short"


def test_prefix_mode_remembers_what_stands_before_every_packet() -> None:
    found = verdict(b"PFX:" + DATA, 100)
    assert isinstance(found, Admitted)
    assert (found.prefix, found.rest) == (b"PFX:", DATA)


def test_registration_bytes_are_bounded() -> None:
    registrar = Registrar(DIRECTORY)
    found = None
    sent = 0
    while found is None:
        found = registrar.receive(b"SOURCE " + b"a" * 500)
        sent += 507
        assert sent < MAX_REGISTRATION_BYTES + 1014
    assert isinstance(found, Refused)
    assert found.reason == "registration_too_long"


def test_expect_100_continue_is_answered() -> None:
    found = verdict(POST.format(BASIC, "Expect: 100-continue\r\n").encode(), 10_000)
    assert isinstance(found, Admitted)
    assert found.reply.startswith(b"HTTP/1.1 100 Continue\r\n\r\nHTTP/1.1 200 OK\r\n")


@given(st.lists(st.binary(max_size=50), max_size=20))
@settings(max_examples=300, deadline=None)
def test_garbage_never_raises_and_is_never_admitted_but_to_an_open_station(pieces: list[bytes]) -> None:
    registrar = Registrar(Directory([station("closed", token="s3cret"), station("x", r"\xf0\x9f\xfe\x01")]))
    for piece in pieces:
        found = registrar.receive(piece)
        if found is not None:
            assert isinstance(found, Refused)
            return
    assert not isinstance(registrar.silence(), Admitted)
    assert isinstance(registrar.give_up("registration_timeout"), Refused)


@given(st.binary(max_size=40))
def test_what_is_shown_of_a_caller_can_be_configured_as_its_registration(data: bytes) -> None:
    assert unescape(escape(data)) == data
    assert escape(data).isascii()


def test_tokens() -> None:
    assert tokens_agree(b"anything", None)
    assert tokens_agree("grün".encode(), "grün")
    assert not tokens_agree(b"", "x")
    assert not tokens_agree(b"xx", "x")
