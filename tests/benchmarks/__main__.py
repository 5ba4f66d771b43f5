"""`make bench`: every benchmark of this folder, one table of ratios."""

import importlib
import pkgutil
import sys
from pathlib import Path

from tests.benchmarks.table import format_rows

HELPERS = {"table", "__main__"}


def main() -> int:
    """Run all of them, or those named on the command line."""
    names = sys.argv[1:] or sorted(m.name for m in pkgutil.iter_modules([str(Path(__file__).parent)]))
    rows = []
    for name in names:
        if name not in HELPERS:
            print(f"{name} …", file=sys.stderr, flush=True)
            rows += importlib.import_module(f"tests.benchmarks.{name}").run()
    print(format_rows(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
