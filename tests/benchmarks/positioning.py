"""PPP, float, kinematic, GPS + Galileo, a day's half at 30 s: milliseconds per epoch, net of start-up, against RTKLIB.

Run as ``python -m tests.benchmarks.positioning``. Net means: a run over all epochs less a run over the first one, so
that reading the files is in neither. The runs take turns on the same machine; the least of several counts. RTKLIB runs
as Debian's ``rnx2rtkp`` and as ``pyrtklib5``'s ``postpos``, each in its own process, with the same model switched on.
"""

import gzip
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from tests.benchmarks.table import Row, format_rows, time_row

from plumbline.config import PositioningSettings
from plumbline.files.antex import read_antex
from plumbline.files.rinex_clock import read_clocks
from plumbline.files.rinex_observation import read_observations
from plumbline.files.sp3 import read_sp3
from plumbline.gnss.antenna import build_antenna_book, find_receiver
from plumbline.positioning import warm_up
from plumbline.positioning.facts import StationFacts
from plumbline.positioning.ppp import step
from plumbline.positioning.precise_source import PreciseSource
from plumbline.positioning.state import initial_state

REPEATS = 5
_Job = Callable[[], tuple[float, float]]  # seconds over all epochs, and over the first
_JOB = "PPP float kinematic GPS + Galileo"
_CONFIGURATION = """
pos1-posmode =ppp-kine
pos1-frequency ={frequency}
pos1-soltype =forward
pos1-elmask =7
pos1-dynamics =off
pos1-tidecorr =1
pos1-ionoopt =dual-freq
pos1-tropopt =est-ztdgrad
pos1-sateph =precise
pos1-posopt1 =on
pos1-posopt2 =on
pos1-posopt3 =on
pos1-posopt4 =on
pos1-posopt5 =off
pos1-navsys =9
pos2-armode =off
out-solformat =xyz
stats-eratio1 =100
stats-eratio2 =100
stats-errphase =0.003
stats-errphaseel =0.003
stats-prnbias =0.0001
stats-prntrop =0.0001
ant1-anttype =*
file-satantfile ={antex}
file-rcvantfile ={antex}
"""
_POSTPOS = """
import sys, time
import pyrtklib5 as r
process, solution, files = r.prcopt_t(), r.solopt_t(), r.filopt_t()
r.resetsysopts()
r.loadopts(sys.argv[1], r.sysopts.ptr)
r.getsysopts(process, solution, files)
start, end = r.gtime_t(), r.gtime_t()
if sys.argv[3] != "all":
    day = r.Arr1Ddouble(6)
    for i, value in enumerate(map(float, sys.argv[3].split(","))):
        day[i] = value
    start = r.epoch2time(day)
    end = r.timeadd(start, 1.0)
names = sys.argv[4:]
begun = time.perf_counter()
r.postpos(start, end, 0.0, 0.0, process, solution, files, names, len(names), sys.argv[2], "", "")
print("seconds", time.perf_counter() - begun)
"""


def data_dir() -> Path:
    """Where the recordings are."""
    return Path(os.environ.get("PLUMBLINE_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))


def _unpack(source: Path, target: Path) -> dict[str, list[str]]:
    """Plain files for RTKLIB, by kind, in order of name."""
    found: dict[str, list[str]] = {}
    for path in sorted(source.iterdir()):
        plain = target / path.name.removesuffix(".gz")
        plain.write_bytes(gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes())
        kind = {"MO.rnx": "obs", "MN.rnx": "nav"}.get(plain.name[-6:], plain.suffix[1:].lower())
        found.setdefault(kind, []).append(str(plain))
    return found


def _ours(files: dict[str, list[str]]) -> tuple[_Job, int]:
    """A measured run, and its number of epochs beyond the first."""
    epochs = read_observations(files["obs"][0])
    source = PreciseSource(read_sp3(files["sp3"])[0], read_clocks(files["clk"]).clocks)
    calibrations = read_antex(files["atx"][0])
    book = build_antenna_book(calibrations, epochs[0].t_gps_ns, find_receiver(calibrations, "ASH701945E_M    SCIS"))
    facts, settings = StationFacts("ESBC", None, (0.0, 0.0, 0.2160), antennas=book), PositioningSettings(systems="GE")

    def run() -> tuple[float, float]:
        begun = time.perf_counter()
        state, _ = step(initial_state(), epochs[0], source, settings, facts)
        first = time.perf_counter()
        for epoch in epochs[1:]:
            state, _ = step(state, epoch, source, settings, facts)
        return time.perf_counter() - begun, first - begun

    return run, len(epochs) - 1


def _wall(command: list[str]) -> float:
    begun = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return time.perf_counter() - begun


def _rnx2rtkp(configuration: str, out: str, inputs: list[str]) -> _Job:
    command = ["rnx2rtkp", "-k", configuration, "-o", out]
    first = ["-ts", "2020/06/25", "00:00:00", "-te", "2020/06/25", "00:00:01"]
    return lambda: (_wall([*command, *inputs]), _wall([*command, *first, *inputs]))


def _postpos(configuration: str, out: str, inputs: list[str]) -> _Job:
    def seconds(span: str) -> float:
        command = [sys.executable, "-c", _POSTPOS, configuration, out, span, *inputs]
        text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        return float(text.rsplit("seconds", 1)[1])

    return lambda: (seconds("all"), seconds("2020,6,25,0,0,0"))


def run() -> list[Row]:
    """Measure all in turns; milliseconds per epoch."""
    warm_up()
    with tempfile.TemporaryDirectory() as folder:
        files = _unpack(data_dir() / "esbc-2020-177", Path(folder))
        inputs = [*files["obs"], *files["nav"], *files["sp3"], *files["clk"]]
        jobs: dict[str, _Job] = {}
        for name, frequency, peer in (("rnx2rtkp", "l1+2", _rnx2rtkp), ("pyrtklib5 postpos", "l1+l2", _postpos)):
            configuration = Path(folder) / f"{name.replace(' ', '-')}.conf"
            configuration.write_text(_CONFIGURATION.format(frequency=frequency, antex=files["atx"][0]))
            jobs[name] = peer(str(configuration), str(configuration.with_suffix(".pos")), inputs)
        ours, epochs = _ours(files)
        jobs["ours"] = ours
        least = {name: (float("inf"), float("inf")) for name in jobs}
        for _ in range(REPEATS):
            for name, job in jobs.items():
                whole, first = job()
                least[name] = min(least[name][0], whole), min(least[name][1], first)
    ms = {name: 1e3 * (whole - first) / epochs for name, (whole, first) in least.items()}
    return [
        time_row(_JOB, peer, ms["ours"], ms[peer], "ms/epoch", target=1.0) for peer in ("rnx2rtkp", "pyrtklib5 postpos")
    ]


if __name__ == "__main__":
    print(format_rows(run()))
