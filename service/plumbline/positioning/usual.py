"""What is usual of a station's test statistics: how large, and what they add up to over a window.

Receivers and places differ by a factor of four in how noisy they are. Statistics are judged by what those of the same
station have been, over minutes for single observations and over hours for the sum of all.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from plumbline.estimation.dia_window import add_epoch, add_share, equivalent
from plumbline.positioning.control import Control
from plumbline.positioning.state import PppState

_SCALE_GAIN: Final = 0.05  # of single observations' usual size: a memory of 20 epochs
_SHARE_MEMORY: Final = 100  # epochs of the variance factor and its spread
_WINDOW_SHARE_MEMORY: Final = 1000  # … and of the window's
_LARGEST_RATIO: Final = 4.0  # what an epoch's variance factor counts for at most, in usual ones
_WINDOW_MEMORY: Final = 0.95  # the window's: 20 epochs


def remember(state: PppState, found: Control, degrees_of_freedom: int) -> PppState:
    """The state with an epoch's statistics taken in; ``degrees_of_freedom`` are those of what was accepted."""
    state = replace(
        state,
        phase_scale=_usual(state.phase_scale, found.phase_scale),
        code_scale=_usual(state.code_scale, found.code_scale),
    )
    if degrees_of_freedom <= 0:
        return state
    window = add_epoch(state.window, found.statistic_after / state.share.mean, degrees_of_freedom, _WINDOW_MEMORY)
    statistic, freedom = equivalent(window)
    return replace(
        state,
        share=add_share(state.share, found.statistic_after / degrees_of_freedom, _SHARE_MEMORY, _LARGEST_RATIO),
        window=window,
        window_share=add_share(state.window_share, statistic / freedom, _WINDOW_SHARE_MEMORY, _LARGEST_RATIO),
    )


def _usual(usual: float, now: float) -> float:
    return usual if np.isnan(now) else usual + _SCALE_GAIN * (now - usual)
