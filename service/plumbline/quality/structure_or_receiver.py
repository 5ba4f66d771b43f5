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

_CONTRADICTS_SIGMA: Final = 5.0
_NEIGHBOURS_SIGMA: Final = 3.0
_MIRRORED: Final = 0.5  # share of the displacement that the reference station's own explains
_LEAST_M: Final = 0.003


@dataclass(frozen=True, slots=True)
class Suspicion:
    """Why a displacement is not raised as a motion."""

    witness: str  # "accelerometer", "neighbour", "reference"
    reason: str


def contradicted_by_accelerometer(whitened_innovation: Floats) -> Suspicion | None:
    """The fusion's innovation (3,), of unit covariance: what GNSS says beyond what the accelerometer felt."""
    size = float(np.linalg.norm(whitened_innovation))
    if size <= _CONTRADICTS_SIGMA:
        return None
    return Suspicion("accelerometer", f"the accelerometer contradicts it: {size:.1f} sigma off what was felt")


def contradicted_by_neighbours(
    displacement_m: Floats, covariance_m2: Floats, neighbours: Mapping[str, tuple[Floats, Floats]], share: float = 0.3
) -> Suspicion | None:
    """A displacement (3,) against those of neighbours on the same structure: name → (displacement (3,), covariance).

    ``share`` of its own displacement is what a neighbour must show at least to confirm it.
    """
    size = float(np.linalg.norm(displacement_m))
    if not neighbours or size < _LEAST_M:
        return None
    direction = displacement_m / size
    for other, covariance in neighbours.values():
        sigma = np.sqrt(direction @ (share**2 * covariance_m2 + covariance) @ direction)
        if direction @ other >= share * size - _NEIGHBOURS_SIGMA * sigma:
            return None
    names = ", ".join(sorted(neighbours))
    return Suspicion("neighbour", f"only this antenna shows it: {names} {'does' if len(neighbours) == 1 else 'do'} not")


def explained_by_reference(displacement_m: Floats, reference_m: Floats, reference_sigma_m: Floats) -> Suspicion | None:
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
    return Suspicion("reference", f"the reference station moved by {np.linalg.norm(reference_m) * 1e3:.0f} mm itself")
