"""Mode rtk through the pipeline, chunk by chunk. Oracle: the same bytes give the same series however they are cut."""

import heapq
from pathlib import Path

import pytest

from plumbline.config import Mode, RtkSettings, StationSettings
from plumbline.epochs.recording import Piece, read_recording
from plumbline.epochs.stream import Books, NavigationFeed
from plumbline.pipeline import Pipeline
from plumbline.records import Output, Solution, Status

pytestmark = pytest.mark.realdata
T_NEAR_NS = 1_215_648_000_000_000_000
PIECES = 5000
SETTINGS = StationSettings(
    station="rover", mode=Mode.RTK, rtk=RtkSettings(base_stream="base"), positioning={"systems": "GREJC"}
)


@pytest.fixture(scope="module")
def pieces(data_dir: Path) -> list[Piece]:
    """Base and rover merged; the base's come 120 ms after the rover's."""
    folder = data_dir / "str-2018-195"
    base, rover = folder / "week-rollover-STR24.rtcm3", folder / "week-rollover-STR17.rtcm3"
    if not base.is_file():
        pytest.skip(f"no {base}")
    late = [Piece(p.t_ns + 120_000_000, "base", p.data) for p in read_recording(base, "base", t_near_ns=T_NEAR_NS)]
    own = read_recording(rover, "rover", t_near_ns=T_NEAR_NS)
    return list(heapq.merge(own, late, key=lambda piece: piece.t_ns))[:PIECES]


def _run(pieces: list[Piece], restart_at: int | None = None, tick_ns: int | None = None) -> list[Solution]:
    books = Books()
    feed, pipeline, outputs = NavigationFeed("base", books), Pipeline(SETTINGS, (), books), list[Output]()
    last_ns = pieces[0].t_ns
    for k, piece in enumerate(pieces):
        if k == restart_at:
            pipeline = Pipeline.restore(SETTINGS, (), books, pipeline.snapshot())
        while tick_ns is not None and last_ns + tick_ns < piece.t_ns:
            last_ns += tick_ns
            outputs += pipeline.advance(last_ns)
        last_ns = piece.t_ns
        if piece.stream == "base":
            feed.receive(piece.data, piece.t_ns)
        else:
            outputs += pipeline.receive(piece.data, piece.t_ns)
    outputs += pipeline.finish(pieces[-1].t_ns + 2_000_000_000)
    return [output for output in outputs if isinstance(output, Solution)]


def _series(solutions: list[Solution]) -> list[tuple[int, str, bytes]]:
    return [
        (s.t_gps_ns, s.status, b"" if s.position_ecef_m is None else s.position_ecef_m.tobytes()) for s in solutions
    ]


def test_epochs_wait_for_their_base(pieces: list[Piece]) -> None:
    solutions = _run(pieces)
    fixed = [s for s in solutions if s.status is Status.RTK_FIXED]
    assert len(fixed) > 0.95 * len(solutions)
    assert sum(s.correction_age_s == 0.0 for s in fixed) > 0.98 * len(fixed)


def test_however_time_is_told_and_wherever_it_is_taken_over(pieces: list[Piece]) -> None:
    undisturbed = _series(_run(pieces))
    assert _series(_run(pieces, tick_ns=37_000_000)) == undisturbed
    assert _series(_run(pieces, restart_at=2500)) == undisturbed
