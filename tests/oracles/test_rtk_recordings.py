"""Relative positioning of recorded receivers, in real time order through the whole pipeline.

Oracles: the targets asked for (fixes, scatter), the series' own median (no wrong integer hides from it: half a cycle is
nine centimetres, and every epoch for itself finds the same), and RTKLIB's fixed baseline on the same input.
"""

import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from plumbline import offline
from plumbline.config import AntennaMotion, Mode
from plumbline.positioning.solutions import rotation_at
from plumbline.records import Solution, Status

pytestmark = pytest.mark.realdata
STR_BASE_ECEF_M = (-4467074.3577, 2683011.9038, -3667008.2845)  # as the stream's own 1006 says


@dataclass(frozen=True)
class Case:
    folder: str
    base: str
    rover: str
    nav: tuple[str, ...]
    t_near_gps_ns: int
    least_fixed: float
    length_m: float


STR_NS, SC134_NS = 1_215_648_000_000_000_000, 1_454_443_200_000_000_000
STR = Case("str-2018-195", "week-rollover-STR24.rtcm3", "week-rollover-STR17.rtcm3", (), STR_NS, 0.995, 70.308)
SC134 = Case(
    "sc134-2026-037", "ROMAMSG.bin", "ROVRMSG.bin", ("SSRTEST_20260206_CORR.bin",), SC134_NS, 0.99, 175.292
)  # fmt: skip


def _process(data_dir: Path, case: Case, **rtk: object) -> list[Solution]:
    folder = data_dir / case.folder
    for name in (case.base, case.rover, *case.nav):
        if not (folder / name).is_file():
            pytest.skip(f"no {folder / name}")
    settings = offline.settings_of(
        Mode.RTK, None, 0.0, "GREJC", 10.0, AntennaMotion.KINEMATIC, "off", rtk={"base_stream": "base"} | rtk
    )
    request = offline.ProcessRequest(
        settings,
        (folder / case.rover,),
        tuple(folder / name for name in case.nav),
        t_near_gps_ns=case.t_near_gps_ns,
        base=(folder / case.base,),
    )
    return [output for output in offline.run(request) if isinstance(output, Solution)]


def _scatter(solutions: list[Solution]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Median position, and deviations of the fixed epochs from it, E N U."""
    fixed = np.array([s.position_ecef_m for s in solutions if s.status is Status.RTK_FIXED])
    median = np.median(fixed, axis=0)
    return median, (fixed - median) @ rotation_at(median).T, fixed


@pytest.mark.parametrize("case", [STR, SC134], ids=lambda case: case.folder)
@pytest.mark.parametrize("integers", ["continuous", "instantaneous"])
def test_fixed_without_a_wrong_one(data_dir: Path, case: Case, integers: str) -> None:
    solutions = _process(data_dir, case, integers=integers)
    possible = [s for s in solutions if s.status not in (Status.NO_BASE, Status.NO_EPHEMERIS, Status.NO_OBSERVATIONS)]
    fixed = [s for s in possible if s.status is Status.RTK_FIXED]
    assert len(fixed) >= case.least_fixed * len(possible)
    assert len(possible) > 0.95 * len(solutions)
    _, deviations, _ = _scatter(solutions)
    assert np.all(deviations.std(axis=0) <= [0.002, 0.002, 0.005])
    assert np.abs(deviations).max() < 0.02
    assert (fixed[0].t_gps_ns - possible[0].t_gps_ns) <= 10_000_000_000
    lengths = [np.linalg.norm([s.extras[f"baseline_{c}_m"] for c in "enu"]) for s in fixed]
    assert np.median(lengths) == pytest.approx(case.length_m, abs=0.002)
    for solution in solutions:
        assert solution.reason or solution.status is Status.RTK_FIXED


def test_base_epochs_ten_seconds_apart_are_bridged(data_dir: Path) -> None:
    """Every base epoch but each tenth withheld: fixes go on, the scatter grows no more than the sigmas say."""
    from plumbline.epochs.base_book import BaseBook

    taken, add = [], BaseBook.add

    def seldom(book: BaseBook, epoch: object) -> None:
        if epoch.t_gps_ns // 1_000_000_000 % 10 == 0:  # type: ignore[attr-defined]
            taken.append(epoch)
            add(book, epoch)  # type: ignore[arg-type]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(BaseBook, "add", seldom)
        solutions = _process(data_dir, STR)
    ages = np.array([s.correction_age_s for s in solutions if s.status is Status.RTK_FIXED])
    assert len(taken) < 150
    assert len(ages) >= 0.98 * len(solutions)
    assert ages.max() == 9.0
    _, deviations, _ = _scatter(solutions)
    sigmas = np.array(
        [
            np.sqrt(np.diag(s.covariance_enu_m2))
            for s in solutions
            if s.status is Status.RTK_FIXED and s.correction_age_s
        ]
    )
    assert np.all(deviations.std(axis=0) <= [0.003, 0.004, 0.010])
    assert np.all(deviations.std(axis=0) < 1.2 * sigmas.mean(axis=0))


def test_the_baseline_is_rtklibs(data_dir: Path, tmp_path: Path) -> None:
    folder = data_dir / STR.folder
    inputs = []
    for name, path in (("rover", STR.rover), ("base", STR.base)):
        stem = str(tmp_path / name)
        subprocess.run(
            ["convbin", "-r", "rtcm3", "-v", "3.03", "-od", "-os", "-tr", "2018/07/14", "23:50:00",
             "-o", stem + ".obs", "-n", stem + ".nav", str(folder / path)],
            check=True, capture_output=True,
        )  # fmt: skip
        inputs += [stem + ".obs", stem + ".nav"]
    out = tmp_path / "out.pos"
    position = [f"{value:.4f}" for value in STR_BASE_ECEF_M]
    subprocess.run(
        ["rnx2rtkp", "-p", "2", "-sys", "G,E,C", "-m", "10", "-f", "2", "-v", "3", "-e", "-r", *position,
         "-o", str(out), inputs[0], inputs[2], inputs[1], inputs[3]],
        check=True, capture_output=True,
    )  # fmt: skip
    rows = [line.split() for line in out.read_text().splitlines() if line[:1] not in ("%", "")]
    theirs = np.median([[float(v) for v in row[2:5]] for row in rows if row[5] == "1"], axis=0)
    ours, _, _ = _scatter(_process(data_dir, STR))
    difference = rotation_at(ours) @ (ours - theirs)
    assert np.all(np.abs(difference) < [0.002, 0.002, 0.005]), difference
