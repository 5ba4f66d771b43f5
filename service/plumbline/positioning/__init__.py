"""Epochs to solutions: real-time precise point positioning of one antenna.

    epoch ► preprocess (signal pairs, ionosphere-free) ► satellites (orbits, clocks, biases) ► cycle_slip (arcs)
          ► ppp_model (what should have been measured) ► ppp_filter (test, update) ► solution, or the reason for none

``ppp.step(state, epoch, source, settings, facts) -> (state, solution)`` is the whole of it.
"""
