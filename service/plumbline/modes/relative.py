"""Modes rtk and rtk-network: positions against a base, or several.

An epoch waits for its base's of the same instant, for a while.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from plumbline.config import Mode
from plumbline.fusion import FusionState
from plumbline.modes import multirate
from plumbline.modes.context import Context, Outcome
from plumbline.positioning import rtk, rtk_network
from plumbline.positioning.facts import Vector3
from plumbline.positioning.rtk_base import base_view, due_until_ns, network_due_until_ns, network_views
from plumbline.positioning.rtk_state import RtkState
from plumbline.quality.relative_report import relative_report
from plumbline.records import Epoch, InertialBlock, QualityReport, Solution


@dataclass(slots=True)
class RelativeModeState:
    """The position filters', the fusion's, and the epochs that wait for their base."""

    relative: RtkState = field(default_factory=RtkState)
    network: rtk_network.NetworkState = field(default_factory=rtk_network.NetworkState)
    motion: FusionState | None = None
    waiting: list[Epoch] = field(default_factory=list)
    counters: Counter[str] = field(default_factory=Counter)


class RelativeProcessor:
    """See the module and :class:`plumbline.modes.context.Processor`."""

    n_antennas = 1

    def __init__(self, context: Context, state: object = None) -> None:
        self._context = context
        self.state = state if isinstance(state, RelativeModeState) else RelativeModeState()
        self._network = context.settings.mode is Mode.RTK_NETWORK

    def receive_epoch(self, epoch: Epoch, antenna: int) -> list[Outcome]:
        """Position an epoch, now or when its base's has come."""
        self.state.waiting.append(epoch)
        return self.advance(epoch.t_receive_ns)

    def receive_inertial(self, block: InertialBlock) -> list[Outcome]:
        """Samples have no use here."""
        self.state.counters["inertial_not_used_in_this_mode"] += 1
        return []

    def advance(self, t_receive_ns: int) -> list[Outcome]:
        """Position, in their order, the epochs that wait for their base no longer."""
        due, settings = network_due_until_ns if self._network else due_until_ns, self._context.settings
        outcomes: list[Outcome] = []
        while self.state.waiting:
            epoch = self.state.waiting[0]
            as_of_ns = due(self._context.books.bases, epoch, t_receive_ns, settings.rtk)
            if as_of_ns is None:
                break
            self.state.waiting = self.state.waiting[1:]
            solution, report = self._positioned(epoch, as_of_ns)
            outcomes += self._moved(solution)
            if report is not None:
                outcomes.append(multirate.with_tests(report, self.state.motion))
        return outcomes

    def _positioned(self, epoch: Epoch, as_of_ns: int) -> tuple[Solution, QualityReport | None]:
        """Position against a base, or several, as known at a receive time; and what it is worth."""
        context, state, settings = self._context, self.state, self._context.settings
        facts, bases = context.facts_at(epoch), context.books.bases
        if self._network:
            views = network_views(bases, epoch.t_gps_ns, as_of_ns, settings.rtk)
            state.network, solution = rtk_network.step(state.network, epoch, views, context.source, settings, facts)
            return solution, None
        base = base_view(bases, epoch.t_gps_ns, as_of_ns, settings.rtk)
        state.relative, solution, seen = rtk.step(state.relative, epoch, base, context.source, settings, facts)
        report = None if seen is None else relative_report(solution, state.relative, seen, settings)
        return solution, report

    def _moved(self, solution: Solution) -> list[Outcome]:
        settings, adopted = self._context.settings, self._reference()
        self.state.motion, motions = multirate.receive_solution(self.state.motion, solution, settings, adopted)
        return [solution, *motions]

    def _reference(self) -> Vector3 | None:
        """The reference position that the filter has adopted where the settings give none."""
        state = self.state
        return state.network.reference_position_ecef_m if self._network else state.relative.reference_position_ecef_m

    def begin_anew(self) -> None:
        """Forget all but the network's filters, which are told by their own times."""
        self.state.waiting.clear()
        self.state.relative = RtkState()
        self.state.motion = None

    @property
    def counters(self) -> Mapping[str, int]:
        """What was not used, by reason."""
        return self.state.counters + Counter(multirate.counters_of(self.state.motion))
