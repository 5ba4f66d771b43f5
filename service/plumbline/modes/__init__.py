"""How a station's epochs and samples become solutions and motion, one module a way.

context         what every mode is given, and what it must answer to
multirate       solutions and accelerometer samples to motion
ppp             ppp, ppp-accel
relative        rtk, rtk-network; with several antennas the platform's attitude
loose           rtk-imu-loose: rtk's positions with an IMU
tight           rtk-imu-tight: the antennas' phases with an IMU
instants, antennas           epochs of several antennas and of the base brought together
samples, navigation_rows, seconds   an IMU's samples on the common time line, and back to blocks of motion
"""

from collections.abc import Callable
from typing import Final

from plumbline.config import Mode
from plumbline.modes.context import Context, Processor
from plumbline.modes.loose import LooseProcessor
from plumbline.modes.ppp import PppProcessor
from plumbline.modes.relative import RelativeProcessor
from plumbline.modes.tight import TightProcessor

__all__ = ["Context", "Processor", "start"]

_PROCESSORS: Final[dict[Mode, Callable[[Context, object], Processor]]] = {
    Mode.PPP: PppProcessor,
    Mode.PPP_ACCEL: PppProcessor,
    Mode.RTK: RelativeProcessor,
    Mode.RTK_NETWORK: RelativeProcessor,
    Mode.RTK_IMU_LOOSE: LooseProcessor,
    Mode.RTK_IMU_TIGHT: TightProcessor,
}


def start(context: Context, state: object = None) -> Processor:
    """The processor of the settings' mode, carrying on from a state of its own kind, else from nothing."""
    return _PROCESSORS[context.settings.mode](context, state)
