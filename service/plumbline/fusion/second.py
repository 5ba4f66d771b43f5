"""The filter's run through one GPS second: samples by the compiled loop, solutions at their instants (eqs 6-8)."""

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from plumbline.config import FusionSettings
from plumbline.epochs.time_matching import grid_time_ns, nearest_grid_index
from plumbline.estimation.dia_window import Window, add_epoch
from plumbline.estimation.kalman import cholesky_lower, lower_inverse
from plumbline.fusion.control import Cause, lasting_cause, root_noncentrality
from plumbline.fusion.kernels import OUTPUTS, propagate, step_coasting
from plumbline.fusion.state import BASELINE, DISPLACEMENT, N_STATES, VELOCITY, Innovation, Measurement, Node, Second
from plumbline.gps_time import NS_PER_S
from plumbline.records import Floats, Status

UNKNOWN_VELOCITY_SIGMA_M_S: Final = 0.1  # a structure, most of the time, stands
LEAST_VELOCITY_SIGMA_M_S: Final = 2.0e-3
SLOWEST_SWAY_S: Final = 2.0  # standstill: velocity is at most this times the samples' scatter (a sway of 0.08 Hz)
UNKNOWN_BASELINE_SIGMA_M_S2: Final = 1.0  # mounting: a tenth of g at most
LEAST_BASELINE_SIGMA_M_S2: Final = 1.0e-3
BASELINE_MEMORY_S: Final = 20.0  # standstill: how far back the mean of the samples reaches
BASELINE_CORRELATION_S: Final = 1.0  # the shaking that the mean averages over is this slow
BASELINE_SETTLED_S: Final = 10.0  # until then a slow sway may hide in the baseline: no acceleration is told
LOST_SIGMA_M: Final = 2.0  # a displacement this uncertain is none
_WINDOW_MEMORY: Final = 0.95  # of the global tests: 20 solutions
FORGOTTEN_SIGMA_M: Final = 100.0  # a solution after this is a new start (beyond it, the covariance would lose digits)


class Run(NamedTuple):
    """What became of a second."""

    node: Node  # the filter after it
    t_gps_ns: list[int]  # of the rows; empty for a grid second (its rows are its grid)
    rows: Floats  # (n, 12): displacement, velocity, acceleration, displacement variance
    innovations: list[Innovation]  # of all its solutions


@dataclass(slots=True)
class _Filter:
    """A node being worked on: its arrays are its own, to be written to."""

    node: Node
    x: Floats
    p: Floats
    last: Floats
    t_gps_ns: int | None

    def frozen(self) -> Node:
        return replace(self.node, t_gps_ns=self.t_gps_ns, x=self.x, p=self.p, last_acceleration_m_s2=self.last)


def _opened(node: Node) -> _Filter:
    return _Filter(node, node.x.copy(), node.p.copy(), node.last_acceleration_m_s2.copy(), node.t_gps_ns)


def noise_of(settings: FusionSettings) -> Floats:
    """q_a m²/s³, shaking noise √s, q_u m²/s⁵, shaking drift 1/√s, q_coasting m²/s³, as the kernel takes them."""
    return np.array(
        [
            settings.acceleration_noise_m_s2_sqrt_hz**2,
            settings.shaking_noise_sqrt_s,
            settings.baseline_drift_m_s2_sqrt_s**2,
            settings.shaking_drift_sqrt_hz,
            settings.coasting_noise_m_s2_sqrt_hz**2,
        ]
    )


def run_second(second: Second, measurements: list[Measurement], settings: FusionSettings) -> Run:
    """Take a second's entry node through its samples and its solutions, both as far as they are in."""
    if second.rate == 0:
        return _run_without_samples(second, measurements, settings)
    return _run_grid(second, measurements, settings)


def index_in_second(second: Second, t_gps_ns: int) -> int:
    """The sample of a grid second that is nearest to a time; the last one for all times after."""
    return min(nearest_grid_index(t_gps_ns, second.rate) - second.second * second.rate, second.rate - 1)


def _run_grid(second: Second, measurements: list[Measurement], settings: FusionSettings) -> Run:
    samples = second.acceleration_m_s2[: second.filled]
    f = _opened(_with_baseline(_since(second), samples, second.rate))
    rows, innovations, noise = np.empty((len(samples), OUTPUTS)), [], noise_of(settings)
    at = 0
    for m in measurements:
        k = index_in_second(second, m.t_gps_ns)
        if k >= second.filled:
            break
        _propagate(f, second, at, k + 1, noise, rows)
        at = k + 1
        delta_s = (m.t_gps_ns - grid_time_ns(second.second * second.rate + k, second.rate)) * 1e-9
        innovation = _meet(f, m, delta_s, samples, second.rate, settings)
        innovations += [innovation] if innovation else []
        rows[k, DISPLACEMENT], rows[k, VELOCITY] = f.x[DISPLACEMENT], f.x[VELOCITY]
        rows[k, 6:9] = samples[k] - f.x[BASELINE]
        rows[k, 9:12] = f.p.diagonal()[DISPLACEMENT]
    _propagate(f, second, at, len(samples), noise, rows)
    return Run(_closed(f, second.rate), [], rows, innovations)


def _propagate(f: _Filter, second: Second, start: int, stop: int, noise: Floats, rows: Floats) -> None:
    """Take the filter through samples ``start`` … ``stop`` − 1."""
    if stop <= start:
        return
    first = second.second * second.rate + start
    t_first = grid_time_ns(first, second.rate)
    gap_s = 0.0 if f.t_gps_ns is None else (t_first - f.t_gps_ns) * 1e-9
    samples, out = second.acceleration_m_s2[start:stop], rows[start:stop]
    propagate(f.x, f.p, f.last, samples, max(gap_s, 0.0), 1.0 / second.rate, noise, out)
    f.t_gps_ns = grid_time_ns(first + stop - start - 1, second.rate)
    if f.node.t_solution_gps_ns is None:
        out[:, 0:6] = np.nan
        out[:, 9:12] = np.nan


def _run_without_samples(second: Second, measurements: list[Measurement], settings: FusionSettings) -> Run:
    f = _opened(second.entry)
    f.last[:] = np.nan
    times, rows, innovations = [], np.full((len(measurements), OUTPUTS), np.nan), []
    noise = noise_of(settings)
    for i, m in enumerate(measurements):
        if f.t_gps_ns is not None and m.t_gps_ns > f.t_gps_ns:
            step_coasting(f.x, f.p, (m.t_gps_ns - f.t_gps_ns) * 1e-9, noise[4], noise[2])
        f.t_gps_ns = max(m.t_gps_ns, f.t_gps_ns or m.t_gps_ns)
        innovation = _meet(f, m, 0.0, np.zeros((0, 3)), 0, settings)
        innovations += [innovation] if innovation else []
        times.append(m.t_gps_ns)
        rows[i, :6], rows[i, 9:12] = f.x[:6], f.p.diagonal()[:3]
    return Run(f.frozen(), times, rows, innovations)


def _closed(f: _Filter, rate: int) -> Node:
    """The node at the end of a second; a displacement that has become worthless is given up, the baseline kept."""
    if f.node.t_solution_gps_ns is not None and _exceeds(f.p, LOST_SIGMA_M):
        f.node = replace(
            f.node,
            t_solution_gps_ns=None,
            solution_status=Status.NO_OBSERVATIONS,
            baseline_samples=round(BASELINE_MEMORY_S * rate) if f.node.baseline_samples else 0,
            baseline_scatter_m2_s4=f.p.diagonal()[BASELINE] * (BASELINE_MEMORY_S / BASELINE_CORRELATION_S),
        )
    if f.node.t_solution_gps_ns is None:
        f.x[:6] = 0.0
        f.p[:] = 0.0
    return f.frozen()


def _exceeds(p: Floats, sigma_m: float) -> bool:
    return bool(p.diagonal()[DISPLACEMENT].max() > sigma_m**2)


# ------------------------------------------------------------------------------------------- baseline at standstill


def baseline_is_settled(node: Node, t_gps_ns: int) -> bool:
    """Whether the baseline has been learnt for long enough that what is left of a sample is the structure's own."""
    return node.t_baseline_gps_ns is not None and t_gps_ns - node.t_baseline_gps_ns >= BASELINE_SETTLED_S * NS_PER_S


def _since(second: Second) -> Node:
    """The node at a second's entry, with the time of the first sample that there has been."""
    valid = np.flatnonzero(~np.isnan(second.acceleration_m_s2[: second.filled, 0]))
    if second.entry.t_baseline_gps_ns is not None or len(valid) == 0:
        return second.entry
    t_first_ns = grid_time_ns(second.second * second.rate + int(valid[0]), second.rate)
    return replace(second.entry, t_baseline_gps_ns=t_first_ns)


def _with_baseline(node: Node, samples: Floats, rate: int) -> Node:
    """The baseline's mean with a second's samples, while there is no better knowledge of it than a standstill."""
    valid = samples[~np.isnan(samples[:, 0])]
    started = node.t_solution_gps_ns is not None
    if len(valid) == 0 or (started and node.baseline_samples > 0):
        return node
    n = min(node.baseline_samples, round(BASELINE_MEMORY_S * rate))
    weight = len(valid) / (n + len(valid))
    mean = node.x[BASELINE] + weight * (valid.mean(axis=0) - node.x[BASELINE]) if n else valid.mean(axis=0)
    scatter = (1.0 - weight) * node.baseline_scatter_m2_s4 + weight * ((valid - mean) ** 2).mean(axis=0)
    x, p = node.x.copy(), node.p.copy()
    x[BASELINE] = mean
    updated = replace(node, x=x, p=p, baseline_samples=n + len(valid), baseline_scatter_m2_s4=scatter)
    if started:
        p[BASELINE, :] = 0.0
        p[:, BASELINE] = 0.0
        p[BASELINE, BASELINE] = np.diag(_baseline_variance(updated, rate))
    return updated


def _baseline_variance(node: Node, rate: int) -> Floats:
    """Variance of the standstill mean: its samples' scatter over the independent stretches that it averages."""
    if node.baseline_samples == 0 or rate == 0:
        return np.full(3, UNKNOWN_BASELINE_SIGMA_M_S2**2)
    stretches = max(1.0, node.baseline_samples / rate / BASELINE_CORRELATION_S)
    return node.baseline_scatter_m2_s4 / stretches + LEAST_BASELINE_SIGMA_M_S2**2


def _start_velocity_variance(node: Node) -> Floats:
    """Variance of a velocity of zero, by how much the samples of the standstill scatter about their mean."""
    if node.baseline_samples == 0:
        return np.full(3, UNKNOWN_VELOCITY_SIGMA_M_S**2)
    return LEAST_VELOCITY_SIGMA_M_S**2 + SLOWEST_SWAY_S**2 * node.baseline_scatter_m2_s4


# ------------------------------------------------------------------------------------------- a solution


def _meet(
    f: _Filter, m: Measurement, delta_s: float, samples: Floats, rate: int, settings: FusionSettings
) -> Innovation | None:
    """Start from a solution, or update with it, or refuse it; None where there was no prediction to compare with."""
    since_ns = f.node.t_solution_gps_ns
    if since_ns is None or _exceeds(f.p, FORGOTTEN_SIGMA_M):
        _start(f, m, rate)
        return None
    innovation, gain, h = _predict_innovation(f, m, delta_s, settings)
    if innovation.nis <= settings.innovation_gate_sigma**2:
        window = add_epoch(f.node.window, innovation.nis, len(h), _WINDOW_MEMORY)
        f.node = replace(f.node, window=window)
        _update(f, m, innovation, gain, h)
        return replace(innovation, window=window)
    size_m, cause = float(np.linalg.norm(innovation.innovation_enu_m)), Cause.OUTLIER
    reason = f"GNSS is {size_m:.3f} m off the motion's prediction"
    off = (*f.node.off, (m.t_gps_ns, innovation.innovation_enu_m))
    f.node = replace(f.node, refusals=f.node.refusals + 1, refusal=reason, off=off)
    if f.node.refusals >= settings.max_refusals:
        cause = lasting_cause(since_ns, off)
        note = f"GNSS has jumped by {size_m:.3f} m, unfelt by the accelerometer" if cause is Cause.JUMP else ""
        f.node = replace(f.node, note=note, t_note_gps_ns=m.t_gps_ns, window=Window())
        elapsed_s = (m.t_gps_ns - since_ns) * 1e-9
        f.node = replace(f.node, baseline_samples=0, t_solution_gps_ns=None)
        f.node = _with_baseline(replace(f.node, x=f.x, p=f.p), samples, rate)
        f.x = f.node.x.copy()
        _start(f, m, rate, np.abs(innovation.innovation_enu_m) / max(elapsed_s, 1.0))
    return replace(innovation, applied=False, reason=reason, cause=cause, window=f.node.window)


def _start(f: _Filter, m: Measurement, rate: int, missed_velocity_m_s: Floats | float = 0.0) -> None:
    """Begin at a solution: displacement as measured, velocity about zero, the baseline of the standstill.

    ``missed_velocity_m_s`` (3,): a velocity that solutions refused so far speak of.
    """
    if f.node.baseline_samples == 0:
        f.x[BASELINE] = 0.0
    f.x[DISPLACEMENT], f.x[VELOCITY] = m.displacement_enu_m, 0.0
    f.p[:] = 0.0
    f.p[DISPLACEMENT, DISPLACEMENT] = m.covariance_enu_m2
    f.p[VELOCITY, VELOCITY] = np.diag(_start_velocity_variance(f.node) + missed_velocity_m_s**2)
    f.p[BASELINE, BASELINE] = np.diag(_baseline_variance(f.node, rate))
    _accept(f, m)


def _accept(f: _Filter, m: Measurement) -> None:
    f.node = replace(
        f.node,
        t_solution_gps_ns=m.t_gps_ns,
        solution_status=m.status,
        solution_variance_m2=m.variance_enu_m2,
        refusals=0,
        refusal="",
        off=(),
    )


def _predict_innovation(
    f: _Filter, m: Measurement, delta_s: float, settings: FusionSettings
) -> tuple[Innovation, Floats, Floats]:
    """Innovation, gain (9, 3; eq. 6) and design matrix (3, 9) of a solution ``delta_s`` after the filter's instant.

    H is [I, δ I, −δ²/2 I], eq. 3's first row over δ, so a solution between two samples needs no step of its own.
    """
    h = np.zeros((3, N_STATES))
    h[:, DISPLACEMENT], h[:, VELOCITY] = np.eye(3), delta_s * np.eye(3)
    predicted = f.x[DISPLACEMENT] + delta_s * f.x[VELOCITY]
    if not np.isnan(f.last[0]):
        h[:, BASELINE] = -0.5 * delta_s**2 * np.eye(3)
        predicted = predicted + 0.5 * delta_s**2 * (f.last - f.x[BASELINE])
    v = m.displacement_enu_m - predicted
    ph = f.p @ h.T
    s = h @ ph + m.covariance_enu_m2
    factor, _ = cholesky_lower(s)
    inverse = lower_inverse(factor)
    information = inverse.T @ inverse
    root = root_noncentrality(settings.innovation_gate_sigma, settings.test_power)
    mdb = root / np.sqrt(information.diagonal())
    return Innovation(m.t_gps_ns, v, inverse @ v, s.diagonal().copy(), True, mdb), ph @ information, h


def _update(f: _Filter, m: Measurement, innovation: Innovation, gain: Floats, h: Floats) -> None:
    """Eqs 7 and 8, the covariance in Joseph's form."""
    f.x += gain @ innovation.innovation_enu_m
    remain = np.eye(N_STATES) - gain @ h
    p = remain @ f.p @ remain.T + gain @ m.covariance_enu_m2 @ gain.T
    f.p = 0.5 * (p + p.T)
    _accept(f, m)
