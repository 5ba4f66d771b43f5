"""A base that tells its position late: no displacement before, no jump after. Oracle: the recording's own 1006."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from plumbline.config import Mode, StationSettings
from plumbline.epochs.recording import merge, read_recording
from plumbline.epochs.stream import Books, NavigationFeed
from plumbline.gps_time import gps_ns_from_utc
from plumbline.pipeline import Pipeline
from plumbline.records import Solution, Status

NEAR = gps_ns_from_utc(datetime(2018, 7, 15, tzinfo=UTC))


@pytest.mark.realdata
def test_no_displacement_until_the_base_is_where_it_says(data_dir: Path) -> None:
    """STR17 sends its 1006 some 20 s after the start; its single-point position is 1.7 m off until then."""
    folder = data_dir / "str-2018-195"
    names = {"base": "week-rollover-STR17.rtcm3", "rover": "week-rollover-STR24.rtcm3"}
    pieces = merge([read_recording(folder / file, name, t_near_ns=NEAR) for name, file in names.items()])
    settings = StationSettings.model_validate(
        {
            "station": "rover",
            "mode": Mode.RTK,
            "reference_position_ecef_m": (-4467074.44, 2683011.85, -3667007.45),
            "rtk": {"base_stream": "base"},
        }
    )
    books = Books()
    feed, pipeline, found = NavigationFeed("base", books), Pipeline(settings, (), books), list[Solution]()
    for piece in pieces[:4000]:
        if piece.stream == "base":
            feed.receive(piece.data, piece.t_ns)
        else:
            found += [o for o in pipeline.receive(piece.data, piece.t_ns) if isinstance(o, Solution)]
    fixed = [s for s in found if s.status is Status.RTK_FIXED]
    silent = [s for s in fixed if s.displacement_enu_m is None]
    moved = np.array([s.displacement_enu_m for s in fixed if s.displacement_enu_m is not None])
    assert silent
    assert all("has not told its position" in s.reason for s in silent)
    assert len(moved) > 100
    assert np.abs(moved - np.median(moved, axis=0)).max() < 0.03
