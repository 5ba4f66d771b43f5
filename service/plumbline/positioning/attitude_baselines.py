"""Attitude of a platform from its own antennas: short baselines of known length, resolved within one epoch.

The primary antenna is the base of every auxiliary one. Integers are chosen with what is known of the platform: among
the nearest integer vectors of each baseline (C-LAMBDA's idea: Teunissen 2010, J Geod 84:433-446) the set that, with the
length of every baseline and the shape that the antennas make together, is the likeliest. It is believed when its
posterior probability among all sets is high.

How much the measurements are worth is taken from themselves where they are worse than the settings say (antennas among
walls): codes are weighed by their own scatter, and a set that fits badly leaves others more of a chance. Where an
accelerometer has levelled the platform, all but the heading is known beforehand: a set that tilts it is none.

Body axes are right (x), forward (y), up (z); ``rotation_enu_from_body = R_z(−heading) R_x(pitch) R_y(roll)``. With two
antennas the rotation about their line is unknown: the angle that it belongs to is NaN.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from plumbline.config import StationSettings
from plumbline.estimation.ambiguity_candidates import nearest
from plumbline.positioning.gather import mask_rad_of, select_rows
from plumbline.positioning.rtk_arcs import update_arcs
from plumbline.positioning.rtk_changes import NO_CHANGE_TEST
from plumbline.positioning.rtk_control import snoop
from plumbline.positioning.rtk_filter import accumulate, estimate
from plumbline.positioning.rtk_fix import references_of, sines_of_arcs
from plumbline.positioning.rtk_model import Place, fill_model, place_of, satellites_of
from plumbline.positioning.rtk_observations import single_difference_rows
from plumbline.positioning.rtk_state import N_CORE, POSITION, RtkState
from plumbline.positioning.satellites import SatelliteSource
from plumbline.records import Epoch, Floats, Ints

LENGTH_SIGMA_M: Final = 0.003  # of the antennas' places on the platform, and of their phase centres
MIN_CONFIDENCE: Final = 0.999
_CANDIDATES: Final = 400
_REACH: Final = 60.0  # squared norms beyond the best that a length might still make up for
_PER_BASELINE: Final = 6  # candidates that take part in the joint choice
_CODE_W_LIMIT: Final = 4.0
_UNKNOWN_RAD: Final = math.radians(10.0)  # an angle less certain than this is not given


@dataclass(frozen=True, slots=True)
class Upright:
    """What is known of the platform's tilt: where up is in body axes, (3,), and how well."""

    up_body: Floats
    sigma_rad: float


#: Platforms stand roughly upright: all that is known about a lone line.
ROUGHLY_UPRIGHT: Final = Upright(np.array([0.0, 0.0, 1.0]), math.radians(20.0))


@dataclass(frozen=True, slots=True)
class Baseline:
    """Candidates for the vector from the primary to one auxiliary antenna, likeliest first."""

    vectors_enu_m: Floats  # (k, 3)
    costs: Floats  # (k,) squared norms: integers, length
    covariance_enu_m2: Floats  # (3, 3) of each, integers known
    degrees: int  # of freedom of the squared norms
    float_enu_m: Floats  # (3,)
    n_satellites: int
    reason: str = ""  # why there are none


@dataclass(frozen=True, slots=True)
class Attitude:
    """A platform's attitude at one epoch, or the reason why it is not known."""

    t_gps_ns: int
    fixed: bool
    reason: str
    heading_rad: float = math.nan  # clockwise from north, 0…2π
    pitch_rad: float = math.nan  # forward axis above the horizon
    roll_rad: float = math.nan  # right side down
    covariance_rad2: Floats | None = None  # (3, 3) of heading, pitch, roll; NaN where not known
    rotation_enu_from_body: Floats | None = None  # (3, 3)
    baselines_enu_m: Floats | None = None  # (antennas − 1, 3) as measured
    confidence: float = 0.0  # posterior probability of the integers chosen


def _no_baseline(reason: str, n_satellites: int = 0) -> Baseline:
    return Baseline(np.zeros((0, 3)), np.zeros(0), np.full((3, 3), np.inf), 0, np.full(3, np.nan), n_satellites, reason)


def baseline_candidates(
    primary: Epoch, auxiliary: Epoch, place: Place, arm_body_m: Floats, source: SatelliteSource,
    settings: StationSettings, upright: Upright | None = None,
) -> Baseline:  # fmt: skip
    """Candidates for one baseline of known length from a single epoch; ``place`` is the primary's, good to metres."""
    rows = single_difference_rows(
        select_rows(auxiliary, settings.positioning.systems), select_rows(primary, settings.positioning.systems),
        settings.rtk.frequencies,
    )  # fmt: skip
    if rows.size < N_CORE + 2:
        return _no_baseline("too few satellites in common with the primary antenna")
    states, base_states, index = satellites_of(rows, auxiliary, primary, source)
    fill_model(rows, states, base_states, index, place, place, mask_rad_of(settings.positioning), 0.0, settings.rtk)
    n_groups = int(rows["group"].max()) + 1
    codes = snoop(
        rows["line"], rows["code_oc_m"], rows["code_weight"],
        rows["group"], n_groups, _CODE_W_LIMIT**2, max(2, rows.size // 4),
    )  # fmt: skip
    rows["code_weight"] /= max(codes.squares / codes.degrees_of_freedom, 1.0) if codes.degrees_of_freedom > 0 else 1.0
    arcs = update_arcs(RtkState(), rows, auxiliary.t_gps_ns, 0, n_groups, NO_CHANGE_TEST).arcs
    information, right = np.zeros((N_CORE + arcs.size,) * 2), np.zeros(N_CORE + arcs.size)
    accumulate(information, right, rows, arcs, codes.use, rows["arc"] >= 0, np.zeros(3), n_groups)
    references = references_of(rows, arcs, sines_of_arcs(rows, arcs.size))
    known = np.concatenate([np.zeros(N_CORE, np.bool_), references])
    x, q, regular = estimate(information, right, known, np.zeros(known.size))
    n_satellites = int(np.unique(rows["satellite"][rows["arc"] >= 0]).size)
    if not regular:
        return _no_baseline(f"{n_satellites} usable satellites do not determine the baseline", n_satellites)
    at = N_CORE + np.flatnonzero(arcs["integer"] & ~references)
    return _with_shape(x, q, at, place.enu, arm_body_m, upright, n_satellites)


def _with_shape(
    x: Floats, q: Floats, at: Ints, enu: Floats, arm_body_m: Floats, upright: Upright | None, n_satellites: int
) -> Baseline:
    """Candidates of float states, those of the ambiguities ``at`` resolved; those that the arm allows come first."""
    if at.size < N_CORE + 1:
        return _no_baseline("too few ambiguities to resolve", n_satellites)
    q_aa, q_ab = q[np.ix_(at, at)], q[at][:, POSITION]
    integers, norms = nearest(x[at], q_aa, _CANDIDATES, _REACH)
    if not norms.size:
        return _no_baseline("no integers fit", n_satellites)
    gain = np.linalg.solve(q_aa, q_ab).T
    vectors = (x[POSITION] - (x[at] - integers) @ gain.T) @ enu.T
    covariance = enu @ (q[POSITION, POSITION] - gain @ q_ab) @ enu.T
    lengths = np.linalg.norm(vectors, axis=1)
    along = vectors / np.maximum(lengths, 1e-9)[:, None]
    variance = np.einsum("ki,ij,kj->k", along, covariance, along) + LENGTH_SIGMA_M**2
    costs, degrees = norms + (lengths - np.linalg.norm(arm_body_m)) ** 2 / variance, at.size + 1
    if upright is not None:
        height_m, reach_m = float(arm_body_m @ upright.up_body), upright.sigma_rad * float(np.linalg.norm(arm_body_m))
        costs, degrees = costs + (vectors[:, 2] - height_m) ** 2 / (covariance[2, 2] + reach_m**2), degrees + 1
    order = np.argsort(costs, kind="stable")
    return Baseline(vectors[order], costs[order], covariance, degrees, enu @ x[POSITION], n_satellites)


# ------------------------------------------------------------------------------------------- attitude


def rotation_of_angles(heading_rad: float, pitch_rad: float, roll_rad: float) -> Floats:
    """``rotation_enu_from_body`` (3, 3) of three angles."""
    sh, ch = math.sin(heading_rad), math.cos(heading_rad)
    sp, cp = math.sin(pitch_rad), math.cos(pitch_rad)
    sr, cr = math.sin(roll_rad), math.cos(roll_rad)
    turn = np.array([[ch, sh, 0.0], [-sh, ch, 0.0], [0.0, 0.0, 1.0]])
    nod = np.array([[1.0, 0.0, 0.0], [0.0, cp, -sp], [0.0, sp, cp]])
    lean = np.array([[cr, 0.0, sr], [0.0, 1.0, 0.0], [-sr, 0.0, cr]])
    product: Floats = turn @ nod @ lean
    return product


def angles_of_rotation(rotation: Floats) -> Floats:
    """Heading 0…2π, pitch, roll, rad, of ``rotation_enu_from_body``."""
    heading = math.atan2(rotation[0, 1], rotation[1, 1]) % (2.0 * math.pi)
    pitch = math.asin(max(-1.0, min(1.0, rotation[2, 1])))
    return np.array([heading, pitch, math.atan2(-rotation[2, 0], rotation[2, 2])])


def _cross(v: Floats) -> Floats:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _partials(rotation: Floats) -> Floats:
    """Partials (3, 3) of the angles by a small rotation ψ with ``C ← (I + [ψ×]) C``."""
    out, step = np.zeros((3, 3)), 1e-6
    for k in range(3):
        psi = np.zeros(3)
        psi[k] = step
        there = angles_of_rotation((np.eye(3) + _cross(psi)) @ rotation)
        back = angles_of_rotation((np.eye(3) - _cross(psi)) @ rotation)
        difference = (there - back + math.pi) % (2.0 * math.pi) - math.pi
        out[:, k] = difference / (2.0 * step)
    return out


def fit_attitude(
    vectors_enu_m: Floats, covariances_m2: Sequence[Floats], arms_body_m: Floats, upright: Upright | None
) -> tuple[Floats, Floats, float]:
    """Rotation (3, 3), the covariance of its angles (3, 3) and the weighted sum of squares of the fit.

    ``vectors_enu_m``, ``arms_body_m`` (k, 3). ``upright`` adds what is known of the tilt, without which one baseline
    alone leaves a rotation free. Starts from Kabsch's rotation, then Gauss-Newton with the covariances.
    """
    weights = [np.linalg.inv(c + np.eye(3) * LENGTH_SIGMA_M**2 / 3.0) for c in covariances_m2]
    rotation = _first_rotation(vectors_enu_m, arms_body_m, upright)
    normal, cost, up = np.eye(3), 0.0, np.array([0.0, 0.0, 1.0])
    for _ in range(6):
        normal, right, cost = np.zeros((3, 3)), np.zeros(3), 0.0
        for vector, arm, weight in zip(vectors_enu_m, arms_body_m, weights, strict=True):
            turned = rotation @ arm
            rest, partial = vector - turned, -_cross(turned)
            normal += partial.T @ weight @ partial
            right += partial.T @ weight @ rest
            cost += float(rest @ weight @ rest)
        if upright is not None:
            turned = rotation @ upright.up_body
            partial, weight = -_cross(turned), np.diag([1.0, 1.0, 0.0]) / upright.sigma_rad**2
            normal += partial.T @ weight @ partial
            right += partial.T @ weight @ (up - turned)
            cost += float((up - turned) @ weight @ (up - turned))
        psi = np.asarray(np.linalg.solve(normal, right), np.float64)
        u, _, vt = np.linalg.svd((np.eye(3) + _cross(psi)) @ rotation)
        rotation = u @ vt
        if np.abs(psi).max() < 1e-10:
            break
    partials = _partials(rotation)
    return rotation, partials @ np.linalg.inv(normal) @ partials.T, cost


def _first_rotation(vectors: Floats, arms: Floats, upright: Upright | None) -> Floats:
    """Kabsch's rotation of the arms onto the vectors, the vertical onto itself where nothing else holds it."""
    pairs = vectors.T @ arms
    if upright is not None:
        pairs += 1e-2 * np.sum(arms * arms) * np.outer([0.0, 0.0, 1.0], upright.up_body)
    u, _, vt = np.linalg.svd(pairs)
    rotation: Floats = u @ np.diag([1.0, 1.0, float(np.sign(np.linalg.det(u @ vt)))]) @ vt
    return rotation


def _choose(
    baselines: Sequence[Baseline], arms: Floats, upright: Upright | None
) -> tuple[Floats, Floats, Floats, float]:  # fmt: skip
    """Rotation, covariance of the angles, vectors (k, 3) and posterior probability of the likeliest set.

    Costs are in units of the variance factor that the likeliest set shows, where that is more than one.
    """
    lone = len(baselines) == 1
    tilt = upright or (ROUGHLY_UPRIGHT if lone else None)
    sets = itertools.product(*(range(min(_PER_BASELINE, b.costs.size)) for b in baselines))
    found = []
    for chosen in sets:
        vectors = np.array([b.vectors_enu_m[i] for b, i in zip(baselines, chosen, strict=True)])
        own = sum(float(b.costs[i]) for b, i in zip(baselines, chosen, strict=True))
        rotation, covariance, shape = fit_attitude(vectors, [b.covariance_enu_m2 for b in baselines], arms, tilt)
        found.append((own + (0.0 if lone else shape), rotation, covariance, vectors))
    costs = np.array([entry[0] for entry in found])
    best = int(np.argmin(costs))
    factor = max(costs[best] / sum(b.degrees for b in baselines), 1.0)
    confidence = 1.0 / float(np.sum(np.exp(np.maximum(-0.5 * (costs - costs[best]) / factor, -700.0))))
    return found[best][1], found[best][2], found[best][3], confidence


def attitude(
    primary: Epoch, auxiliaries: Sequence[Epoch], arms_body_m: Floats, position_ecef_m: Floats, source: SatelliteSource,
    settings: StationSettings, upright: Upright | None = None,
) -> Attitude:  # fmt: skip
    """Attitude from one epoch of a primary antenna and one or more auxiliaries of the same instant.

    ``arms_body_m`` (k, 3): primary → each auxiliary in body axes; ``position_ecef_m``: of the primary, good to some ten
    metres (a metre costs 5e-8 of the baseline). Codes, phases and systems as the station's settings say. ``upright``:
    what is known of the tilt, from an accelerometer at rest; None where nothing is.
    """
    place = place_of(position_ecef_m, primary.t_gps_ns)
    baselines = [
        baseline_candidates(
            primary, replace(epoch, t_receive_ns=primary.t_receive_ns), place, arm, source, settings, upright
        )
        for epoch, arm in zip(auxiliaries, arms_body_m, strict=True)
    ]
    for number, one in enumerate(baselines, start=2):
        if one.costs.size == 0:
            return Attitude(primary.t_gps_ns, False, f"antenna {number}: {one.reason or 'no integers fit'}")
    rotation, covariance, vectors, confidence = _choose(baselines, arms_body_m, upright)
    angles, fixed = angles_of_rotation(rotation), confidence >= MIN_CONFIDENCE
    if not fixed:
        reason = f"integers not certain: probability {confidence:.3f}, {MIN_CONFIDENCE:.3f} wanted"
        return Attitude(primary.t_gps_ns, False, reason, confidence=confidence, baselines_enu_m=vectors)
    unknown = np.sqrt(np.diag(covariance)) > _UNKNOWN_RAD
    angles[unknown] = np.nan
    covariance[unknown, :], covariance[:, unknown] = np.nan, np.nan
    heading, pitch, roll = angles.tolist()
    return Attitude(
        primary.t_gps_ns, True, "", heading, pitch, roll, covariance, None if unknown.any() else rotation, vectors,
        confidence,
    )  # fmt: skip
