"""Phase alignment. Oracle: the phase moved by whole cycles, by one number along an arc, and near enough for MSM."""

import numpy as np

from plumbline.rtcm3 import PhaseAligner
from plumbline.rtcm3.phase_alignment import MAX_PHASE_MINUS_CODE_M

WAVELENGTH = np.array([0.19, 0.24])
IDS = np.array([3, 3], dtype=np.int16), np.array([1, 9], dtype=np.int16)


def test_offsets_are_whole_cycles_and_constant_along_an_arc() -> None:
    aligner = PhaseAligner()
    ambiguity = np.array([1.25e7, -3.0e6])
    for k in range(100):
        code = np.array([2.1e7, 2.1e7 + 4]) + 700.0 * k
        phase = code / WAVELENGTH + ambiguity + 0.3
        if k == 50:
            code[0] = np.nan  # a missing pseudorange does not end an arc
        aligned, restarted = aligner.align(*IDS, code, phase, WAVELENGTH)
        offset = phase - aligned
        np.testing.assert_allclose(offset, np.round(offset), atol=1e-6)
        assert restarted.tolist() == [k == 0] * 2
        known = np.isfinite(code)
        assert np.all(np.abs(aligned * WAVELENGTH - code)[known] < 1.0)


def test_a_jump_beyond_the_field_begins_a_new_arc() -> None:
    aligner = PhaseAligner()
    code = np.array([2.1e7, 2.1e7])
    aligner.align(*IDS, code, code / WAVELENGTH, WAVELENGTH)
    jumped = code / WAVELENGTH + np.array([MAX_PHASE_MINUS_CODE_M / 0.19 + 10.0, 100.0])
    aligned, restarted = aligner.align(*IDS, code, jumped, WAVELENGTH)
    assert restarted.tolist() == [True, False]
    assert abs(aligned[0] * 0.19 - code[0]) < 0.2


def test_a_phase_that_never_had_a_pseudorange_is_dropped() -> None:
    code = np.array([np.nan, 2.1e7])
    aligned, _ = PhaseAligner().align(*IDS, code, np.array([1.0, 1e8]), WAVELENGTH)
    assert np.isnan(aligned).tolist() == [True, False]
