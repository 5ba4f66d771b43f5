"""The multirate filter over recorded series: the same functions as live, fed in the order in which the data would
come.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plumbline.config import FusionSettings
from plumbline.fusion.multirate import receive_inertial, receive_solution
from plumbline.fusion.state import FusionState, Innovation, initial_state
from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, InertialBlock, Motion, Solution, Status

Times = NDArray[np.int64]

DEFAULT_SIGMA_M = (0.005, 0.005, 0.010)  # of a converged kinematic PPP's epoch, east, north, up


@dataclass(frozen=True, slots=True)
class FusedSeries:
    """Motion at the accelerometer's rate, (n,) and (n, 3) ENU, and what the filter thought of each solution that it
    met.
    """

    t_gps_ns: Times
    displacement_enu_m: Floats
    velocity_enu_m_s: Floats
    acceleration_enu_m_s2: Floats
    sigma_displacement_enu_m: Floats
    status: tuple[Status, ...]
    innovations: tuple[Innovation, ...]
    state: FusionState

    def displacement_at(self, t_gps_ns: Times) -> Floats:
        """Displacement at given times, (m, 3), linear between samples, NaN outside the series."""
        seconds = (self.t_gps_ns - self.t_gps_ns[0]) * 1e-9
        at = (np.asarray(t_gps_ns) - self.t_gps_ns[0]) * 1e-9
        columns = [np.interp(at, seconds, self.displacement_enu_m[:, c], np.nan, np.nan) for c in range(3)]
        return np.column_stack(columns)


def fuse_series(
    t_solution_gps_ns: Times,
    displacement_enu_m: Floats,
    t_first_sample_gps_ns: int,
    sample_interval_ns: int,
    specific_force_m_s2: Floats,
    settings: FusionSettings,
    *,
    sigma_displacement_m: Floats | tuple[float, float, float] = DEFAULT_SIGMA_M,
    withheld: NDArray[np.bool_] | None = None,
    gravity_removed: bool = False,
    reference_position_ecef_m: Floats | None = None,
    station: str = "series",
    progress: Callable[[int], object] | None = None,
) -> FusedSeries:
    """Fuse a displacement series (n,), (n, 3) ENU m with samples (m, 3) m/s² in sensor axes, NaN missing.

    ``sigma_displacement_m`` is (3,) or (n, 3). Solutions where ``withheld`` (n,) is true are kept from the filter.
    ``gravity_removed``: the vertical samples read about zero at rest, as seismologists' do. ``progress`` is called
    with the number of seconds done since the last call.
    """
    state = initial_state(station, reference_position_ecef_m)
    upwards = np.array(settings.rotation_enu_from_sensor)[2]
    force = specific_force_m_s2 + (state.gravity_m_s2 * upwards if gravity_removed else 0.0)
    sigma = np.broadcast_to(np.asarray(sigma_displacement_m, float), displacement_enu_m.shape)
    kept = np.ones(len(displacement_enu_m), np.bool_) if withheld is None else ~withheld
    used = kept & np.isfinite(displacement_enu_m).all(axis=1)
    solutions = [
        _solution(station, int(t), displacement_enu_m[i], sigma[i]) for i, t in enumerate(t_solution_gps_ns) if used[i]
    ]
    blocks = list(_second_blocks(t_first_sample_gps_ns, sample_interval_ns, force))
    return _run(state, solutions, blocks, settings, progress)


def _run(
    state: FusionState,
    solutions: list[Solution],
    blocks: list[InertialBlock],
    settings: FusionSettings,
    progress: Callable[[int], object] | None,
) -> FusedSeries:
    motions: dict[int, Motion] = {}
    innovations: list[Innovation] = []
    records: list[Solution | InertialBlock] = [*solutions, *blocks]
    for record in sorted(records, key=lambda r: (r.t_receive_ns, isinstance(r, InertialBlock))):
        if isinstance(record, Solution):
            state, published, met = receive_solution(state, record, settings)
        else:
            state, published, met = receive_inertial(state, record, settings)
            if progress is not None:
                progress(1)
        motions |= {m.t_first_gps_ns: m for m in published}
        innovations += met
    ordered = [motions[t] for t in sorted(motions)]
    return _joined(ordered, innovations, state)


def _solution(station: str, t_gps_ns: int, displacement: Floats, sigma: Floats) -> Solution:
    return Solution(
        station,
        t_gps_ns,
        t_gps_ns,
        Status.PPP_FLOAT,
        "",
        displacement_enu_m=displacement,
        covariance_enu_m2=np.diag(sigma**2),
    )


def _second_blocks(t_first_ns: int, interval_ns: int, force: Floats) -> Iterator[InertialBlock]:
    """Blocks that end with a GPS second, as a device sends them, received when their last sample is taken."""
    times = t_first_ns + interval_ns * np.arange(len(force), dtype=np.int64)
    edges = np.flatnonzero(np.diff(times // NS_PER_S)) + 1
    for part in np.split(np.arange(len(force)), edges):
        yield InertialBlock(int(times[part[0]]), int(times[part[-1]]), interval_ns, force[part])


def _joined(motions: list[Motion], innovations: list[Innovation], state: FusionState) -> FusedSeries:
    def stacked(name: str) -> Floats:
        return np.concatenate([getattr(m, name) for m in motions]) if motions else np.zeros((0, 3))

    times = [m.t_first_gps_ns + m.interval_ns * np.arange(len(m.displacement_enu_m), dtype=np.int64) for m in motions]
    return FusedSeries(
        np.concatenate(times) if times else np.zeros(0, np.int64),
        stacked("displacement_enu_m"),
        stacked("velocity_enu_m_s"),
        stacked("acceleration_enu_m_s2"),
        stacked("sigma_displacement_enu_m"),
        tuple(m.status for m in motions for _ in m.displacement_enu_m),
        tuple(innovations),
        state,
    )
