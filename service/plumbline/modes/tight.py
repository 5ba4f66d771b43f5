"""Mode rtk-imu-tight: the phases and range rates of one to N antennas and an IMU in one filter (Dai 2024).

Solutions and motion are those of the IMU's centre, with the platform's attitude. An epoch waits for the samples of its
own time, so a solution leaves when both are in. Where there is none, the solution says why: the platform is not aligned
yet, the base or the satellites fail, or no samples come.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from plumbline.fusion.tight_platform import (
    Platform,
    PlatformResult,
    PlatformState,
    initial_platform_state,
    receive_platform_epochs,
    receive_platform_samples,
)
from plumbline.fusion.tight_update import TightNode
from plumbline.fusion.timeline import Rows
from plumbline.gps_time import NS_PER_S
from plumbline.modes.antennas import due_instant
from plumbline.modes.context import Context, Outcome
from plumbline.modes.instants import Instant, Instants
from plumbline.modes.navigation_rows import angle_sigmas_of, angles_of, motion_of_ecef_rows
from plumbline.modes.samples import SILENT_S, WAITED_FOR_S, ImuSamples
from plumbline.modes.seconds import MotionSeconds, Told
from plumbline.positioning.facts import StationFacts, Vector3
from plumbline.positioning.rtk import single_point_of
from plumbline.positioning.rtk_base import base_view
from plumbline.positioning.rtk_state import BaseView, no_base
from plumbline.positioning.solutions import rotation_at
from plumbline.records import Epoch, InertialBlock, Solution, Status


@dataclass(frozen=True, slots=True)
class _Waiting:
    """An instant whose samples are still to come, and the base as it was known."""

    instant: Instant
    base: BaseView


@dataclass(slots=True)
class TightModeState:
    """The platform's filter, and what waits."""

    instants: Instants
    platform: PlatformState
    seconds: MotionSeconds
    samples: ImuSamples = field(default_factory=ImuSamples)
    reference_position_ecef_m: Vector3 | None = None  # adopted where settings give none
    waiting: list[_Waiting] = field(default_factory=list)
    t_told_waiting_ns: int = 0  # up to here it was said of epochs that they wait for samples
    counters: Counter[str] = field(default_factory=Counter)


class TightProcessor:
    """See the module and :class:`plumbline.modes.context.Processor`."""

    def __init__(self, context: Context, state: object = None) -> None:
        self._context = context
        fresh = self._fresh()
        known = isinstance(state, TightModeState) and state.instants.n_antennas == fresh.instants.n_antennas
        self.state = state if known and isinstance(state, TightModeState) else fresh

    def _fresh(self) -> TightModeState:
        settings = self._context.settings
        kept_ns = round(settings.inertial.late_limit_s * NS_PER_S)
        platform = initial_platform_state(settings.station)
        return TightModeState(Instants(settings.n_antennas), platform, MotionSeconds(kept_ns))

    def receive_epoch(self, epoch: Epoch, antenna: int) -> list[Outcome]:
        """Bring an epoch together with the other antennas' and the base's; use what waits no longer."""
        self.state.instants.add(epoch, antenna)
        return self.advance(epoch.t_receive_ns)

    def advance(self, t_receive_ns: int) -> list[Outcome]:
        """Use, in their order, the instants that wait no longer."""
        outcomes: list[Outcome] = []
        while (due := due_instant(self.state.instants, self._context, t_receive_ns)) is not None:
            outcomes += self._instant(*due)
        return outcomes

    def receive_inertial(self, block: InertialBlock) -> list[Outcome]:
        """Samples to motion, and to solutions at the epochs that they reach."""
        state = self.state
        if state.samples.breaks_off(block):
            state.platform, state.samples = self._fresh().platform, ImuSamples(state.samples.counters)
            state.counters["samples_broke_off_filter_begun_again"] += 1
        taken = state.samples.receive(block, self._context.settings.inertial)
        if taken is None:
            return []
        outcomes = self._ran(receive_platform_samples(state.platform, *taken, self._platform()), block.t_receive_ns)
        return [*outcomes, *self._use_waiting(block.t_receive_ns)]

    def _platform(self) -> Platform:
        context = self._context
        facts = StationFacts(context.settings.station)
        return Platform(context.settings, context.settings.inertial, facts, context.source)

    def _instant(self, instant: Instant, as_of_ns: int) -> list[Outcome]:
        """An instant into the filter, or the reason why it gives no solution (until the samples come, at least).

        The alignment looks at the samples up to its epoch, so until there is one, instants wait for theirs.
        """
        state, context = self.state, self._context
        silent_s = state.samples.silent_s(as_of_ns)
        if silent_s is None or silent_s > WAITED_FOR_S:
            lost, state.waiting = [*(w.instant for w in state.waiting), instant], []
            words = _no_samples(silent_s)
            return [self._nothing(one.t_gps_ns, Status.NO_INERTIAL, words, as_of_ns) for one in lost]
        known = base_view(context.books.bases, instant.t_gps_ns, as_of_ns, context.settings.rtk)
        state.waiting.append(_Waiting(instant, _usable(known, instant, context)))
        outcomes = self._use_waiting(as_of_ns)
        return [*outcomes, *self._told_waiting(silent_s, as_of_ns)] if silent_s > SILENT_S else outcomes

    def _use_waiting(self, t_receive_ns: int) -> list[Outcome]:
        """What the filter can take: everything once it runs, else the instants that the samples have reached."""
        state, outcomes = self.state, list[Outcome]()
        while state.waiting and (state.platform.aligned or state.samples.reach(state.waiting[0].instant.t_gps_ns)):
            one, state.waiting = state.waiting[0], state.waiting[1:]
            outcomes += self._use(one.instant, one.base, t_receive_ns)
        return outcomes

    def _use(self, instant: Instant, base: BaseView, t_receive_ns: int) -> list[Outcome]:
        running = bool(self.state.platform.aligned)
        result = receive_platform_epochs(self.state.platform, instant.epochs, base, self._platform())
        outcomes, platform = self._ran(result, t_receive_ns), result.state
        if not running:
            words = platform.reason or f"aligned: {platform.aligned}"
            return [*outcomes, self._nothing(instant.t_gps_ns, Status.ALIGNING, words, t_receive_ns)]
        if platform.reason:
            status = Status.NO_BASE if base.epoch is None else Status.TOO_FEW_SATELLITES
            words = base.reason or platform.reason
            return [*outcomes, self._nothing(instant.t_gps_ns, status, words, t_receive_ns)]
        return outcomes

    def _told_waiting(self, silent_s: float, as_of_ns: int) -> list[Outcome]:
        """Word of each epoch that waits for samples; the first time that they fail, of all since the last sample."""
        state = self.state
        timeline = state.platform.tight.timeline
        known_ns = max([state.t_told_waiting_ns, *(node.t_gps_ns for node in timeline.nodes[-1:])])
        waiting = [m.t_gps_ns for m in timeline.measurements] + [w.instant.t_gps_ns for w in state.waiting]
        times = sorted(t_ns for t_ns in waiting if t_ns > known_ns)
        state.t_told_waiting_ns = max([known_ns, *times])
        return [self._nothing(t_ns, Status.NO_INERTIAL, _no_samples(silent_s), as_of_ns) for t_ns in times]

    def _nothing(self, t_gps_ns: int, status: Status, reason: str, as_of_ns: int) -> Solution:
        return Solution(self._context.settings.station, t_gps_ns, as_of_ns, status, reason)

    # ----------------------------------------------------------------------------------------- what leaves

    def _ran(self, result: PlatformResult, t_receive_ns: int) -> list[Outcome]:
        """The platform's new state, its solutions and its motion."""
        state = self.state
        state.platform = result.state
        reference = self._reference()
        if reference is None:
            words = "integers not resolved yet, and no reference position is set"
            return [self._nothing(node.t_gps_ns, Status.ALIGNING, words, t_receive_ns) for node in result.updated]
        solutions = [self._solution(node, reference, t_receive_ns) for node in result.updated]
        return [*solutions, *self._blocks(result.rows, reference, t_receive_ns)]

    def _reference(self) -> Vector3 | None:
        """The reference position; without a setting the IMU's first one that rests on resolved integers."""
        state, nodes = self.state, self.state.platform.tight.timeline.nodes
        given = self._context.settings.reference_position_ecef_m
        first = next((node for node in nodes if node.extra.status is Status.RTK_FIXED), None)
        if given is None and state.reference_position_ecef_m is None and first is not None:
            x, y, z = first.nav[:3].tolist()
            state.reference_position_ecef_m = (x, y, z)
        return given or state.reference_position_ecef_m

    def _solution(self, node: TightNode, reference: Vector3, t_receive_ns: int) -> Solution:
        """The filter's state after an epoch was applied."""
        enu, nav = rotation_at(np.array(reference)), node.nav
        angles = angles_of((enu @ nav[6:15].reshape(3, 3))[None])
        return Solution(
            self._context.settings.station, node.t_gps_ns, t_receive_ns, node.extra.status,
            "" if node.extra.status is Status.RTK_FIXED else "integers not resolved",
            node.extra.n_satellites,
            position_ecef_m=nav[0:3].copy(),
            displacement_enu_m=enu @ (nav[0:3] - np.array(reference)),
            covariance_enu_m2=enu @ node.p[0:3, 0:3] @ enu.T,
            velocity_enu_m_s=enu @ nav[3:6],
            extras={"rows": float(node.extra.n_rows)},
            attitude_rad=angles[0],
            sigma_attitude_rad=angle_sigmas_of(angles, (enu @ node.p[6:9, 6:9] @ enu.T)[None])[0],
        )  # fmt: skip

    def _blocks(self, rows: Rows, reference: Vector3, t_receive_ns: int) -> list[Outcome]:
        state, nodes = self.state, self.state.platform.tight.timeline.nodes
        state.seconds.put(rows.t_gps_ns, motion_of_ecef_rows(rows.values, reference))
        told = Told(None, Status.COASTING, state.platform.reason)
        if nodes:
            told = Told(nodes[-1].extra.t_gnss_gps_ns, nodes[-1].extra.status, state.platform.reason)
        return [*state.seconds.due(self._context.settings.station, state.samples.interval_ns, told, t_receive_ns)]

    def begin_anew(self) -> None:
        """Everything but the reference position."""
        fresh = self._fresh()
        self.state.instants.clear()
        self.state.waiting = []
        self.state.platform, self.state.seconds, self.state.samples = fresh.platform, fresh.seconds, fresh.samples

    @property
    def counters(self) -> Mapping[str, int]:
        """What was not used, by reason."""
        state = self.state
        of_filter = Counter(state.platform.tight.timeline.counters)
        return state.counters + state.instants.counters + state.samples.counters + of_filter


def _no_samples(silent_s: float | None) -> str:
    return f"no samples of the IMU {'yet' if silent_s is None else f'for {silent_s:.0f} s'}"


def _usable(base: BaseView, instant: Instant, context: Context) -> BaseView:
    """The base if it can serve, else none and the reason."""
    rtk = context.settings.rtk
    if base.epoch is None:
        return base
    age_s = (instant.t_gps_ns - base.epoch.t_gps_ns) / NS_PER_S
    if abs(age_s) > rtk.max_base_age_s:
        return no_base(
            base.station, f"last data of base {base.station} {age_s:.0f} s ago, limit {rtk.max_base_age_s:.0f} s"
        )
    if rtk.moving_base:
        return replace(base, position_ecef_m=single_point_of(base.epoch, context.source))
    if base.position_ecef_m is None:
        return no_base(base.station, f"position of base {base.station} not known: neither 1005/1006 nor a setting")
    return base
