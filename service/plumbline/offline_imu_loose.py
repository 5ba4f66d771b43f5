"""`plumbline process --mode rtk-imu-loose --positions`: a receiver's positions and the samples of an IMU beside it.

The filter runs forward over both, as it does live. The series that is written is the smoothed one, in
which every row also knows what came later, or with ``--forward`` what the filter said at the time.
"""

import csv
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Final

import numpy as np

from plumbline.config import InertialSettings
from plumbline.errors import ConfigurationError
from plumbline.files.imu import even_times, read_imu
from plumbline.files.position_log import read_position_log
from plumbline.fusion.loose_eskf import initial_loose_state, receive_samples, receive_solution
from plumbline.fusion.loose_lag import velocity_lag_s
from plumbline.fusion.loose_state import Innovation, LooseState
from plumbline.gnss.earth_frames import ecef_from_geodetic, geodetic_from_ecef, rotation_enu_from_ecef
from plumbline.gps_time import NS_PER_S
from plumbline.offline_imu import COLUMNS, ImuRequest, csv_row
from plumbline.offline_imu_outages import Outages
from plumbline.offline_imu_series import ForwardSeries, Piece, SmoothedSeries
from plumbline.records import Floats, Ints, Solution

_LAG_SIGMA_S: Final = 0.005  # of the velocities' age, to believe it


def run_loose(request: ImuRequest, report: Callable[[float], None] = lambda fraction: None) -> str:
    """Fuse positions with the samples, write the CSV and return the figures of the run in words."""
    times, samples = imu_samples(request)
    if request.position_log is None:
        raise ConfigurationError("mode rtk-imu-loose wants --positions")
    solutions = read_position_log(request.position_log)
    notes, inertial = _with_velocity_delay(request, solutions)
    frame = _Frame(_reference(request, solutions), inertial)
    outages = Outages(request.outages_s, solutions)
    state, innovations = initial_loose_state("process"), list[Innovation]()
    forward, smooth = ForwardSeries(), SmoothedSeries(inertial)
    with request.output.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)

        def write(name: str, pieces: Sequence[Piece], chosen: bool) -> None:
            for piece in pieces:
                outages.add(name, piece.t_gps_ns, partial(frame.antennas_ecef_m, piece))
                writer.writerows(frame.csv_rows(piece) if chosen else ())

        for first, last, due in _shares(times, outages.kept):
            result = receive_samples(state, times[first:last], samples[first:last], inertial)
            state, rows = result.state, [result.rows]
            innovations += result.innovations
            for solution in due:
                result = receive_solution(state, solution, inertial)
                state, rows = result.state, [*rows, result.rows]
                innovations += result.innovations
            write("filter alone", forward.receive(state, rows), not request.smooth)
            if request.smooth:
                write("smoothed", smooth.receive(state), True)
            report(last / times.size)
        if request.smooth:
            write("smoothed", smooth.finish(state), True)
    return "\n".join([*notes, *_figures(state, innovations), *outages.figures()])


# ------------------------------------------------------------------------------------------------ inputs


def imu_samples(request: ImuRequest) -> tuple[Ints, Floats]:
    """Times (n,) and samples (n, 6) of a table in body axes, stamps evened out, the time offset added."""
    series = read_imu(request.imu, request.imu_format)
    if not np.isfinite(series.angular_rate_rad_s).all():
        raise ConfigurationError(f"{request.imu}: no angular rates")
    turn = np.array(request.inertial.rotation_body_from_sensor)
    samples = np.hstack([series.specific_force_m_s2 @ turn.T, series.angular_rate_rad_s @ turn.T])
    return even_times(series.t_gps_ns) + round(request.inertial.inertial_time_offset_s * NS_PER_S), samples


def _with_velocity_delay(request: ImuRequest, solutions: Sequence[Solution]) -> tuple[list[str], InertialSettings]:
    """What was found of the velocities' age, in words, and the settings with it."""
    if not request.find_velocity_delay:
        return [], request.inertial
    lag_s, sigma_s = velocity_lag_s(solutions)
    if sigma_s > _LAG_SIGMA_S:
        return [], request.inertial
    found = request.inertial.model_copy(update={"velocity_delay_s": lag_s})
    return [f"velocities are those of {lag_s:.3f} s before their positions (σ {sigma_s:.4f} s)"], found


def _shares(times: Ints, solutions: Sequence[Solution]) -> Iterator[tuple[int, int, list[Solution]]]:
    """Samples a second, and the solutions of that second."""
    bounds = np.searchsorted(times, np.arange(times[0], times[-1] + NS_PER_S, NS_PER_S))
    at = 0
    for first, last in zip(bounds, [*bounds[1:].tolist(), times.size], strict=True):
        until_ns, due = times[last - 1], []
        while at < len(solutions) and (solutions[at].t_gps_ns <= until_ns or last == times.size):
            due.append(solutions[at])
            at += 1
        yield int(first), int(last), due


def _reference(request: ImuRequest, solutions: Sequence[Solution]) -> Floats:
    """The reference position, ECEF; without a setting, the first position."""
    given = request.settings.reference_position_ecef_m
    first = next((s.position_ecef_m for s in solutions if s.position_ecef_m is not None), None)
    if given is None and first is None:
        raise ConfigurationError("no position in the input")
    return np.array(given if given is not None else first, float)


# ------------------------------------------------------------------------------------------------ outputs


class _Frame:
    """Where the antenna is, and the CSV's rows."""

    def __init__(self, reference_ecef_m: Floats, inertial: InertialSettings) -> None:
        place = geodetic_from_ecef(reference_ecef_m)
        self._reference, self._enu = reference_ecef_m, rotation_enu_from_ecef(place[0], place[1])
        self._arm = np.array(inertial.lever_arms_body_m[0])

    def antenna_ecef_m(self, row: Floats) -> Floats:
        """Position (3,) of the antenna of a row of :mod:`plumbline.fusion.inertial_run`."""
        local = rotation_enu_from_ecef(row[0], row[1])
        out: Floats = ecef_from_geodetic(row[0], row[1], row[2]) + local.T @ (row[6:15].reshape(3, 3) @ self._arm)
        return out

    def antennas_ecef_m(self, piece: Piece) -> Floats:
        """Positions (n, 3) of the antenna."""
        return np.array([self.antenna_ecef_m(row) for row in piece.rows]).reshape(-1, 3)

    def csv_rows(self, piece: Piece) -> Iterator[list[str]]:
        """Rows of the CSV."""
        for t_ns, row in zip(piece.t_gps_ns.tolist(), piece.rows, strict=True):
            position = self.antenna_ecef_m(row)
            displacement = self._enu @ (position - self._reference)
            rotation = row[6:15].reshape(3, 3)
            yield csv_row(t_ns, piece.status_at(t_ns), 0, displacement, position, row, rotation, np.eye(3), "")


def _figures(state: LooseState, innovations: Sequence[Innovation]) -> list[str]:
    """What the run says of itself."""
    used = [i for i in innovations if i.used]
    if not used:
        why = ", ".join(f"{k} {n}" for k, n in state.timeline.counters.items())
        return [f"no attitude was found: {why or 'nothing moved while positions came'}"]
    lines = [f"aligned: {state.aligned}", f"fixes used {len(used)} of {len(innovations)}"]
    clock = state.timeline.nodes[-1].extra.clock
    if clock is not None:
        lines.append(f"samples' clock: {clock.offset_s:+.4f} s at the end, drifting {1e6 * clock.drift:+.0f} µs/s")
    for words, values in (("one-step prediction", [i.value for i in used]), ("filtered", [i.left for i in used])):
        rms = np.sqrt(np.nanmean(np.array(values)[:, :3] ** 2, axis=0))
        lines.append(f"{words} against GNSS, RMS E N U: {rms[0]:.4f} {rms[1]:.4f} {rms[2]:.4f} m")
    return [*lines, *(f"{reason}: {n}" for reason, n in state.timeline.counters.items())]
