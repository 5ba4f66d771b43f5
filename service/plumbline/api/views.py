"""Records and stored rows in the forms of the API."""

import hashlib
import math
import time
from typing import Any, Final, Literal

import numpy as np

from plumbline.alerts.quantities import DATA_QUANTITIES
from plumbline.api import schemas
from plumbline.api.units import (
    column,
    degrees_and_height,
    from_si,
    iso,
    iso_all,
    iso_or_none,
    scaled,
    unit_of_quantity,
)
from plumbline.gps_time import NS_PER_S, gps_ns_from_unix_ns
from plumbline.records import AlertEvent, Floats, Motion, Solution, StationStatus, Threshold
from plumbline.store import AlertRow, Device, MotionSeries, StationRow

AXES: Final = ("east", "north", "up")
ANGLES: Final = ("roll", "pitch", "heading")
VECTORS: Final = (("", "_mm"), ("velocity_", "_mm_s"), ("acceleration_", "_mm_s2"))
NO_WORD_AFTER_S: Final = 20.0  # beyond a station's own limit: then it is its worker that is silent


def station_view(row: StationRow, status: StationStatus | None) -> schemas.StationOut:
    """A station with its status."""
    settings = row.settings
    values = settings.model_dump()
    device = values.pop("device")
    has_token = device.pop("token") is not None
    position = settings.reference_position_ecef_m
    latitude, longitude, height = degrees_and_height(position) if position else (None, None, None)
    return schemas.StationOut(
        **values,
        device=schemas.DeviceOut(**device, has_token=has_token),
        latitude_deg=latitude,
        longitude_deg=longitude,
        height_m=height,
        version=row.version,
        created=iso(row.created_gps_ns),
        changed=iso(row.changed_gps_ns),
        status=status_view(settings.station, status, settings.silent_after_s),
    )


def status_view(station: str, status: StationStatus | None, silent_after_s: float | None = None) -> schemas.StatusOut:
    """A status; of a station that nothing was ever heard of: waiting. With a limit, an old status means silence."""
    if status is None:
        return schemas.StatusOut(station=station, state="waiting", reason="nothing received yet")
    state, reason = status.state, status.reason
    if silent_after_s is not None:
        age_s = (gps_ns_from_unix_ns(time.time_ns()) - status.t_receive_ns) / NS_PER_S
        if age_s > silent_after_s + NO_WORD_AFTER_S:
            state, reason = "silent", f"no word from the station's worker for {age_s:.0f} s; last: {reason or state}"
    return schemas.StatusOut(
        station=station,
        state=state if state in ("waiting", "receiving", "silent") else "waiting",
        reason=reason,
        time=iso(status.t_receive_ns),
        last_epoch=iso_or_none(status.last_epoch_gps_ns),
        solution_status=status.solution_status,
        n_satellites=status.n_satellites,
        counters=dict(status.counters),
    )


def _axes(prefix: str, unit: str, vector: Floats | None, digits: int) -> dict[str, float | None]:
    numbers = (None,) * 3 if vector is None else vector.tolist()
    return {f"{prefix}{axis}{unit}": scaled(number, 1e3, digits) for axis, number in zip(AXES, numbers, strict=True)}


def _sigmas(covariance: Floats | None) -> dict[str, float | None]:
    variances = (None,) * 3 if covariance is None else covariance.diagonal().tolist()
    sigmas = [None if v is None or not v >= 0.0 else math.sqrt(v) for v in variances]
    return {f"sigma_{axis}_mm": scaled(sigma, 1e3, 2) for axis, sigma in zip(AXES, sigmas, strict=True)}


def _angles(attitude_rad: Floats | None, sigmas_rad: Floats | None) -> dict[str, float | None]:
    """Angles of one instant, degrees."""
    nothing = (None,) * 3
    values = nothing if attitude_rad is None else np.degrees(attitude_rad).tolist()
    sigmas = nothing if sigmas_rad is None else np.degrees(sigmas_rad).tolist()
    named = {f"{name}_deg": scaled(value, 1.0, 5) for name, value in zip(ANGLES, values, strict=True)}
    return named | {f"sigma_{name}_deg": scaled(value, 1.0, 5) for name, value in zip(ANGLES, sigmas, strict=True)}


def solution_view(solution: Solution) -> dict[str, Any]:
    """A solution as :class:`schemas.SolutionOut`'s fields (a dictionary: lists of them are long)."""
    position = solution.position_ecef_m
    place: tuple[float | None, ...] = (None, None, None)
    if position is not None and all(map(math.isfinite, position)):
        x, y, z = position.tolist()
        place = degrees_and_height((x, y, z))
    return {
        "station": solution.station,
        "time": iso(solution.t_gps_ns),
        "status": solution.status.value,
        "reason": solution.reason,
        "n_satellites": solution.n_satellites,
        "systems": solution.systems,
        **_axes("", "_mm", solution.displacement_enu_m, 2),
        **_sigmas(solution.covariance_enu_m2),
        **_axes("velocity_", "_mm_s", solution.velocity_enu_m_s, 2),
        "latitude_deg": place[0],
        "longitude_deg": place[1],
        "height_m": place[2],
        "zenith_delay_mm": scaled(solution.zenith_delay_m, 1e3, 2),
        "receiver_clock_ns": scaled(solution.receiver_clock_s, 1e9, 3),
        "correction_age_s": scaled(solution.correction_age_s),
        "pdop": scaled(solution.pdop),
        **_angles(solution.attitude_rad, solution.sigma_attitude_rad),
        "extras": {name: scaled(value, 1.0, 9) for name, value in sorted(solution.extras.items())},
    }


def _columns(source: Motion | MotionSeries, step: int = 1) -> dict[str, list[float | None]]:
    vectors = (source.displacement_enu_m, source.velocity_enu_m_s, source.acceleration_enu_m_s2)
    columns = {
        f"{prefix}{axis}{unit}": column(vector[::step, i])
        for (prefix, unit), vector in zip(VECTORS, vectors, strict=True)
        for i, axis in enumerate(AXES)
    }
    sigma = source.sigma_displacement_enu_m
    columns |= {f"sigma_{axis}_mm": column(sigma[::step, i]) for i, axis in enumerate(AXES)}
    return columns | _angle_columns(source, step)


def _angle_columns(source: Motion | MotionSeries, step: int) -> dict[str, list[float | None]]:
    """Columns of angles, degrees, where the source has them."""
    parts = (("", source.attitude_rad), ("sigma_", source.sigma_attitude_rad))
    return {
        f"{prefix}{name}_deg": column(np.degrees(values[::step, i]), 1.0, 5)
        for prefix, values in parts
        if values is not None
        for i, name in enumerate(ANGLES)
    }


def motion_view(motion: Motion, step: int = 1) -> dict[str, Any]:
    """A live block, every ``step``-th sample."""
    return {
        "station": motion.station,
        "time": iso(motion.t_first_gps_ns),
        "interval_s": motion.interval_ns * step / NS_PER_S,
        "status": motion.status.value,
        "reason": motion.reason,
        "revision": motion.revision,
        **_columns(motion, step),
    }


def attitude_view(output: Solution | Motion) -> dict[str, Any]:
    """The attitude alone, of a solution or of the last sample of a block."""
    attitude, sigmas, t_gps_ns = output.attitude_rad, output.sigma_attitude_rad, 0
    if isinstance(output, Motion):
        t_gps_ns = output.t_first_gps_ns + (len(output.displacement_enu_m) - 1) * output.interval_ns
        attitude, sigmas = (None if part is None else part[-1] for part in (attitude, sigmas))
    else:
        t_gps_ns = output.t_gps_ns
    return {
        "station": output.station,
        "time": iso(t_gps_ns),
        "status": output.status.value,
        **_angles(attitude, sigmas),
    }


def next_start(series: MotionSeries) -> str | None:
    """Where to read on, rounded down to what ISO 8601 carries here, so that the next part misses nothing."""
    t_gps_ns = series.next_start_gps_ns
    return None if t_gps_ns is None else iso(t_gps_ns - t_gps_ns % 1000)


def series_view(series: MotionSeries) -> dict[str, Any]:
    """A stored series as :class:`schemas.MotionOut`'s fields."""
    view: dict[str, Any] = {
        "station": series.station,
        "bucket_s": series.bucket_ns / NS_PER_S,
        "next_start": next_start(series),
        "time": iso_all(series.t_gps_ns),
        "count": series.count.tolist(),
        **_columns(series),
    }
    if series.summary is not None:
        kinds = (("min", series.summary.minimum), ("max", series.summary.maximum), ("rms", series.summary.rms))
        for kind, values in kinds:
            for i, (prefix, unit) in enumerate(VECTORS):
                for j, axis in enumerate(AXES):
                    view[f"{prefix}{axis}_{kind}{unit}"] = column(values[:, 3 * i + j])
    view["blocks"] = [
        {
            "time": iso(block.t_first_gps_ns),
            "n": block.n,
            "interval_s": block.interval_ns / NS_PER_S,
            "status": block.status,
            "reason": block.reason,
            "revision": block.revision,
        }
        for block in series.blocks
    ]
    return view


def threshold_view(threshold: Threshold) -> schemas.ThresholdOut:
    """A threshold in the API's units."""
    quantity = threshold.quantity
    return schemas.ThresholdOut(
        threshold_id=threshold.threshold_id,
        station=threshold.station,
        quantity=quantity,
        level=from_si(quantity, threshold.level),
        unit=unit_of_quantity(quantity)[1],
        severity=threshold.severity,
        on_delay_s=threshold.on_delay_s,
        off_delay_s=threshold.off_delay_s,
        dead_band=from_si(quantity, threshold.dead_band),
        enabled=threshold.enabled,
    )


def _value(quantity: str, value: float | None) -> float | None:
    return scaled(None if value is None else from_si(quantity, value), 1.0, 9)


def _kind(quantity: str) -> Literal["motion", "data"]:
    return "data" if quantity in DATA_QUANTITIES else "motion"


def alert_view(alert: AlertRow) -> schemas.AlertOut:
    """An alert in the API's units."""
    quantity = alert.quantity
    return schemas.AlertOut(
        alert_id=alert.alert_id,
        station=alert.station,
        threshold_id=alert.threshold_id,
        kind=_kind(quantity),
        quantity=quantity,
        unit=unit_of_quantity(quantity)[1],
        severity=alert.severity,
        state=alert.state,
        level=from_si(quantity, alert.level),
        value=_value(quantity, alert.value),
        text=alert.text,
        onset=iso(alert.t_onset_gps_ns),
        active_since=iso(alert.t_active_gps_ns),
        acknowledged_at=iso_or_none(alert.t_acknowledged_gps_ns),
        acknowledged_by=alert.acknowledged_by,
        cleared_at=iso_or_none(alert.t_cleared_gps_ns),
        history=[
            schemas.NoteOut.model_validate(
                {
                    "time": iso(note.t_gps_ns),
                    "kind": note.kind,
                    "by": note.by,
                    "text": note.text,
                    "value": _value(quantity, note.value),
                }
            )
            for note in alert.history
        ],
    )


def alert_event_view(event: AlertEvent) -> dict[str, Any]:
    """A live alert event as :class:`schemas.AlertEventOut`'s fields."""
    return {
        "alert_id": event.alert_id,
        "station": event.station,
        "threshold_id": event.threshold_id,
        "kind": _kind(event.quantity),
        "quantity": event.quantity,
        "unit": unit_of_quantity(event.quantity)[1],
        "severity": event.severity.value,
        "state": event.state.value,
        "level": from_si(event.quantity, event.level),
        "value": _value(event.quantity, event.value),
        "text": event.text,
        "time": iso(event.t_gps_ns),
        "onset": iso(event.t_onset_gps_ns),
    }


def device_id(identity: str) -> str:
    """A short name of a device's identity that fits into an address."""
    return hashlib.sha256(identity.encode("utf-8", "surrogatepass")).hexdigest()[:16]


def device_view(device: Device) -> schemas.UnknownDevice:
    """A device that was not known."""
    return schemas.UnknownDevice(
        device_id=device_id(device.identity),
        identity=device.identity,
        address=device.address,
        first_seen=iso(device.first_seen_gps_ns),
        last_seen=iso(device.last_seen_gps_ns),
        attempts=device.attempts,
        reason=device.reason,
        station=device.station,
    )
