"""Modes ppp and ppp-accel: precise point positioning, and the accelerometer's samples where the mode has them."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from plumbline.config import Mode
from plumbline.fusion import FusionState
from plumbline.modes import multirate
from plumbline.modes.context import Context, Outcome
from plumbline.positioning import ppp
from plumbline.positioning.state import PppState
from plumbline.quality.report import quality_report
from plumbline.records import Epoch, InertialBlock


@dataclass(slots=True)
class PppModeState:
    """The position filter's and the fusion's."""

    position: PppState = field(default_factory=PppState)
    motion: FusionState | None = None
    counters: Counter[str] = field(default_factory=Counter)


class PppProcessor:
    """See the module and :class:`plumbline.modes.context.Processor`."""

    def __init__(self, context: Context, state: object = None) -> None:
        self._context = context
        self.state = state if isinstance(state, PppModeState) else PppModeState()

    def receive_epoch(self, epoch: Epoch, antenna: int) -> list[Outcome]:
        """Position an epoch at once."""
        state, settings = self.state, self._context.settings
        state.position, solution, found = ppp.step_with_quality(
            state.position, epoch, self._context.source, settings.positioning, self._context.facts_at(epoch)
        )
        adopted = state.position.reference_position_ecef_m
        state.motion, motions = multirate.receive_solution(state.motion, solution, settings, adopted)
        reports = [] if found is None else [quality_report(solution, state.position, found, settings.positioning)]
        return [solution, *motions, *(multirate.with_tests(report, state.motion) for report in reports)]

    def receive_inertial(self, block: InertialBlock) -> list[Outcome]:
        """Samples to motion, in mode ppp-accel."""
        state, settings = self.state, self._context.settings
        if settings.mode is not Mode.PPP_ACCEL:
            state.counters["inertial_not_used_in_this_mode"] += 1
            return []
        adopted = state.position.reference_position_ecef_m
        state.motion, motions = multirate.receive_inertial(state.motion, block, settings, adopted)
        return [*motions]

    def advance(self, t_receive_ns: int) -> list[Outcome]:
        """Nothing waits."""
        return []

    def begin_anew(self) -> None:
        """Keep the reference position alone."""
        self.state.position = PppState(reference_position_ecef_m=self.state.position.reference_position_ecef_m)
        self.state.motion = None

    @property
    def counters(self) -> Mapping[str, int]:
        """What was not used, by reason."""
        return self.state.counters + Counter(multirate.counters_of(self.state.motion))
