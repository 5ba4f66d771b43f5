"""Normal gravity against the published values of WGS 84 (NIMA TR 8350.2, table 3.4)."""

import math

import pytest

from plumbline.fusion.gravity import gravity_at_m_s2, normal_gravity_m_s2


def test_at_equator_and_pole() -> None:
    assert normal_gravity_m_s2(0.0, 0.0) == pytest.approx(9.7803253359, abs=1e-10)
    assert normal_gravity_m_s2(math.pi / 2, 0.0) == pytest.approx(9.8321849378, abs=1e-9)


def test_falls_with_height_and_is_standard_where_unknown() -> None:
    assert gravity_at_m_s2((6_378_137.0 + 1000.0, 0.0, 0.0)) == pytest.approx(9.7803253359 - 3.086e-3, abs=1e-6)
    assert gravity_at_m_s2(None) == 9.80665
