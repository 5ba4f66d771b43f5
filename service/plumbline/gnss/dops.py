"""Dilution of precision: geometry alone, in units of the range's sigma."""

from typing import NamedTuple

import numpy as np

from plumbline.records import Floats, Ints


class Dops(NamedTuple):
    """Dilutions of precision, NaN where the geometry does not give a position."""

    pdop: float
    hdop: float
    vdop: float
    tdop: float  # of the first system's clock


def dilution_of_precision(unit_enu: Floats, clock: Ints) -> Dops:
    """Dilutions from unit vectors receiver → satellite (n, 3), east, north, up, and each satellite's clock number (n,).

    Every distinct clock number is an unknown of its own (a clock per system).
    """
    clocks, column = np.unique(clock, return_inverse=True)
    design = np.zeros((len(unit_enu), 3 + len(clocks)))
    design[:, :3] = -unit_enu
    design[np.arange(len(unit_enu)), 3 + column] = 1.0
    normal = design.T @ design
    if len(unit_enu) < normal.shape[0] or np.linalg.cond(normal) > 1e12:
        return Dops(np.nan, np.nan, np.nan, np.nan)
    q = np.diag(np.linalg.inv(normal))
    return Dops(float(np.sqrt(q[:3].sum())), float(np.sqrt(q[:2].sum())), float(np.sqrt(q[2])), float(np.sqrt(q[3])))
