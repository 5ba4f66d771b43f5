"""Mode rtk-imu-loose: mode rtk's positions and velocities fused with an IMU (de Alteriis 2022).

Solutions are those of the first antenna, as in mode rtk; motion is that of the same point, at the rate of the samples,
with the platform's attitude.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from plumbline.fusion.loose_clock import at_true_times
from plumbline.fusion.loose_eskf import initial_loose_state, receive_samples, receive_solution
from plumbline.fusion.loose_state import LooseState
from plumbline.fusion.timeline import Rows
from plumbline.gps_time import NS_PER_S
from plumbline.modes.context import Context, Outcome
from plumbline.modes.instants import Instants
from plumbline.modes.navigation_rows import motion_of_local_rows
from plumbline.modes.relative import RelativeModeState, RelativeProcessor
from plumbline.modes.samples import WAITED_FOR_S, ImuSamples
from plumbline.modes.seconds import MotionSeconds, Told
from plumbline.records import InertialBlock, Solution, Status


@dataclass(slots=True)
class LooseModeState(RelativeModeState):
    """Mode rtk's, and the filter's."""

    filter: LooseState = field(default_factory=lambda: initial_loose_state(""))
    samples: ImuSamples = field(default_factory=ImuSamples)
    seconds: MotionSeconds = field(default_factory=lambda: MotionSeconds(0))


class LooseProcessor(RelativeProcessor):
    """See the module and :class:`plumbline.modes.context.Processor`."""

    state: LooseModeState

    def __init__(self, context: Context, state: object = None) -> None:
        known = isinstance(state, LooseModeState) and state.instants.n_antennas == context.settings.n_antennas
        super().__init__(context, state if known else self._fresh(context))

    def _fresh(self, context: Context) -> LooseModeState:
        settings = context.settings
        return LooseModeState(
            Instants(settings.n_antennas),
            filter=initial_loose_state(settings.station),
            seconds=MotionSeconds(round(settings.inertial.late_limit_s * NS_PER_S)),
        )

    def receive_inertial(self, block: InertialBlock) -> list[Outcome]:
        """Samples to motion."""
        state, inertial = self.state, self._context.settings.inertial
        if state.samples.breaks_off(block):
            state.filter, state.samples = initial_loose_state(state.filter.station), ImuSamples(state.samples.counters)
            state.counters["samples_broke_off_filter_begun_again"] += 1
        taken = state.samples.receive(block, inertial)
        if taken is None:
            return []
        result = receive_samples(state.filter, *taken, inertial)
        state.filter = result.state
        return self._blocks(result.rows, block.t_receive_ns)

    def _moved(self, solution: Solution, as_of_ns: int) -> list[Outcome]:
        """The solution, at its own time, into the filter; where no samples come it goes no further."""
        silent_s = self.state.samples.silent_s(as_of_ns)
        if silent_s is None or silent_s > WAITED_FOR_S:
            return [solution]
        result = receive_solution(self.state.filter, solution, self._context.settings.inertial)
        self.state.filter = result.state
        return [solution, *self._blocks(result.rows, as_of_ns)]

    def _blocks(self, rows: Rows, t_receive_ns: int) -> list[Outcome]:
        state, settings = self.state, self._context.settings
        reference = settings.reference_position_ecef_m or self._adopted()
        if reference is None:
            return []
        nodes = state.filter.timeline.nodes
        moved = at_true_times(rows.values, nodes[-1].extra.clock if nodes else None, rows.t_gps_ns)
        values = motion_of_local_rows(moved, reference, settings.inertial.lever_arms_body_m[0])
        state.seconds.put(rows.t_gps_ns, values)
        told = Told(None, Status.COASTING, "the filter has no attitude yet")
        if nodes:
            told = Told(nodes[-1].extra.t_fix_gps_ns, nodes[-1].extra.status, "")
        return [*state.seconds.due(settings.station, state.samples.interval_ns, told, t_receive_ns)]

    def begin_anew(self) -> None:
        """Mode rtk's, and the filter anew."""
        super().begin_anew()
        fresh = self._fresh(self._context)
        self.state.filter, self.state.samples, self.state.seconds = fresh.filter, fresh.samples, fresh.seconds

    @property
    def counters(self) -> Mapping[str, int]:
        """What was not used, by reason."""
        state = self.state
        return Counter(super().counters) + state.samples.counters + Counter(state.filter.timeline.counters)
