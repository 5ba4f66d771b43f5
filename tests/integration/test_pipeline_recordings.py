"""The pipeline on recordings. Oracles: the recordings' documented facts, and itself (the same bytes, the same rows)."""

import random
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from plumbline.bus import codec
from plumbline.config import Mode, StationSettings
from plumbline.epochs.recording import Piece, merge, read_recording
from plumbline.gps_time import DAY_NS, NS_PER_S, gps_ns_from_utc
from plumbline.pipeline import Books, NavigationFeed, Pipeline
from plumbline.records import Output, Solution, StationStatus, Status

pytestmark = pytest.mark.realdata
TODAY = gps_ns_from_utc(datetime(2026, 11, 22, tzinfo=UTC))


def station(name: str = "rover") -> StationSettings:
    return StationSettings(station=name, mode=Mode.PPP)


def rows(outputs: list[Output]) -> list[bytes]:
    """The stored rows, as the bytes that travel; statuses are of the moment and not part of the series."""
    return [codec.encode(output) for output in outputs if not isinstance(output, StationStatus)]


def replay(pieces: list[Piece], shift_ns: int = 0, cut: int = 0) -> list[Output]:
    """Run pieces as if received at their own times plus a shift; ``cut``: restart from a checkpoint after so many."""
    pipeline, outputs = Pipeline(station(), (), Books()), list[Output]()
    for i, piece in enumerate(pieces):
        if cut and i == cut:
            pipeline = Pipeline.restore(station(), (), Books(), pipeline.snapshot())
        outputs += pipeline.receive(piece.data, piece.t_ns + shift_ns)
    return outputs + pipeline.finish(pieces[-1].t_ns + shift_ns)


def solutions(outputs: list[Output]) -> list[Solution]:
    return [output for output in outputs if isinstance(output, Solution)]


@pytest.fixture(scope="module")
def str17(data_dir: Path) -> list[Piece]:
    near = gps_ns_from_utc(datetime(2018, 7, 15, tzinfo=UTC))
    return read_recording(data_dir / "str-2018-195" / "week-rollover-STR17.rtcm3", "STR17", t_near_ns=near)


def test_the_week_crossing_leaves_no_mark_even_years_later(str17: list[Piece]) -> None:
    outputs = solutions(replay(str17, shift_ns=TODAY - str17[0].t_ns))
    start = gps_ns_from_utc(datetime(2018, 7, 14, 23, 50, tzinfo=UTC))
    assert [s.t_gps_ns for s in outputs] == [start + k * NS_PER_S for k in range(1126)]
    positions = np.array([s.position_ecef_m for s in outputs if s.position_ecef_m is not None])
    assert len(positions) > 1000
    assert np.abs(positions - np.median(positions, axis=0)).max() < 30.0  # broadcast single points: metres, no outlier


@pytest.mark.parametrize("day", range(7))
def test_the_weekday_of_a_later_replay_is_no_matter(str17: list[Piece], day: int) -> None:
    """What tells a time of week and what tells a time of day agree only once an ephemeris has told the week."""
    outputs = solutions(replay(str17[:400], shift_ns=TODAY + day * DAY_NS - str17[0].t_ns))
    start = gps_ns_from_utc(datetime(2018, 7, 14, 23, 50, tzinfo=UTC))
    assert [s.t_gps_ns for s in outputs] == [start + k * NS_PER_S for k in range(len(outputs))]


def test_the_same_bytes_give_the_same_rows_however_they_are_cut(str17: list[Piece]) -> None:
    pieces = str17[:4000]
    once = rows(replay(pieces))
    assert once == rows(replay(pieces))
    assert once == rows(replay(pieces, cut=1700))
    generator = random.Random(1)
    shredded = []
    for piece in pieces:
        at = generator.randrange(len(piece.data) + 1)
        shredded += [Piece(piece.t_ns, piece.stream, part) for part in (piece.data[:at], piece.data[at:])]
    assert once == rows(replay(shredded))


@pytest.mark.parametrize("years_later", [False, True])
def test_galileo_carries_on_and_gps_says_why_not(data_dir: Path, years_later: bool) -> None:
    """After 20:01:00 the GPS corrections refer to ephemerides that the stream does not carry.

    The rover sends no ephemeris at all: received at another date, its week is the corrections' stream's word alone.
    """
    folder = data_dir / "sc134-2026-037"
    near = gps_ns_from_utc(datetime(2026, 2, 6, 20, tzinfo=UTC))
    streams = {"rover": "ROVRMSG.bin", "corrections": "SSRTEST_20260206_CORR.bin"}
    pieces = merge([read_recording(folder / file, name, t_near_ns=near) for name, file in streams.items()])
    shift_ns = TODAY - pieces[0].t_ns if years_later else 0
    books = Books()
    feed, pipeline, outputs = NavigationFeed("corrections", books), Pipeline(station(), (), books), list[Output]()
    for piece in pieces:
        if piece.stream == "corrections":
            feed.receive(piece.data, piece.t_ns + shift_ns)
        else:
            outputs += pipeline.receive(piece.data, piece.t_ns + shift_ns)
    first_ns = near + 21 * NS_PER_S
    times = [s.t_gps_ns for s in solutions(outputs)]
    assert all(first_ns - 60 * NS_PER_S < t < near + 2800 * NS_PER_S for t in times)
    assert times == sorted(set(times))
    after = [s for s in solutions(outputs) if s.t_gps_ns > near + 240 * NS_PER_S]
    precise = [s for s in after if s.status in (Status.CONVERGING, Status.PPP_FLOAT)]
    # The stream's corrections take up a new IODnav at once and its ephemerides follow within two minutes, every ten.
    assert len(precise) > 0.8 * len(after)
    assert all("E" in s.systems for s in precise)
    told = [s for s in after if "GPS refer to ephemerides" in s.reason]
    assert len(told) > 0.95 * len(after)
