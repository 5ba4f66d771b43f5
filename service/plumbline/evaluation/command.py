"""``plumbline simulate shake-table`` and ``plumbline evaluate shake-table``.

The simulator belongs to the device side (package ``plumbline_dtu``), which a server does not need: it is imported when
the command runs, and its absence is said in words.
"""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

from tqdm import tqdm

from plumbline.errors import ConfigurationError
from plumbline.evaluation.shake_table import SCHEMES
from plumbline.evaluation.shake_table_files import AVERAGED, process_arguments, read_schemes, read_truth, result_path

Process = Callable[[Sequence[str]], int]  # `plumbline process` with these arguments; its exit code


def add_simulate(parser: argparse.ArgumentParser, process: Process) -> None:
    """Describe ``simulate``; ``process`` runs the schemes that are asked for."""
    kinds = parser.add_subparsers(required=True, metavar="WHAT")
    table = kinds.add_parser("shake-table", help="the experiment of Dai 2024: RTCM3 streams and the truth")
    table.add_argument("--seed", type=int, default=1, metavar="N")
    table.add_argument("--out", type=Path, required=True, metavar="DIR")
    table.add_argument("--schemes", nargs="*", default=(), metavar="SCHEME",
                       help="process these afterwards: all, or of " + " ".join(SCHEMES))  # fmt: skip
    table.set_defaults(run=lambda options: _simulate(options, process))


def add_evaluate(parser: argparse.ArgumentParser) -> None:
    """Describe ``evaluate``."""
    kinds = parser.add_subparsers(required=True, metavar="WHAT")
    table = kinds.add_parser("shake-table", help="table 3, spectra and amplitudes of Dai 2024, from DIR/schemes/*.csv")
    table.add_argument("folder", type=Path, metavar="DIR")
    table.add_argument("--no-figures", action="store_true", help="write no PNG")
    table.set_defaults(run=_evaluate)


def _simulate(options: argparse.Namespace, process: Process) -> int:
    try:
        from plumbline_dtu.shake_table.experiment import Experiment
        from plumbline_dtu.shake_table.write import simulate
    except ImportError as error:
        raise ConfigurationError(f"simulating wants the package plumbline-dtu (clients/dtu): {error}") from error
    schemes = _schemes(options.schemes)
    with tqdm(total=100, unit="%", disable=None, bar_format="{l_bar}{bar}| {elapsed}<{remaining}") as bar:
        simulate(Experiment(options.seed), options.out, lambda fraction: _advance(bar, fraction))
    for scheme in schemes:
        result_path(options.out, scheme).parent.mkdir(exist_ok=True)
        code = process(process_arguments(options.out, scheme))
        if code:
            return code
    return 0


def _advance(bar: "tqdm[NoReturn]", fraction: float) -> None:
    bar.update(100 * fraction - bar.n)


def _schemes(names: Sequence[str]) -> list[str]:
    """The schemes to process; an average's are its parts."""
    wanted = [name for text in names for name in text.split(",") if name]
    wanted = list(SCHEMES) if wanted == ["all"] else wanted
    unknown = [name for name in wanted if name not in SCHEMES]
    if unknown:
        raise ConfigurationError(f"no such scheme: {', '.join(unknown)}; there are {' '.join(SCHEMES)}")
    parts = {part for name in wanted for part in AVERAGED.get(name, (name,))}
    return [scheme for scheme in SCHEMES if scheme in parts]


def _evaluate(options: argparse.Namespace) -> int:
    from plumbline.evaluation.shake_table_report import report

    truth = read_truth(options.folder)
    series = read_schemes(options.folder, truth)
    if not series:
        raise ConfigurationError(f"{options.folder / 'schemes'}: no results; run `plumbline process` for the schemes")
    print(report(truth, series))
    if not options.no_figures:
        from plumbline.evaluation.shake_table_figures import write_figures

        for path in write_figures(truth, series, options.folder / "figures"):
            print(path)
    return 0
