"""The codes' weights: an arc's codes are worth what they would be beside a bias state."""

import numpy as np
import pytest

from plumbline.config import PositioningSettings
from plumbline.positioning.ppp_model import MODEL_DTYPE
from plumbline.positioning.ppp_noise import code_scale, tuning_of, variances
from plumbline.positioning.preprocess import PAIR_DTYPE
from plumbline.positioning.state import ARC_DTYPE

TUNING = tuning_of(PositioningSettings())


def _one(sine=1.0, system=0, **changes):
    rows, pairs = np.zeros(1, MODEL_DTYPE), np.zeros(1, PAIR_DTYPE)
    rows["usable"], rows["sine"] = True, sine
    pairs["alpha"], pairs["bias_known"], pairs["system"] = 2.5457, True, system
    for name, value in changes.items():
        pairs[name] = value
    return rows, pairs


@pytest.mark.parametrize("sine", [1.0, 0.3])
def test_codes_of_an_arc_are_worth_a_mean_with_a_constant_bias(sine):
    """Oracle: a two-state Kalman filter (constant, bias) in NumPy fed the same white codes."""
    rows, pairs = _one(sine)
    arcs, white = np.zeros(1, ARC_DTYPE), (np.hypot(2.5457, 1.5457) * TUNING.code_sigma_m / sine) ** 2
    information, p = 0.0, np.diag([1e6, TUNING.gps_bias_m**2])
    for _ in range(50):
        code, _, added = variances(rows, pairs, arcs, np.zeros(1, np.int64), 30.0, 1.0, TUNING)
        information += 1.0 / code[0]
        arcs["code_weight_m2"] += added
        h = np.array([1.0, 1.0])
        gain = p @ h / (h @ p @ h + white)
        p = p - np.outer(gain, h @ p)
        assert 1.0 / information == pytest.approx(p[0, 0], rel=1e-3)


def test_a_faster_rate_does_not_bring_more():
    """Oracle: thirty codes a second apart weigh as much as one in half a minute (and the first epoch's own)."""
    rows, pairs = _one()
    slow, fast = np.zeros(1, ARC_DTYPE), np.zeros(1, ARC_DTYPE)
    for arcs, dt_s, epochs in ((slow, 30.0, 11), (fast, 1.0, 301)):
        for _ in range(epochs):
            arcs["code_weight_m2"] += variances(rows, pairs, arcs, np.zeros(1, np.int64), dt_s, 1.0, TUNING)[2]
    assert fast["code_weight_m2"][0] == pytest.approx(slow["code_weight_m2"][0], rel=1e-9)


def test_low_satellites_glonass_and_geostationary_ones_are_believed_less():
    """Oracle: 1/sin² of elevation; the order of the biases; the factor."""
    none = np.full(1, -1, np.int64)

    def both(*args, **changes):
        return [v[0] for v in variances(*_one(*args, **changes), np.zeros(0, ARC_DTYPE), none, 30.0, 1.0, TUNING)[:2]]

    assert both(0.5)[1] == pytest.approx(4.0 * both(1.0)[1])
    assert both(1.0, 1)[0] > both(1.0)[0] + 8.0
    assert both(1.0, bias_known=False)[0] > both(1.0)[0] + 0.9
    assert both(1.0, 5, satellite=5 * 64 + 2)[1] == pytest.approx(TUNING.geo_factor**2 * both(1.0, 5, satellite=345)[1])


def test_noisy_codes_raise_their_own_scale():
    """Oracle: misclosures drawn with five times the noise are recognised as such; ordinary ones are not."""
    rng = np.random.default_rng(1)
    rows, pairs = (np.repeat(a, 400) for a in _one())
    sigma = np.hypot(np.hypot(2.5457, 1.5457) * TUNING.code_sigma_m, TUNING.gps_bias_m)
    assert code_scale(sigma * rng.normal(size=400), rows, pairs, TUNING) == 1.0
    assert code_scale(5.0 * sigma * rng.normal(size=400), rows, pairs, TUNING) == pytest.approx(5.0 / 1.3, rel=0.15)
