"""The information filter of relative positioning. Oracles: covariance form and double differences in plain NumPy."""

import numpy as np
import pytest

from plumbline.positioning.rtk_control import snoop
from plumbline.positioning.rtk_filter import accumulate, carry_over, eliminate, estimate, invert, move_position, solve3
from plumbline.positioning.rtk_observations import ROW_DTYPE
from plumbline.positioning.rtk_state import N_CORE, RTK_ARC_DTYPE

WAVELENGTH_M = 0.1903


def _random_information(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    h = rng.normal(size=(3 * n, n))
    return h.T @ h, rng.normal(size=n)


def _rows(rng: np.random.Generator, sizes: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Rows of groups of several satellites with random geometry and weights, and their arcs."""
    n = sum(sizes)
    rows, arcs = np.zeros(n, ROW_DTYPE), np.zeros(n, RTK_ARC_DTYPE)
    line = rng.normal(size=(n, 3)) + np.array([0.0, 0.0, 1.5])
    rows["line"] = line / np.linalg.norm(line, axis=1)[:, None]
    rows["group"] = np.repeat(np.arange(len(sizes)), sizes)
    rows["arc"], rows["wavelength_m"] = np.arange(n), WAVELENGTH_M
    rows["code_weight"], rows["phase_weight"] = (
        1.0 / rng.uniform(0.2, 0.6, n) ** 2,
        1.0 / rng.uniform(0.002, 0.01, n) ** 2,
    )
    rows["code_oc_m"], rows["phase_oc_m"] = rng.normal(0.0, 0.5, n), rng.normal(0.0, 5.0, n)
    return rows, arcs


def test_inverses() -> None:
    rng = np.random.default_rng(1)
    for n in (1, 3, 20, 60):
        normal, _ = _random_information(rng, n)
        normal *= np.outer(scale := 10.0 ** rng.uniform(-3, 3, n), scale)
        inverse, regular = invert(normal)
        assert regular
        np.testing.assert_allclose(inverse @ normal, np.eye(n), atol=1e-6)
    small, _ = _random_information(rng, 3)
    np.testing.assert_allclose(solve3(small)[0], np.linalg.inv(small))
    assert not solve3(np.ones((3, 3)))[1]
    assert not invert(np.ones((4, 4)))[1]


def test_eliminating_a_state_is_marginalising_it() -> None:
    information, right = _random_information(np.random.default_rng(2), 8)
    x, q = np.linalg.solve(information, right), np.linalg.inv(information)
    eliminate(information, right, 5)
    keep = [i for i in range(8) if i != 5]
    assert not information[5].any()
    np.testing.assert_allclose(np.linalg.inv(information[np.ix_(keep, keep)]), q[np.ix_(keep, keep)])
    np.testing.assert_allclose(np.linalg.solve(information[np.ix_(keep, keep)], right[keep]), x[keep])


@pytest.mark.parametrize("variance_m2", [1e-6, 0.01, 4.0])
def test_moving_the_position_adds_its_variance(variance_m2: float) -> None:
    information, right = _random_information(np.random.default_rng(3), 9)
    x, q = np.linalg.solve(information, right), np.linalg.inv(information)
    move_position(information, right, variance_m2)
    q[:3, :3] += variance_m2 * np.eye(3)
    np.testing.assert_allclose(np.linalg.inv(information), q, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(np.linalg.solve(information, right), x, rtol=1e-6, atol=1e-9)


def test_moving_anywhere_leaves_the_ambiguities_alone() -> None:
    information, right = _random_information(np.random.default_rng(4), 9)
    x, q = np.linalg.solve(information, right), np.linalg.inv(information)
    move_position(information, right, np.inf)
    assert not information[:3].any()
    np.testing.assert_allclose(np.linalg.inv(information[3:, 3:]), q[3:, 3:], rtol=1e-8)
    np.testing.assert_allclose(np.linalg.solve(information[3:, 3:], right[3:]), x[3:], rtol=1e-8)


def test_carry_over_reorders_forgets_and_begins() -> None:
    information, right = _random_information(np.random.default_rng(5), N_CORE + 4)
    q, x = np.linalg.inv(information), np.linalg.solve(information, right)
    out, out_right = carry_over(information.copy(), right.copy(), np.array([3, -1, 0]))
    there = [0, 1, 2, N_CORE, N_CORE + 2]
    old = [0, 1, 2, N_CORE + 3, N_CORE]
    assert not out[N_CORE + 1].any()
    np.testing.assert_allclose(np.linalg.inv(out[np.ix_(there, there)]), q[np.ix_(old, old)], rtol=1e-7)
    np.testing.assert_allclose(np.linalg.solve(out[np.ix_(there, there)], out_right[there]), x[old], rtol=1e-7)


def test_an_epoch_is_double_differences_with_their_full_covariance() -> None:
    """Whatever the reference satellite: the estimate is that of differenced observations, weighted in full."""
    rng = np.random.default_rng(6)
    sizes = (6, 5)
    rows, arcs = _rows(rng, sizes)
    n, shift = len(rows), np.array([0.3, -0.2, 0.5])
    information, right = np.zeros((N_CORE + n, N_CORE + n)), np.zeros(N_CORE + n)
    everything = np.ones(n, bool)
    accumulate(information, right, rows, arcs, everything, everything, shift, len(sizes))
    for references in ((0, 6), (4, 9)):
        known = np.zeros(N_CORE + n, bool)
        known[[N_CORE + r for r in references]] = True
        x, q, regular = estimate(information, right, known, np.zeros(N_CORE + n))
        assert regular
        design, values, covariance = [], [], np.zeros((2 * (n - 2), 2 * (n - 2)))
        difference = np.zeros((n - 2, n))
        k = 0
        for group, reference in enumerate(references):
            for i in np.flatnonzero(rows["group"] == group):
                if i != reference:
                    difference[k, i], difference[k, reference] = 1.0, -1.0
                    k += 1
        code_h = np.hstack([difference @ -rows["line"], np.zeros((n - 2, n))])
        phase_h = np.hstack([difference @ -rows["line"], difference * WAVELENGTH_M])
        moved = rows["line"] @ -shift
        design = np.delete(np.vstack([code_h, phase_h]), [N_CORE + r for r in references], axis=1)
        values = np.concatenate([difference @ (rows["code_oc_m"] + moved), difference @ (rows["phase_oc_m"] + moved)])
        covariance[: n - 2, : n - 2] = difference @ np.diag(1.0 / rows["code_weight"]) @ difference.T
        covariance[n - 2 :, n - 2 :] = difference @ np.diag(1.0 / rows["phase_weight"]) @ difference.T
        weight = np.linalg.inv(covariance)
        q_dd = np.linalg.inv(design.T @ weight @ design)
        np.testing.assert_allclose(q[np.ix_(~known, ~known)], q_dd, rtol=1e-5, atol=1e-9)
        np.testing.assert_allclose(x[~known], q_dd @ design.T @ weight @ values, rtol=1e-5, atol=1e-6)


def test_snooping_finds_what_was_spoilt() -> None:
    rng = np.random.default_rng(7)
    rows, _ = _rows(rng, (8, 7))
    truth = np.array([1.0, -2.0, 0.5])
    sigma = 1.0 / np.sqrt(rows["phase_weight"])
    v = -rows["line"] @ truth + 30.0 * rows["group"] + sigma * rng.normal(size=len(rows))
    v[[3, 11]] += 0.2
    found = snoop(rows["line"], v, rows["phase_weight"], rows["group"], 2, 16.0, 5)
    assert found.regular
    assert np.flatnonzero(~found.use).tolist() == [3, 11]
    assert found.degrees_of_freedom == 13 - 3 - 2
    assert found.squares == pytest.approx(float(np.sum((rows["phase_weight"] * found.residual_m**2)[found.use])))
    assert found.squares < 30.0
    np.testing.assert_allclose(found.residual_m[[3, 11]], 0.2, atol=0.06)  # as the others predict them
    error = found.b_m - truth
    assert error @ np.linalg.solve(found.covariance_m2, error) < 20.0
