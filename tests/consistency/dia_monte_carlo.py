"""Prints what the tests of quality control promise and what was counted, as the tables of ``QUALITY.md`` beside it.

Run as ``python -m tests.consistency.dia_monte_carlo [draws]``; 10,000 draws unless told otherwise.
"""

import sys

from plumbline.quality.reliability import Integrity

from .dia_recursive import count_recursive
from .dia_worlds import LEVELS, WORLDS, count_alarms, count_beyond, worst_external_difference

SIZES = (0.0, 0.6, 1.0, 1.3, 2.0)
INTEGRITY = Integrity(risk=1e-3, prior=0.1)  # large enough to be counted


def alarms(n: int) -> list[str]:
    """False alarms and power."""
    rows = ["| | global test fails, clean | w-test fails, clean | errors of the MDB found | external reliability off |",
            "|---|---|---|---|---|"]  # fmt: skip
    rows.append(f"| stated | {LEVELS.significance:.2%} | {LEVELS.w_significance:.3%} | {LEVELS.power:.1%} | 0 |")
    for kind in WORLDS:
        world = kind()
        counted, off = count_alarms(world, 4 * n, n, 1001), worst_external_difference(world, 1002)
        rows.append(
            f"| {world.name} | {counted.false_alarms:.2%} | {counted.false_w:.3%} | {counted.power:.1%} | {off:.0e} |"
        )
    return rows


def slow(n: int) -> list[str]:
    """The window's tests."""
    counted = count_recursive(n, n, 1003)
    return [
        f"| 30 epochs of a filter | {counted.false_alarms:.2%} | {counted.false_w:.3%} | {counted.power:.1%} | "
        f"{counted.moved_beside_response:.1f} sigma of the mean |",
        "",
        f"The window's MDB is {1e3 * counted.mdb_of_window:.1f} mm where an epoch's is "
        f"{1e3 * counted.mdb_of_epoch:.1f} mm, mean of ten phases.",
    ]


def levels(n: int) -> list[str]:
    """How often protection levels were exceeded."""
    rows = ["| error of one observation, in MDB | stated at most | " + " | ".join(k.name for k in WORLDS) + " |",
            "|---|---|" + "---|" * len(WORLDS)]  # fmt: skip
    for size in SIZES:
        bound = INTEGRITY.risk if size == 0.0 else INTEGRITY.risk / INTEGRITY.prior
        cells = []
        for kind in WORLDS:
            horizontal, vertical = count_beyond(kind(), size, INTEGRITY, n, 1004)
            cells.append(f"{horizontal / n:.2%} / {vertical / n:.2%}")
        rows.append(f"| {size:.1f} | {bound:.1%} | " + " | ".join(cells) + " |")
    return rows


if __name__ == "__main__":
    draws = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    print("\n".join([*alarms(draws), *slow(draws), "", *levels(draws)]))
