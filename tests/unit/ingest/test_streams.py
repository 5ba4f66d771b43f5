"""What devices send, taken apart: the oracle is what was put together, cut in any way."""

import functools
import operator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plumbline.config import DeviceSettings, NtripSource, StationSettings
from plumbline.ingest.callers import BAD_TOKENS_BEFORE_PAUSE, MAX_LISTED, PAUSE_NS, Callers
from plumbline.ingest.clock import ReceiveClock
from plumbline.ingest.http_chunked import ChunkedDecoder, chunk
from plumbline.ingest.ntrip_client import Response, StreamEnded, gga_sentence, parse_head, pause_s, request
from plumbline.ingest.registration import Admitted
from plumbline.ingest.stream_split import DeviceStream, PrefixStripper, rtcm_station_id
from plumbline.rtcm3.framing import frame


def cut(data: bytes, sizes: list[int]) -> list[bytes]:
    """``data`` in pieces of the sizes, the rest in one."""
    pieces = []
    for size in sizes:
        pieces.append(data[:size])
        data = data[size:]
    return [*pieces, data]


SIZES = st.lists(st.integers(1, 40), max_size=40)


# ------------------------------------------------------------------------------------------------ chunked coding


@given(st.lists(st.binary(min_size=1, max_size=60), max_size=12), SIZES)
def test_chunked_content_comes_out_however_it_is_cut(contents: list[bytes], sizes: list[int]) -> None:
    decoder = ChunkedDecoder()
    coded = b"".join(chunk(content) for content in contents) + b"0\r\n\r\n"
    assert b"".join(decoder.receive(piece) for piece in cut(coded, sizes)) == b"".join(contents)
    assert decoder.ended
    assert not decoder.error


def test_chunk_extensions_and_upper_case_sizes() -> None:  # RFC 9112, 7.1.1
    assert ChunkedDecoder().receive(b"1A;name=value\r\nabcdefghijklmnopqrstuvwxyz\r\n3\nxyz\n") == (
        b"abcdefghijklmnopqrstuvwxyzxyz"
    )


@pytest.mark.parametrize("bad", [b"xyz\r\n", b"-1\r\n", b"\r\n", b"FFFFFFFFF\r\n", b"2\r\nabc\r\n", b"1" * 300])
def test_bad_chunks_are_an_error_and_nothing_follows(bad: bytes) -> None:
    decoder = ChunkedDecoder()
    decoder.receive(bad)
    assert decoder.error
    assert decoder.receive(chunk(b"more")) == b""


# ------------------------------------------------------------------------------------------------ prefixes, heartbeats

FRAMES = [frame(bytes((0x43, 0x50 | (i >> 8), i & 0xFF)) + bytes([i] * (20 + i))) for i in range(6)]  # 1077, DF003 = i


def admitted(*stations: StationSettings, prefix: bytes = b"", chunked: bool = False) -> Admitted:
    return Admitted(stations, "bytes", "x", prefix=prefix, chunked=chunked)


def station(name: str, **device: object) -> StationSettings:
    return StationSettings(station=name, device=DeviceSettings(**device))  # type: ignore[arg-type]


@given(SIZES, SIZES)
def test_prefixes_are_taken_out_wherever_they_stand(packets: list[int], segments: list[int]) -> None:
    """A DTU cuts the serial stream into packets and sets the prefix before each; TCP cuts again."""
    prefix, data = b"867322041234567", b"".join(FRAMES)
    sent = b"".join(prefix + packet for packet in cut(data, packets))
    stripper = PrefixStripper(prefix)
    came = b"".join(stripper.receive(piece) for piece in cut(sent, segments))
    assert came + stripper.release() == data


def test_what_only_begins_like_a_prefix_is_released_by_silence() -> None:
    stream = DeviceStream(admitted(station("a"), prefix=b"PFX"))
    assert stream.receive(b"abcPF").parts == (("a", b"abc"),)
    assert stream.holds
    assert stream.silence().parts == (("a", b"PF"),)
    assert not stream.holds


@given(SIZES)
def test_heartbeats_are_counted_and_echoed_and_frames_are_not_searched_for_them(sizes: list[int]) -> None:
    inside = frame(b"\x43\x50\x01 HB HB HB ")
    sent = b"HB" + FRAMES[0] + b"HBHB" + inside + b"noise" + FRAMES[1] + b"HB"
    stream = DeviceStream(admitted(station("a", heartbeat="HB", echo_heartbeat=True)))
    received = [stream.receive(piece) for piece in cut(sent, sizes)]
    assert b"".join(data for r in received for _, data in r.parts) == sent  # the archive gets every byte
    assert b"".join(r.reply for r in received) == b"HB" * 4
    assert stream.counters["heartbeats"] == 4
    assert stream.counters["noise_bytes"] == 5


@given(SIZES)
@settings(deadline=None)
def test_a_shared_connection_is_told_apart_by_rtcm_station_id(sizes: list[int]) -> None:
    ephemeris = frame(b"\x3f\xb0" + bytes(59))  # 1019 has no DF003
    sent = b"?" + functools.reduce(operator.add, FRAMES) + ephemeris + b"!!"
    stations = (station("one", rtcm_station_ids=(1, 2)), station("two", rtcm_station_ids=(3,)))
    stream = DeviceStream(admitted(*stations))
    got: dict[str, bytes] = {}
    for piece in cut(sent, sizes):
        for name, data in stream.receive(piece).parts:
            got[name] = got.get(name, b"") + data
    # ids 0, 4, 5 are nobody's, the ephemeris has none: they are the first station's
    assert got == {"one": b"".join(FRAMES[i] for i in (0, 1, 2, 4, 5)) + ephemeris, "two": FRAMES[3]}
    assert stream.counters["frames_of_unknown_station_id"] == 3
    assert stream.counters["noise_bytes"] == 3


def test_station_id_of_messages() -> None:
    assert rtcm_station_id(1077, FRAMES[5][3:-3], set()) == 5
    assert rtcm_station_id(1005, bytes((0x3E, 0xDF, 0xFF)), set()) == 4095
    assert rtcm_station_id(1019, bytes(61), {4001}) is None
    assert rtcm_station_id(4001, bytes((0xFA, 0x10, 0x07)), {4001}) == 7
    assert rtcm_station_id(1077, b"\x43", set()) is None


def test_a_chunked_body_that_breaks_ends_the_connection() -> None:
    stream = DeviceStream(admitted(station("a"), chunked=True))
    assert stream.receive(chunk(b"abc")).parts == (("a", b"abc"),)
    assert stream.receive(b"zz\r\n").error == "not a chunk size"


# ------------------------------------------------------------------------------------------------ callers, clock


def test_callers_are_listed_bounded_and_forgotten() -> None:
    callers = Callers()
    for i in range(MAX_LISTED + 10):
        callers.refuse(f"device-{i}", "10.0.0.1", "unknown_device", i)
    first = callers.refuse("device-500", "10.0.0.2", "bad_token", 10_000)
    assert first is not None
    assert (first.attempts, first.first_seen_gps_ns, first.last_seen_gps_ns) == (2, 500, 10_000)
    assert len(callers.listed()) == MAX_LISTED
    assert callers.listed()[0].identity == "device-500"
    callers.forget("device-500")
    assert callers.listed()[0].identity == f"device-{MAX_LISTED + 9}"
    assert callers.refuse("", "10.0.0.1", "too_many_connections", 1) is None
    assert callers.refusals == {"unknown_device": MAX_LISTED + 10, "bad_token": 1, "too_many_connections": 1}


def test_guessing_tokens_pauses_the_pair_of_address_and_identity_only() -> None:
    callers = Callers()
    for i in range(BAD_TOKENS_BEFORE_PAUSE):
        assert not callers.must_pause("a", "10.0.0.1", i)
        callers.refuse("a", "10.0.0.1", "bad_token", i)
    assert callers.must_pause("a", "10.0.0.1", 100)
    assert not callers.must_pause("b", "10.0.0.1", 100)
    assert not callers.must_pause("a", "10.0.0.2", 100)
    assert not callers.must_pause("a", "10.0.0.1", PAUSE_NS + 100)


def test_receive_times_increase_whatever_the_machines_clock_does() -> None:
    times = iter(
        [1_800_000_000_000_000_000, 1_800_000_000_000_000_000, 1_700_000_000_000_000_000, 1_800_000_000_000_000_500]
    )
    clock = ReceiveClock(unix_ns=lambda: next(times))
    # 1,800,000,000 − 315,964,800 + 18 leap seconds
    first = 1_484_035_218_000_000_000
    assert [clock.now() for _ in range(4)] == [first, first + 1, first + 2, first + 500]
    assert clock.steps_back == 2
    assert ReceiveClock(not_before_ns=1 << 62).now() == (1 << 62) + 1


# ------------------------------------------------------------------------------------------------ NTRIP client


def test_heads_of_casters() -> None:
    assert parse_head(b"ICY 200 OK\r\n\r\n\xd3") == (Response(200, "OK"), b"\xd3")
    assert parse_head(b"ICY 200 OK\r\n\xd3") == (Response(200, "OK"), b"\xd3")
    assert parse_head(b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n") is None
    assert parse_head(b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nx") == (Response(200, "OK", True), b"x")
    assert parse_head(b"HTTP/1.1 503 Busy\r\nRetry-After: 7\r\n\r\n") == (Response(503, "Busy", False, 7.0), b"")
    for head, status in (
        (b"SOURCETABLE 200 OK\r\n", 404),
        (b"HTTP/1.1 200 OK\r\nContent-Type: gnss/sourcetable\r\n\r\n", 404),
        (b"ERROR - Bad Password\r\n", 401),
        (b"HTTP/1.1 401 Unauthorized\r\n\r\n", 401),
    ):
        parsed = parse_head(head)
        assert parsed is not None
        assert parsed[0].status == status
    with pytest.raises(StreamEnded):
        parse_head(b"SSH-2.0-OpenSSH\r\n")
    with pytest.raises(StreamEnded):
        parse_head(b"x" * 20_000)


def test_requests() -> None:
    source = NtripSource(station="s", url="http://caster:2101/MOUNT", user="u", password="p")
    assert request(source).startswith(b"GET /MOUNT HTTP/1.1\r\n")
    assert b"\r\nHost: caster:2101\r\n" in request(source)
    assert b"\r\nNtrip-Version: Ntrip/2.0\r\n" in request(source)
    assert b"\r\nAuthorization: Basic dTpw\r\n" in request(source)  # RFC 4648 of "u:p"
    version_1 = request(source.model_copy(update={"version": 1}))
    assert version_1.startswith(b"GET /MOUNT HTTP/1.0\r\nUser-Agent: NTRIP ")
    assert b"Ntrip-Version" not in version_1


def test_gga_of_a_known_position() -> None:
    # On the equator at 90° east, 100 m up, at 1980-01-06 00:00:10 UTC; the checksum is the XOR of the body.
    sentence = gga_sentence((0.0, 6_378_137.0 + 100.0, 0.0), 10_000_000_000)
    assert sentence.startswith("$GPGGA,000010.00,0000.00000,N,09000.00000,E,1,12,1.0,100.00,M,0.00,M,,*")
    body, checksum = sentence[1:].split("*")
    assert int(checksum, 16) == functools.reduce(operator.xor, body.encode())


def test_pauses_grow_have_jitter_and_obey_the_caster() -> None:
    assert [pause_s(n, None, lambda: 0.5) for n in range(8)] == [1, 2, 4, 8, 16, 32, 64, 120]
    assert pause_s(0, Response(503, "", False, 7.0), lambda: 0.0) == 7.0
    assert pause_s(0, Response(401, ""), lambda: 0.5) == 300.0
    assert len({pause_s(3, None) for _ in range(10)}) > 5
