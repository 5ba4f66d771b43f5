"""Rows of a navigation filter (:mod:`plumbline.fusion.inertial_run`) as a station's motion: east, north, up, angles."""

import numpy as np

from plumbline.fusion.inertial_run import ROW_ACCELERATION, ROW_ATTITUDE_COVARIANCE, ROW_POSITION_COVARIANCE
from plumbline.gnss.earth_frames import ecef_from_geodetic, rotation_enu_from_ecef
from plumbline.positioning.facts import Vector3
from plumbline.positioning.solutions import rotation_at
from plumbline.records import Floats

VELOCITY = slice(3, 6)


def motion_of_ecef_rows(rows: Floats, reference: Vector3) -> Floats:
    """Motion (n, 18) of the IMU's centre, of rows (n, 51) of the Earth-fixed mechanisation.

    Columns: displacement from ``reference`` m, velocity m/s, acceleration m/s², sigma of the displacement m, each east,
    north, up; roll, pitch, heading rad and their sigmas.
    """
    enu = rotation_at(np.array(reference))
    turned = _turned(rows, enu)
    displacement = (rows[:, 0:3] - np.array(reference)) @ enu.T
    return _motion(rows, displacement, turned, enu @ rows[:, 6:15].reshape(-1, 3, 3), enu)


def motion_of_local_rows(rows: Floats, reference: Vector3, arm_body_m: Vector3) -> Floats:
    """The same of the local mechanisation (latitude, longitude, height; east, north, up), at a lever arm's point."""
    enu = rotation_at(np.array(reference))
    rotations = rows[:, 6:15].reshape(-1, 3, 3)
    arms = rotations @ np.array(arm_body_m)
    places = np.array([
        ecef_from_geodetic(row[0], row[1], row[2]) + rotation_enu_from_ecef(row[0], row[1]).T @ arm
        for row, arm in zip(rows, arms, strict=True)
    ]).reshape(-1, 3)  # fmt: skip
    displacement = (places - np.array(reference)) @ enu.T
    return _motion(rows, displacement, _turned(rows, np.eye(3)), rotations, np.eye(3))


def angles_of(rotations: Floats) -> Floats:
    """Roll, pitch, heading (n, 3), rad, of ``rotation_enu_from_body`` (n, 3, 3); heading 0…2π."""
    heading = np.arctan2(rotations[:, 0, 1], rotations[:, 1, 1]) % (2.0 * np.pi)
    pitch = np.arcsin(np.clip(rotations[:, 2, 1], -1.0, 1.0))
    return np.column_stack([np.arctan2(-rotations[:, 2, 0], rotations[:, 2, 2]), pitch, heading])


def angle_sigmas_of(angles: Floats, covariances: Floats) -> Floats:
    """Sigmas (n, 3) of roll, pitch, heading, of the covariances (n, 3, 3) of ψ about east, north, up.

    The partials are those of :func:`plumbline.fusion.rotations.angle_partials`.
    """
    pitch, heading = angles[:, 1], angles[:, 2]
    partials = np.zeros((len(angles), 3, 3))
    sh, ch, tp, cp = np.sin(heading), np.cos(heading), np.tan(pitch), np.cos(pitch)
    partials[:, 0, 0], partials[:, 0, 1] = sh / cp, ch / cp
    partials[:, 1, 0], partials[:, 1, 1] = ch, -sh
    partials[:, 2, 0], partials[:, 2, 1], partials[:, 2, 2] = tp * sh, tp * ch, -1.0
    variances = np.einsum("nij,njk,nik->ni", partials, covariances, partials)
    sigmas: Floats = np.sqrt(np.maximum(variances, 0.0))
    return sigmas


def _turned(rows: Floats, enu: Floats) -> tuple[Floats, Floats]:
    """Velocity and acceleration (n, 3) in east, north, up."""
    return rows[:, VELOCITY] @ enu.T, rows[:, ROW_ACCELERATION:] @ enu.T


def _motion(
    rows: Floats, displacement: Floats, turned: tuple[Floats, Floats], rotations: Floats, enu: Floats
) -> Floats:  # fmt: skip
    def covariances(at: int) -> Floats:
        blocks = rows[:, at : at + 9].reshape(-1, 3, 3)
        result: Floats = enu @ blocks @ enu.T
        return result

    angles = angles_of(rotations)
    variances = np.einsum("nii->ni", covariances(ROW_POSITION_COVARIANCE))
    return np.hstack([
        displacement, *turned, np.sqrt(np.maximum(variances, 0.0)),
        angles, angle_sigmas_of(angles, covariances(ROW_ATTITUDE_COVARIANCE)),
    ])  # fmt: skip
