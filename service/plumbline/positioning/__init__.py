"""Epochs to solutions: real-time precise point positioning of one antenna.

    epoch ► preprocess (signal pairs, ionosphere-free) ► satellites (orbits, clocks, biases)
          ► ppp_model (what should have been measured) ► cycle_slip (arcs)
          ► ppp_noise (what to believe) ► control (what to leave out) ► ppp_filter (update)
          ► solution, or the reason for none

``ppp.step(state, epoch, source, settings, facts) -> (state, solution)`` is the whole of it.
"""

from plumbline.positioning.warm_up import warm_up

__all__ = ["warm_up"]
