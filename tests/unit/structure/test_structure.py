"""Summaries and spectra; oracles: NumPy on the whole, Parseval's identity, sines of known frequency and amplitude."""

import numpy as np
import pytest

from plumbline.errors import ContractError
from plumbline.records import Motion, Status
from plumbline.structure import combined, peaks, power_spectrum, summary, summary_of_motion


def test_summaries_of_parts_join_to_the_summary_of_the_whole() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(size=(1000, 3))
    values[rng.random((1000, 3)) < 0.1] = np.nan
    values[:100, 1] = np.nan
    joined = combined([summary(part) for part in np.split(values, [100, 333, 900])])
    np.testing.assert_allclose(joined.mean, np.nanmean(values, axis=0), rtol=1e-12)
    np.testing.assert_allclose(joined.rms, np.sqrt(np.nanmean(values**2, axis=0)), rtol=1e-12)
    np.testing.assert_array_equal(joined.minimum, np.nanmin(values, axis=0))
    np.testing.assert_array_equal(joined.maximum, np.nanmax(values, axis=0))
    np.testing.assert_array_equal(joined.count, (~np.isnan(values)).sum(axis=0))


def test_nothing_is_nan() -> None:
    empty = summary(np.full((5, 2), np.nan))
    assert np.isnan([empty.minimum, empty.maximum, empty.mean, empty.rms]).all()
    assert np.isnan(combined([empty, empty]).mean).all()
    with pytest.raises(ContractError):
        combined([])


def test_motion_has_nine_channels() -> None:
    one = np.ones((4, 3))
    motion = Motion("A", 0, 0, 1, one, 2 * one, 3 * one, one, Status.PPP_FLOAT)
    np.testing.assert_array_equal(summary_of_motion(motion).mean, [1, 1, 1, 2, 2, 2, 3, 3, 3])


@pytest.mark.parametrize(("frequency_hz", "amplitude"), [(1.99, 0.0201), (3.7, 0.5), (8.03, 1e-3)])
def test_a_sine_is_found_with_its_frequency_and_amplitude(frequency_hz: float, amplitude: float) -> None:
    rng = np.random.default_rng(1)
    t = np.arange(12_000) / 100
    noise_and_trend = rng.normal(0, amplitude / 10, 12_000) + t
    values = (amplitude * np.sin(2 * np.pi * frequency_hz * t) + noise_and_trend)[:, None]
    spectrum = power_spectrum(values, 100.0)
    assert spectrum is not None
    found = peaks(spectrum, 0)[0]
    assert found.frequency_hz == pytest.approx(frequency_hz, abs=0.005)
    assert found.amplitude == pytest.approx(amplitude, rel=0.05)


def test_density_of_white_noise_and_its_integral() -> None:
    """σ²/(f_s/2) everywhere, and Parseval: the integral is the variance."""
    values = np.random.default_rng(2).normal(0, 0.3, (60_000, 3))
    spectrum = power_spectrum(values, 50.0, segment_s=10.0)
    assert spectrum is not None
    np.testing.assert_allclose(np.median(spectrum.density, axis=0), 0.09 / 25, rtol=0.1)
    np.testing.assert_allclose(np.trapezoid(spectrum.density, spectrum.frequency_hz, axis=0), 0.09, rtol=0.03)


def test_missing_or_few_samples_have_no_spectrum() -> None:
    values = np.zeros((100, 1))
    assert power_spectrum(values[:10], 100.0) is None
    values[3] = np.nan
    assert power_spectrum(values, 100.0) is None
