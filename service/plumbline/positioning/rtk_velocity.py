"""Velocity from between-receiver single differences of Doppler (or the rover's own, where the base sends none)."""

from typing import Final

import numpy as np

from plumbline.positioning.rtk_control import snoop
from plumbline.positioning.state import Records
from plumbline.records import Floats

_W_LIMIT: Final = 4.0
_MIN_ROWS: Final = 5


def velocity_of(rows: Records) -> Floats | None:
    """Velocity of the rover against a base at rest, Earth-fixed (3,), m/s; None where the Dopplers do not tell it.

    A range rate is ``−line · v`` plus the drift of the receivers' clocks, one for all signals.
    """
    weight = rows["range_rate_weight"]
    with_base = ~np.isnan(rows["base_range_rate_m_s"])
    if with_base.any():
        weight = np.where(with_base, weight, 0.0)
    if np.count_nonzero(weight) < _MIN_ROWS:
        return None
    one_clock = np.zeros(rows.size, np.int64)
    found = snoop(
        rows["line"], rows["range_rate_oc_m_s"], weight, one_clock, 1, _W_LIMIT**2, rows.size // 4
    )  # fmt: skip
    velocity: Floats = found.b_m
    return velocity if found.regular and found.degrees_of_freedom >= 1.0 else None
