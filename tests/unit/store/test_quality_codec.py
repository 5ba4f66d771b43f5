"""Quality reports as bytes and back. Oracle: the round trip, to float32."""

import numpy as np

from plumbline.records import QualityReport
from plumbline.store.quality_codec import decode, encode


def test_a_report_survives_to_float32() -> None:
    rng, m = np.random.default_rng(1), 7
    columns = [rng.normal(size=m) for _ in range(5)]
    external = rng.normal(size=(m, 3))
    external[2] = np.nan
    report = QualityReport(
        "a", 5, 6, {"statistic": 3.5, "w_critical": 5.1}, np.arange(m, dtype=np.int16), rng.random(m) > 0.5,
        np.arange(2 * m, dtype=np.int16).reshape(m, 2), *columns, external, *(rng.normal(size=m) for _ in range(3)),
        np.arange(m, dtype=np.int8) % 4, 0.5, 0.7, float("nan"), 0.03, 0.06, 1e-5, ("cycle slip of G05",),
    )  # fmt: skip
    back = decode("a", 5, 6, encode(report))
    for name in QualityReport.__slots__:
        given, read = getattr(report, name), getattr(back, name)
        if isinstance(given, np.ndarray):
            assert read.dtype == given.dtype
            np.testing.assert_allclose(read, given, rtol=1e-6)
        else:
            np.testing.assert_equal(read, given)
