"""Blocks of motion from a second's run: rows to records, sigma and status."""

from typing import Final

import numpy as np

from plumbline.config import FusionSettings
from plumbline.fusion.second import Run, baseline_is_settled
from plumbline.fusion.state import FusionState, Node, Second
from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, Motion, Status

_NOTE_NS: Final = 60 * NS_PER_S  # how long a new start's reason stands with the motion
_NO_BASELINE: Final = "no acceleration yet: the sensor's bias is being learnt"


def motions_of(
    state: FusionState, second: Second, run: Run, t_receive_ns: int, rows_from_ns: int, settings: FusionSettings
) -> list[Motion]:
    """The block of a grid second; of a second of GNSS alone, a block of one sample for each solution from a time on.

    There is no acceleration until the baseline has settled: before, it is the sensor's bias as much as the structure's.
    """
    if second.rate:
        first_ns = second.second * NS_PER_S
        interval_ns = NS_PER_S // second.rate
        end_ns = first_ns + (second.rate - 1) * interval_ns
        status, reason = _status(state, run.node, end_ns, settings)
        rows = run.rows
        if not baseline_is_settled(run.node, end_ns):
            rows = rows.copy()
            rows[:, 6:9] = np.nan
            reason = reason or _NO_BASELINE
        return [_motion(state, second, first_ns, interval_ns, rows, run.node, status, reason, t_receive_ns)]
    motions = []
    for k, t_ns in enumerate(run.t_gps_ns):
        if t_ns >= rows_from_ns:
            status, reason = _status(state, run.node, t_ns, settings)
            row = run.rows[k : k + 1]
            motions.append(_motion(state, second, t_ns, NS_PER_S, row, run.node, status, reason, t_receive_ns))
    return motions


def _motion(
    state: FusionState,
    second: Second,
    t_first_ns: int,
    interval_ns: int,
    rows: Floats,
    node: Node,
    status: Status,
    reason: str,
    t_receive_ns: int,
) -> Motion:
    return Motion(
        station=state.station,
        t_first_gps_ns=t_first_ns,
        t_receive_ns=t_receive_ns,
        interval_ns=interval_ns,
        displacement_enu_m=rows[:, 0:3],
        velocity_enu_m_s=rows[:, 3:6],
        acceleration_enu_m_s2=rows[:, 6:9],
        sigma_displacement_enu_m=np.sqrt(rows[:, 9:12] + node.solution_variance_m2),
        status=status,
        reason=reason,
        revision=second.revision,
    )


def _status(state: FusionState, node: Node, t_ns: int, settings: FusionSettings) -> tuple[Status, str]:
    """What a block's displacement rests on, and why if not on a solution."""
    why = f": {state.no_solution}" if state.no_solution else ""
    if node.t_solution_gps_ns is None:
        return Status.NO_OBSERVATIONS, "no displacement from GNSS yet" + why
    if node.refusals:
        return Status.REJECTED, node.refusal
    gap_s = (t_ns - node.t_solution_gps_ns) / NS_PER_S
    if gap_s > settings.coasting_after_s:
        return Status.COASTING, f"no displacement from GNSS for {gap_s:.0f} s" + why
    if node.note and t_ns - node.t_note_gps_ns < _NOTE_NS:
        return node.solution_status, node.note
    return node.solution_status, ""
