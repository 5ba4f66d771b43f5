"""What every mode is given, and what it must answer to."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from plumbline.config import StationSettings
from plumbline.epochs.stream import Books
from plumbline.fusion import Innovation
from plumbline.positioning.facts import StationFacts
from plumbline.positioning.satellites import SatelliteSource
from plumbline.records import Epoch, InertialBlock, Motion, QualityReport, Solution


@dataclass(frozen=True, slots=True)
class Felt:
    """What a solution says beyond what the accelerometer has felt: an innovation, and when the last input came."""

    innovation: Innovation
    t_receive_ns: int


Outcome = Solution | Motion | QualityReport | Felt


@dataclass(slots=True)
class Context:
    """A station's surroundings."""

    settings: StationSettings
    books: Books  # shared by all stations: bases, ephemerides, corrections
    source: SatelliteSource  # replaced when the station's own stream turns out to carry corrections
    facts_at: Callable[[Epoch], StationFacts]


class Processor(Protocol):
    """One mode. Inputs come in the order of their receive times; what leaves depends on them alone."""

    @property
    def state(self) -> object:
        """All that it carries from input to input: picklable, and enough for :func:`plumbline.modes.start`."""

    def receive_epoch(self, epoch: Epoch, antenna: int) -> list[Outcome]:
        """Take an epoch of the station's own antenna number ``antenna``, counted from 0."""

    def receive_inertial(self, block: InertialBlock) -> list[Outcome]:
        """Take a block of samples."""

    def advance(self, t_receive_ns: int) -> list[Outcome]:
        """Time passes: go on with what waits no longer."""

    def begin_anew(self) -> None:
        """The time base has moved: what was filtered so far belongs to another series."""

    @property
    def counters(self) -> Mapping[str, int]:
        """What was not used, by reason."""
