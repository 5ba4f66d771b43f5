"""Solutions and inertial samples → motion: displacement, velocity, acceleration at the accelerometer's rate.

``multirate`` (Wang 2023, eqs 1-8) takes inertial blocks and solutions in the order in which they were received and
gives one-second blocks of motion; a late solution is applied at its own time. ``offline`` runs the same filter over
series.
"""

from plumbline.fusion.multirate import receive_inertial, receive_solution
from plumbline.fusion.state import FusionResult, FusionState, Innovation, initial_state
from plumbline.fusion.warm_up import warm_up

__all__ = [
    "FusionResult",
    "FusionState",
    "Innovation",
    "initial_state",
    "receive_inertial",
    "receive_solution",
    "warm_up",
]
