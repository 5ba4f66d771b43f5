"""Carrier phases with an arbitrary start, brought near the pseudorange as MSM's fine phase field requires."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plumbline.records import Floats

MAX_PHASE_MINUS_CODE_M: Final = 700.0  # DF401 and DF406 reach ±1171 m around a rough range that is 293 m off at most


@dataclass(slots=True)
class PhaseAligner:
    """Whole cycles taken off each (satellite, signal)'s phase; kept along an arc, renewed when phase and code part."""

    offset_cycles: dict[tuple[int, int], float] = field(default_factory=dict)

    def align(
        self,
        satellite: NDArray[np.int16],
        signal: NDArray[np.int16],
        pseudorange_m: Floats,
        carrier_phase_cycles: Floats,
        wavelength_m: Floats,
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """Aligned phases, cycles (n,), and where a new offset began a new arc: lock time starts again from zero there.

        A phase without a pseudorange keeps its arc's offset, and is dropped (NaN) where it has none yet.
        """
        aligned = np.full(satellite.size, np.nan)
        restarted = np.zeros(satellite.size, dtype=np.bool_)
        for i, key in enumerate(zip(satellite.tolist(), signal.tolist(), strict=True)):
            offset = self.offset_cycles.get(key)
            difference_m = (carrier_phase_cycles[i] - (offset or 0.0)) * wavelength_m[i] - pseudorange_m[i]
            if np.isfinite(difference_m) and (offset is None or abs(difference_m) > MAX_PHASE_MINUS_CODE_M):
                offset = (offset or 0.0) + float(np.round(difference_m / wavelength_m[i]))
                self.offset_cycles[key] = offset
                restarted[i] = True
            if offset is not None:
                aligned[i] = carrier_phase_cycles[i] - offset
        return aligned, restarted
