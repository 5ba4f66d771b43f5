"""Motion blocks as bytes. Oracle: the identity of encode and decode, and half a quantum as the bound of rounding."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from plumbline.records import Motion, Status
from plumbline.store.motion_codec import QUANTUM, decode, encode, quantised, samples

_quanta = st.integers(1, 130).flatmap(
    lambda n: arrays(np.int64, (12, n), elements=st.integers(-(2**52), 2**52 - 1) | st.integers(-300, 300))
)


@settings(max_examples=150, deadline=None)
@given(_quanta)
def test_decoding_undoes_encoding(quanta: np.ndarray) -> None:
    assert np.array_equal(decode(encode(quanta), quanta.shape[1]), quanta)


def _motion(values: np.ndarray) -> Motion:
    d, v, a, s = (values[:, i : i + 3] for i in (0, 3, 6, 9))
    return Motion("a", 10**18, 10**18, 10_000_000, d, v, a, s, Status.PPP_FLOAT)


def test_quantisation_is_within_half_a_quantum_and_keeps_what_is_missing() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(0, 0.05, (100, 12))
    values[3, 4], values[:, 6:9] = np.nan, np.nan
    read = samples(decode(encode(quantised(_motion(values))), 100))
    again = np.hstack(
        (read.displacement_enu_m, read.velocity_enu_m_s, read.acceleration_enu_m_s2, read.sigma_displacement_enu_m)
    )
    assert np.array_equal(np.isnan(again), np.isnan(values))
    assert np.nanmax(np.abs(again - values)) <= QUANTUM / 2 * (1 + 1e-9)


def test_what_no_number_of_quanta_can_hold_is_missing() -> None:
    values = np.full((2, 12), np.inf)
    values[1] = -1e300
    assert np.isnan(samples(decode(encode(quantised(_motion(values))), 2)).displacement_enu_m).all()


def test_a_hundred_samples_of_a_quiet_structure_take_less_than_a_quarter_of_their_doubles() -> None:
    rng = np.random.default_rng(2)
    values = np.hstack(
        (
            rng.normal(0, 1e-4, (100, 3)),
            rng.normal(0, 5e-4, (100, 3)),
            rng.normal(0, 4e-3, (100, 3)),
            np.full((100, 3), 3e-3),
        )
    )
    assert len(encode(quantised(_motion(values)))) < values.nbytes / 4


def test_bytes_of_another_version_are_refused() -> None:
    import zlib

    with pytest.raises(ValueError, match="version"):
        decode(zlib.compress(b"\x07" + bytes(200)), 1)
