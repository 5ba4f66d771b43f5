"""Tests over a window of epochs, for errors too small to be seen in one (Teunissen & Salzmann 1989; Teunissen 1990).

Whitened innovations of a filter are independent from epoch to epoch, so that statistics of a window add up:

* global: ``T = Σ v_kᵀ S_k⁻¹ v_k`` is χ² of ``Σ m_k`` (the recursive overall model test);
* an alternative that began at epoch l with the response ``c_k`` in the innovations has ``w = Σ c_kᵀ S_k⁻¹ v_k /
  √(Σ c_kᵀ S_k⁻¹ c_k)`` (the recursive slippage test).

The filter answers to an error ``C_k b`` of its observations: with ``X`` (n, q) the error of its predicted state per
unit of b, the response of the innovations is ``C_k − H_k X`` and after the update ``X ← Φ (X + K_k (C_k − H_k X))``,
started at zero when the error begins (Teunissen 1990, eqs 16-18).
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Window(NamedTuple):
    """Sums that forget: an epoch loses the factor ``memory`` with each that follows (1: none of it)."""

    statistic: float = 0.0  # Σ vᵀ S⁻¹ v
    degrees_of_freedom: float = 0.0
    squares: float = 0.0  # Σ weight² m: half the variance of the statistic


class Share(NamedTuple):
    """What a degree of freedom's share of a statistic usually is: mean and variance over the epochs remembered."""

    mean: float = 1.0
    variance: float = 0.0
    epochs: int = 0

    def excess(self, degrees_of_freedom: float) -> float:
        """By how much shares, over their mean, vary more than χ²'s 2/r."""
        return max(0.0, self.variance / self.mean**2 - 2.0 / degrees_of_freedom) if degrees_of_freedom > 0.0 else 0.0


def add_share(usual: Share, share: float, memory: int, most: float) -> Share:
    """What is usual after an epoch's share; one larger than ``most`` usual ones counts as that."""
    epochs = min(usual.epochs + 1, memory)
    gain = 1.0 / (epochs + 1)
    step = min(share, most * usual.mean) - usual.mean
    return Share(usual.mean + gain * step, (1.0 - gain) * (usual.variance + gain * step * step), epochs)


def add_epoch(window: Window, statistic: float, degrees_of_freedom: int, memory: float) -> Window:
    """The window after an epoch of the statistic and redundancy given."""
    return Window(
        memory * window.statistic + statistic,
        memory * window.degrees_of_freedom + degrees_of_freedom,
        memory * memory * window.squares + degrees_of_freedom,
    )


def equivalent(window: Window) -> tuple[float, float]:
    """Statistic and degrees of freedom of the χ² distribution with the window's mean and variance (Satterthwaite)."""
    if window.squares <= 0.0:
        return 0.0, 0.0
    factor = window.degrees_of_freedom / window.squares
    return window.statistic * factor, window.degrees_of_freedom * factor


@njit(cache=True)
def respond(h: Floats, c: Floats, x_response: Floats) -> Floats:
    """Response of the innovations, ``C − H X`` (m, q). ``h`` (m, n), ``c`` (m, q), ``x_response`` (n, q)."""
    return c - h @ x_response


@njit(cache=True)
def carry_response(transition: Floats, gain: Floats, x_response: Floats, response: Floats) -> Floats:
    """State response for the next epoch, ``Φ (X + K (C − H X))`` (n, q)."""
    return transition @ (x_response + gain @ response)


@njit(cache=True)
def accumulate(sums: Floats, along: Floats, size: Floats, memory: float) -> Floats:
    """Add an epoch's ``cᵀ S⁻¹ v`` and ``cᵀ S⁻¹ c`` (k,) to ``sums`` (k, 2), in place; returns the windows' w (k,)."""
    w = np.zeros(along.size)
    for i in range(along.size):
        sums[i, 0] = memory * sums[i, 0] + along[i]
        sums[i, 1] = memory * memory * sums[i, 1] + size[i]
        if sums[i, 1] > 0.0:
            w[i] = sums[i, 0] / np.sqrt(sums[i, 1])
    return w
