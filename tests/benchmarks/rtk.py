"""RTK, kinematic, 1 Hz, two frequencies: milliseconds per epoch, net of reading, against RTKLIB on the same streams.

Run as ``python -m tests.benchmarks.rtk``. Two inputs: a simulated sky of some forty satellites above the mask, and the
recording ``str-2018-195`` (where it is). RTKLIB reads both as ``convbin`` turns them into RINEX, and runs as Debian's
``rnx2rtkp`` and as ``pyrtklib5``'s ``postpos``, each in its own process; net means all epochs less the first alone, so
that reading is in neither. Fixed epochs are printed beside.
"""

import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tests.benchmarks.table import Row, format_rows, time_row

from plumbline.config import PositioningSettings, RtkSettings, StationSettings
from plumbline.epochs.recording import read_recording
from plumbline.epochs.stream import Books, NavigationFeed
from plumbline.gnss.earth_frames import ecef_from_geodetic
from plumbline.gps_time import NS_PER_S, utc_from_gps
from plumbline.positioning import rtk
from plumbline.positioning.broadcast_source import BroadcastSource
from plumbline.positioning.facts import StationFacts
from plumbline.positioning.rtk_state import BaseView
from plumbline.quality.relative_report import relative_report
from plumbline.records import Epoch, Status
from plumbline_dtu.simulation.constellation import Constellation
from plumbline_dtu.simulation.station import StationPlan, simulate_station

REPEATS = 5
_MASK_DEG = 10
_SIMULATED_NS = 1_383_900_000 * NS_PER_S
_SIMULATED_S = 300
_CONFIGURATION = """
pos1-posmode =kinematic
pos1-frequency ={frequency}
pos1-soltype =forward
pos1-elmask ={mask}
pos1-dynamics =off
pos1-ionoopt =brdc
pos1-tropopt =saas
pos1-sateph =brdc
pos1-navsys ={systems}
pos2-armode =continuous
pos2-gloarmode =off
pos2-bdsarmode =on
pos2-arthres =3
out-solformat =xyz
ant2-postype =xyz
ant2-pos1 ={x}
ant2-pos2 ={y}
ant2-pos3 ={z}
"""
_POSTPOS = """
import sys, time
import pyrtklib5 as r
process, solution, files = r.prcopt_t(), r.solopt_t(), r.filopt_t()
r.resetsysopts()
r.loadopts(sys.argv[1], r.sysopts.ptr)
r.getsysopts(process, solution, files)
def moment(text):
    day = r.Arr1Ddouble(6)
    for i, value in enumerate(map(float, text.split(","))):
        day[i] = value
    return r.epoch2time(day)
start, end = (moment(text) for text in sys.argv[3:5])
names = sys.argv[5:]
begun = time.perf_counter()
r.postpos(start, end, 0.0, 0.0, process, solution, files, names, len(names), sys.argv[2], "", "")
print("seconds", time.perf_counter() - begun)
"""


@dataclass(frozen=True, slots=True)
class _Input:
    """Two streams of one session, decoded, and what RTKLIB needs to read them."""

    name: str
    rover: Path
    base: Path
    epochs: list[tuple[Epoch, Epoch]]  # rover, base, of the same instant
    books: Books
    base_position_ecef_m: np.ndarray
    systems: str
    systems_rtklib: int


def _epochs_of(path: Path, t_near_ns: int, books: Books, stream: str) -> dict[int, Epoch]:
    """Epochs of a recording by time; its ephemerides go into the books."""
    feed, found = NavigationFeed(stream, books), dict[int, Epoch]()
    for piece in read_recording(path, stream, t_near_ns=t_near_ns):
        feed.receive(piece.data, piece.t_ns)
        if stream in books.bases:
            found |= {epoch.t_gps_ns: epoch for epoch in books.bases[stream].epochs[-3:]}
    return found


def _input(name: str, rover: Path, base: Path, t_near_ns: int, systems: str, systems_rtklib: int) -> _Input:
    books = Books()
    theirs, ours = _epochs_of(base, t_near_ns, books, "base"), _epochs_of(rover, t_near_ns, books, "rover")
    position = books.bases["base"].descriptions[-1][1].position_ecef_m
    both = sorted(t for t in set(ours) & set(theirs) if abs(t - t_near_ns) < 86_400 * NS_PER_S)
    return _Input(
        name, rover, base, [(ours[t], theirs[t]) for t in both], books, np.array(position), systems, systems_rtklib
    )


def _simulated(folder: Path) -> _Input:
    """Base and rover a metre apart under a sky of three systems and BeiDou's geosynchronous satellites."""
    sky, paths = Constellation(_SIMULATED_NS, "GEC", geosynchronous=True), []
    for number, east_m in enumerate((0.0, 0.99)):
        x, y, z = (ecef_from_geodetic(0.3896, 1.9923, 60.0) + np.array([0.0, 0.0, east_m])).tolist()
        plan = StationPlan(f"s{number}", (x, y, z), station_id=number + 1, seed=number + 1)
        sent = simulate_station(plan, sky, _SIMULATED_NS, _SIMULATED_NS + _SIMULATED_S * NS_PER_S)
        path = folder / f"simulated{number}.rtcm3"
        path.write_bytes(b"".join(data for _, data in sent))
        paths.append(path)
    return _input("simulated sky", paths[1], paths[0], _SIMULATED_NS, "GEC", 1 + 8 + 32)


def _recorded() -> _Input | None:
    data = Path(os.environ.get("PLUMBLINE_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
    rover, base = (data / "str-2018-195" / f"week-rollover-STR{number}.rtcm3" for number in (17, 24))
    if not rover.is_file():
        return None
    return _input("str-2018-195", rover, base, 1_215_648_000 * NS_PER_S, "GEJC", 1 + 8 + 16 + 32)


def _ours(given: _Input, quality_control: str = "on") -> tuple[Callable[[], float], list[int]]:
    """A measured run, with the quality report where control is on; the list gets the number of fixed epochs."""
    settings = StationSettings(
        station="rover",
        positioning=PositioningSettings(
            systems=given.systems, elevation_mask_deg=_MASK_DEG, quality_control=quality_control
        ),
        rtk=RtkSettings(),
    )
    source = BroadcastSource(given.books.ephemerides, given.books.corrections, settings.positioning)
    facts, fixed = StationFacts("rover"), [0, 0]

    def run() -> float:
        state, fixed[0], fixed[1] = rtk.initial_state(), 0, 0
        begun = 0.0
        for k, (rover, base) in enumerate(given.epochs):
            if k == 1:
                begun = time.perf_counter()
            view = BaseView("base", base, given.base_position_ecef_m)
            state, solution, seen = rtk.step(state, rover, view, source, settings, facts)
            if seen is not None and quality_control == "on":
                relative_report(solution, state, seen, settings)
            fixed[0] += solution.status is Status.RTK_FIXED
            fixed[1] = max(fixed[1], solution.n_satellites)
        return time.perf_counter() - begun

    return run, fixed


def _rinex(given: _Input, folder: Path) -> list[str]:
    """RINEX files that ``convbin`` makes of the streams: observations of rover and base, then navigation."""
    first = utc_from_gps(given.epochs[0][0].t_gps_ns)
    observations, navigation = [], []
    for name, path in (("rover", given.rover), ("base", given.base)):
        stem = str(folder / f"{given.name.replace(' ', '-')}-{name}")
        subprocess.run(
            ["convbin", "-r", "rtcm3", "-v", "3.03", "-od", "-os", "-tr", f"{first:%Y/%m/%d}", f"{first:%H:%M:%S}",
             "-o", stem + ".obs", "-n", stem + ".nav", str(path)],
            check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        observations.append(stem + ".obs")
        navigation.append(stem + ".nav")
    return [*observations, *navigation]


def _calendar(t_gps_ns: int) -> tuple[str, str]:
    """A GPS time as a calendar date in GPS time: for the command line, and comma-separated."""
    days, rest = divmod(t_gps_ns // NS_PER_S, 86_400)
    day = np.datetime64("1980-01-06") + np.timedelta64(days, "D")
    y, m, d = str(day).split("-")
    clock = (rest // 3600, rest // 60 % 60, rest % 60)
    plain = ":".join(f"{part:02d}" for part in clock)
    return f"{y}/{m}/{d} {plain}", ",".join((y, m, d, *map(str, clock)))


def _theirs(given: _Input, folder: Path) -> dict[str, tuple[Callable[[], float], Path]]:
    """Measured runs of RTKLIB, and where each writes its positions."""
    inputs = _rinex(given, folder)
    first, last = given.epochs[0][0].t_gps_ns, given.epochs[-1][0].t_gps_ns
    (start, start_c), (once, once_c), (end, end_c) = (_calendar(t) for t in (first, first + NS_PER_S // 2, last))
    jobs: dict[str, tuple[Callable[[], float], Path]] = {}
    for name, frequency in (("rnx2rtkp", "l1+2"), ("pyrtklib5 postpos", "l1+l2")):
        x, y, z = given.base_position_ecef_m.tolist()
        configuration = folder / f"{name}-{given.name}.conf".replace(" ", "-")
        configuration.write_text(
            _CONFIGURATION.format(frequency=frequency, mask=_MASK_DEG, systems=given.systems_rtklib, x=x, y=y, z=z)
        )
        out = configuration.with_suffix(".pos")
        if name == "rnx2rtkp":

            def plain(until: str, configuration: Path = configuration, out: Path = out) -> float:
                begun = time.perf_counter()
                subprocess.run(
                    ["rnx2rtkp", "-k", str(configuration), "-o", str(out), "-ts", *start.split(), "-te", *until.split(),
                     *inputs], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                )  # fmt: skip
                return time.perf_counter() - begun

            jobs[name] = (lambda plain=plain: -plain(once) + plain(end)), out
        else:

            def bound(until: str, configuration: Path = configuration, out: Path = out) -> float:
                command = [sys.executable, "-c", _POSTPOS, str(configuration), str(out), start_c, until, *inputs]
                text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
                return float(text.rsplit("seconds", 1)[1])

            jobs[name] = (lambda bound=bound: -bound(once_c) + bound(end_c)), out
    return jobs


def _fixed(path: Path) -> tuple[int, int]:
    """Fixed and all epochs of one of RTKLIB's position files."""
    with contextlib.suppress(OSError):
        quality = [line.split()[5] for line in path.read_text().splitlines() if line[:1] not in ("%", "")]
        return quality.count("1"), len(quality)
    return 0, 0


def run() -> list[Row]:
    """Measure all in turns; milliseconds per epoch."""
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for given in filter(None, (_simulated(folder), _recorded())):
            (ours, fixed), (without, _) = _ours(given), _ours(given, "off")
            peers, least = _theirs(given, folder), {"ours": float("inf"), "without": float("inf")}
            for _ in range(REPEATS):
                least["ours"], least["without"] = min(least["ours"], ours()), min(least["without"], without())
                for peer, (job, _) in peers.items():
                    least[peer] = min(least.get(peer, float("inf")), job())
            ours_ms = 1e3 * least["ours"] / (len(given.epochs) - 1)
            without_ms = 1e3 * least["without"] / (len(given.epochs) - 1)
            name_of_job = f"RTK {given.name}, quality control and report"
            rows.append(time_row(name_of_job, "without", ours_ms, without_ms, "ms/epoch", target=0.7))
            for peer, (_, out) in peers.items():
                theirs, count = _fixed(out)  # after the week crossing RTKLIB gives no more positions
                print(f"{given.name}: fixed {fixed[0]}/{len(given.epochs)}, {peer} {theirs}/{count}", file=sys.stderr)
                job_name = f"RTK {given.name}, {fixed[1]} satellites, two frequencies"
                peer_ms = 1e3 * least[peer] / max(count - 1, 1)
                rows.append(time_row(job_name, peer, ours_ms, peer_ms, "ms/epoch", target=1 / 0.3))
    return rows


if __name__ == "__main__":
    print(format_rows(run()))
