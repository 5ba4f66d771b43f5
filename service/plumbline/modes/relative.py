"""Modes rtk and rtk-network: positions against a base, or several; with more antennas, the platform's attitude.

An epoch waits for its base's of the same instant, and for those of the platform's other antennas, for a while.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from plumbline.config import Mode
from plumbline.fusion import FusionState
from plumbline.modes import multirate
from plumbline.modes.antennas import due_instant
from plumbline.modes.context import Context, Outcome
from plumbline.modes.instants import Instant, Instants
from plumbline.modes.platform_attitude import with_attitude
from plumbline.positioning import rtk, rtk_network
from plumbline.positioning.facts import Vector3
from plumbline.positioning.rtk_base import base_view, network_views
from plumbline.positioning.rtk_state import RtkState
from plumbline.positioning.solutions import no_position
from plumbline.quality.relative_report import relative_report
from plumbline.records import Epoch, InertialBlock, QualityReport, Solution, Status


@dataclass(slots=True)
class RelativeModeState:
    """The position filters', the fusion's, and the epochs that wait."""

    instants: Instants
    relative: RtkState = field(default_factory=RtkState)
    network: rtk_network.NetworkState = field(default_factory=rtk_network.NetworkState)
    motion: FusionState | None = None
    counters: Counter[str] = field(default_factory=Counter)


class RelativeProcessor:
    """See the module and :class:`plumbline.modes.context.Processor`."""

    def __init__(self, context: Context, state: object = None) -> None:
        self._context = context
        n = context.settings.n_antennas
        known = isinstance(state, RelativeModeState) and state.instants.n_antennas == n
        self.state = state if known and isinstance(state, RelativeModeState) else RelativeModeState(Instants(n))
        self._network = context.settings.mode is Mode.RTK_NETWORK

    def receive_epoch(self, epoch: Epoch, antenna: int) -> list[Outcome]:
        """Position an epoch, now or when what it waits for has come."""
        self.state.instants.add(epoch, antenna)
        return self.advance(epoch.t_receive_ns)

    def receive_inertial(self, block: InertialBlock) -> list[Outcome]:
        """Samples have no use here."""
        self.state.counters["inertial_not_used_in_this_mode"] += 1
        return []

    def advance(self, t_receive_ns: int) -> list[Outcome]:
        """Position, in their order, the epochs that wait no longer."""
        outcomes: list[Outcome] = []
        while (due := due_instant(self.state.instants, self._context, t_receive_ns)) is not None:
            outcomes += self._instant(*due)
        return outcomes

    def _instant(self, instant: Instant, as_of_ns: int) -> list[Outcome]:
        primary, context = instant.epochs[0], self._context
        if primary is None:
            reason = "no observations of the first antenna"
            facts = context.facts_at(instant.first)
            return self._moved(no_position(instant.first, facts, Status.NO_OBSERVATIONS, reason), as_of_ns)
        solution, report = self._positioned(primary, as_of_ns)
        if len(instant.epochs) > 1:
            solution = with_attitude(solution, instant.epochs, context.source, context.settings)
        moved = self._moved(solution, as_of_ns)
        return moved if report is None else [*moved, multirate.with_tests(report, self.state.motion)]

    def _positioned(self, epoch: Epoch, as_of_ns: int) -> tuple[Solution, QualityReport | None]:
        """Position against a base, or several, as known at a receive time; and what it is worth."""
        context, state, settings = self._context, self.state, self._context.settings
        facts, bases = context.facts_at(epoch), context.books.bases
        if self._network:
            views = network_views(bases, epoch.t_gps_ns, as_of_ns, settings.rtk)
            state.network, solution, shown = rtk_network.step(
                state.network, epoch, views, context.source, settings, facts
            )
            if shown is None:
                return solution, None
            return solution, relative_report(solution, shown.state, shown.diagnostics, settings)
        base = base_view(bases, epoch.t_gps_ns, as_of_ns, settings.rtk)
        state.relative, solution, seen = rtk.step(state.relative, epoch, base, context.source, settings, facts)
        report = None if seen is None else relative_report(solution, state.relative, seen, settings)
        return solution, report

    def _moved(self, solution: Solution, as_of_ns: int) -> list[Outcome]:
        settings, adopted = self._context.settings, self._adopted()
        self.state.motion, motions = multirate.receive_solution(self.state.motion, solution, settings, adopted)
        return [solution, *motions]

    def _adopted(self) -> Vector3 | None:
        """The reference position that the filter has adopted where the settings give none."""
        state = self.state
        return state.network.reference_position_ecef_m if self._network else state.relative.reference_position_ecef_m

    def begin_anew(self) -> None:
        """Forget all but the network's filters, which are told by their own times."""
        self.state.instants.clear()
        self.state.relative = RtkState()
        self.state.motion = None

    @property
    def counters(self) -> Mapping[str, int]:
        """What was not used, by reason."""
        return self.state.counters + self.state.instants.counters + Counter(multirate.counters_of(self.state.motion))
