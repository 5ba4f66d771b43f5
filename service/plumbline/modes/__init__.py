"""How a station's epochs and samples become solutions and motion, one module a way.

context         what every mode is given, and what it must answer to
multirate       solutions and accelerometer samples to motion
ppp             ppp, ppp-accel
relative        rtk, rtk-network
"""

from typing import Final

from plumbline.config import Mode
from plumbline.modes.context import Context, Processor
from plumbline.modes.ppp import PppProcessor
from plumbline.modes.relative import RelativeProcessor

__all__ = ["Context", "Processor", "start"]

_PROCESSORS: Final[dict[Mode, type[PppProcessor | RelativeProcessor]]] = {
    Mode.PPP: PppProcessor,
    Mode.PPP_ACCEL: PppProcessor,
    Mode.RTK: RelativeProcessor,
    Mode.RTK_NETWORK: RelativeProcessor,
}


def start(context: Context, state: object = None) -> Processor:
    """The processor of the settings' mode, carrying on from a state of its own kind, else from nothing."""
    return _PROCESSORS[context.settings.mode](context, state)
