"""What quality control costs: its share of an epoch's time, PPP float, kinematic, GPS + Galileo, at 30 s.

Run as ``python -m tests.benchmarks.control``. The whole is a filter's step with its report; the control is its test of
the observations and the report, timed alone on the same epochs in the same run.
"""

import time
from typing import NamedTuple

import numpy as np
from tests.benchmarks.positioning import data_dir
from tests.benchmarks.table import Row, format_rows

from plumbline.config import PositioningSettings
from plumbline.files.rinex_clock import read_clocks
from plumbline.files.rinex_observation import read_observations
from plumbline.files.sp3 import read_sp3
from plumbline.positioning import warm_up
from plumbline.positioning.control import Scene, Usual, control
from plumbline.positioning.facts import StationFacts
from plumbline.positioning.ppp import EpochQuality, step_with_quality
from plumbline.positioning.ppp_noise import tuning_of
from plumbline.positioning.precise_source import PreciseSource
from plumbline.positioning.state import PppState, initial_state
from plumbline.quality.report import quality_report
from plumbline.records import Solution

EPOCHS, REPEATS, ASKED = 480, 5, 0.30
_SETTINGS = PositioningSettings(systems="GE")


class _Done(NamedTuple):
    solution: Solution
    state: PppState
    found: EpochQuality


def _scene(done: _Done) -> tuple[object, ...]:
    """Arguments of the test of an epoch: sizes and findings as the filter had them."""
    state, found = done.state, done.found
    arc_of = {int(satellite): i for i, satellite in enumerate(state.arcs["satellite"])}
    arc_of_pair = np.array([arc_of.get(int(satellite), -1) for satellite in found.pairs["satellite"]], np.int64)
    active = np.flatnonzero(np.diag(state.p) > 0.0)
    scene = Scene(
        found.kind, found.rows, found.pairs, state.arcs, arc_of_pair, state.levels, done.solution.t_gps_ns
    )  # fmt: skip
    return (
        np.ascontiguousarray(state.p[np.ix_(active, active)]), np.ascontiguousarray(found.design[:, active]),
        found.innovation_m, found.variance_m2, scene, Usual(state.code_scale, state.phase_scale, False),
        tuning_of(_SETTINGS),
    )  # fmt: skip


def run() -> list[Row]:
    """Milliseconds an epoch: the whole, and the control in it; the least of several turns."""
    warm_up()
    folder = data_dir() / "esbc-2020-177"
    epochs = read_observations(next(folder.glob("*MO.rnx.gz")))[:EPOCHS]
    source = PreciseSource(
        read_sp3(sorted(folder.glob("*.SP3.gz")))[0], read_clocks(sorted(folder.glob("*.CLK.gz"))).clocks
    )
    facts, whole, part = StationFacts("ESBC", None, (0.0, 0.0, 0.2160)), np.inf, np.inf
    for _ in range(REPEATS):
        state, done = initial_state(), []
        begun = time.perf_counter()
        for epoch in epochs:
            state, solution, found = step_with_quality(state, epoch, source, _SETTINGS, facts)
            if found is not None:
                quality_report(solution, state, found, _SETTINGS)
                done.append(_Done(solution, state, found))
        whole = min(whole, time.perf_counter() - begun)
        scenes = [_scene(one) for one in done]
        begun = time.perf_counter()
        for one, scene in zip(done, scenes, strict=True):
            control(*scene)
            quality_report(one.solution, one.state, one.found, _SETTINGS)
        part = min(part, time.perf_counter() - begun)
    ours, all_ms = 1e3 * part / len(epochs), 1e3 * whole / len(epochs)
    return [Row("quality control in PPP", "the whole epoch", ours, all_ms, "ms/epoch", all_ms / ours, 1.0 / ASKED)]


if __name__ == "__main__":
    print(format_rows(run()))
