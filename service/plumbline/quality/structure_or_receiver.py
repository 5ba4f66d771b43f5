"""Is it the structure or the receiver? A displacement is believed as a motion unless something contradicts it.

Three witnesses (Lee 2016, section 1: an outlier taken for a deflection destroys the trust in all of them):

* the accelerometer on the same place: a structure does not move by centimetres between two epochs without it;
* the neighbours on the same structure: what one antenna shows and its neighbours show nothing of is its own;
* the reference station: what its own precise position shows, every rover shows mirrored.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from plumbline.records import Floats

ACCELEROMETER: Final = "accelerometer"
NEIGHBOUR: Final = "neighbour"
REFERENCE: Final = "reference"
WITNESSES: Final = (ACCELEROMETER, NEIGHBOUR, REFERENCE)

_CONTRADICTS_SIGMA: Final = 5.0
RAISED_SIGMA: Final = 3.0  # by which neighbours must disagree to raise a suspicion
_MIRRORED: Final = 0.5  # share of the displacement that the reference station's own explains
_LEAST_M: Final = 0.003
_SIGNIFICANT_SIGMA: Final = 5.0  # a displacement smaller than that is noise, and contradicts nobody
_SAME: Final = 0.5  # a displacement is the contradicted one as long as it differs from it by no more than this share …
_SAME_SIGMA: Final = 6.0  # … or by no more than noise


@dataclass(frozen=True, slots=True)
class Suspicion:
    """Why a displacement is not raised as a motion."""

    witness: str  # one of WITNESSES
    reason: str
    displacement_m: tuple[float, ...] = (0.0, 0.0, 0.0)  # what is contradicted: east, north, up
    t_from_gps_ns: int = 0
    t_until_gps_ns: int | None = None  # None: it still is

    @property
    def size_m(self) -> float:
        """Length of what is contradicted."""
        return float(np.linalg.norm(self.displacement_m))

    def explains(self, departure_m: Floats, sigma_m: Floats) -> bool:
        """Whether a departure (3,) from what was before is still the one that was contradicted, for its most part."""
        left_m = departure_m - np.array(self.displacement_m)
        left = float(np.linalg.norm(left_m / sigma_m))
        alike = float(np.linalg.norm(left_m)) <= _SAME * self.size_m or left <= _SAME_SIGMA
        return alike and left < float(np.linalg.norm(departure_m / sigma_m))

    def overlaps(self, t_first_gps_ns: int, t_last_gps_ns: int) -> bool:
        """Whether a stretch of event time lies in it, in part."""
        return self.t_from_gps_ns <= t_last_gps_ns and (
            self.t_until_gps_ns is None or self.t_until_gps_ns >= t_first_gps_ns
        )


def contradicted_by_accelerometer(
    whitened_innovation: Floats, innovation_m: Floats, departure_m: Floats
) -> Suspicion | None:
    """What GNSS says beyond what the accelerometer felt: the fusion's innovation (3,), and the same whitened (3,).

    ``departure_m`` (3,) is the whole displacement against what was before: where the accelerometer felt most of it,
    the rest is a matter of gains and axes and contradicts nothing.
    """
    size, unfelt_m = float(np.linalg.norm(whitened_innovation)), float(np.linalg.norm(innovation_m))
    if size <= _CONTRADICTS_SIGMA or unfelt_m < _LEAST_M:
        return None
    if float(np.linalg.norm(departure_m - innovation_m)) > _SAME * unfelt_m:
        return None
    reason = f"the accelerometer felt nothing of {unfelt_m * 1e3:.0f} mm ({size:.0f} sigma)"
    return Suspicion(ACCELEROMETER, reason, tuple(innovation_m.tolist()))


def is_significant(displacement_m: Floats, covariance_m2: Floats) -> bool:
    """Whether a displacement (3,) is more than its noise (3, 3)."""
    return float(displacement_m @ np.linalg.solve(covariance_m2, displacement_m)) > _SIGNIFICANT_SIGMA**2


def contradicted_by_neighbours(
    displacement_m: Floats,
    covariance_m2: Floats,
    neighbours: Mapping[str, tuple[Floats, Floats]],
    share: float = 0.5,
    sigmas: float = RAISED_SIGMA,
) -> Suspicion | None:
    """A displacement (3,) against those of neighbours on the same structure: name → (displacement (3,), covariance).

    ``share`` of its own displacement is what a neighbour must show at least to confirm it; it is contradicted where
    each of them shows less by ``sigmas``.
    """
    size = float(np.linalg.norm(displacement_m))
    if not neighbours or size < _LEAST_M or not is_significant(displacement_m, covariance_m2):
        return None
    direction = displacement_m / size
    for other, covariance in neighbours.values():
        sigma = np.sqrt(direction @ (share**2 * covariance_m2 + covariance) @ direction)
        if direction @ other >= share * size - sigmas * sigma:
            return None
    names = ", ".join(sorted(neighbours))
    verb = "does" if len(neighbours) == 1 else "do"
    reason = f"only this antenna shows {size * 1e3:.0f} mm: {names} {verb} not"
    return Suspicion(NEIGHBOUR, reason, tuple(displacement_m.tolist()))


def explained_by_reference(
    displacement_m: Floats, reference_m: Floats, reference_sigma_m: Floats, name: str = ""
) -> Suspicion | None:
    """A rover's displacement (3,) against its reference station's own, from the reference's precise positions (3,).

    A reference station that moves by d moves every rover by −d.
    """
    size = float(np.linalg.norm(displacement_m))
    significant = bool((np.abs(reference_m) > 3.0 * reference_sigma_m).any())
    if size < _LEAST_M or not significant:
        return None
    left = float(np.linalg.norm(displacement_m + reference_m))
    if left > (1.0 - _MIRRORED) * size:
        return None
    who = f"the reference station{' ' if name else ''}{name}"
    reason = f"{who} moved by {np.linalg.norm(reference_m) * 1e3:.0f} mm itself"
    return Suspicion(REFERENCE, reason, tuple(displacement_m.tolist()))
