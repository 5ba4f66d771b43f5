"""Compiles every kernel of this package that runs live."""

import numpy as np

from plumbline.estimation.dia_tables import Levels
from plumbline.positioning.ppp_model import MODEL_DTYPE
from plumbline.positioning.warm_up import relative
from plumbline.quality.relative_report import relative_report
from plumbline.quality.reliability import Integrity, factors, geometry, measures


def warm_up() -> None:
    """Call every kernel once with arguments of the types that the pipeline uses."""
    n, unknowns = 6, 8
    rows, ones = np.zeros(n, MODEL_DTYPE), np.ones(n)
    rows["line"] = np.linalg.qr(np.random.default_rng(1).normal(size=(n, n)))[0][:, :3]
    used, rotation = np.ones(n, np.bool_), np.eye(3)
    geometry(rows["line"], np.zeros(n, np.int64), used, rotation)
    design, position_rows = np.ones((n, unknowns)), np.eye(3, unknowns)
    measures(ones, ones, used, design, ones, position_rows, rotation, factors(Levels(), Integrity()), ones)
    relative_report(*relative())
