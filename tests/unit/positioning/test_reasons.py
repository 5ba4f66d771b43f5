"""Reasons in words."""

import numpy as np
import pytest

from plumbline.positioning.preprocess import PAIR_DTYPE
from plumbline.positioning.reasons import cause_text, missing_systems, too_few
from plumbline.positioning.satellites import Cause, SatelliteStates


def _states(causes, ages=None):
    n = len(causes)
    nan = np.full(n, np.nan)
    ages = nan if ages is None else np.array(ages, float)
    return SatelliteStates(
        np.zeros(n, np.int16),
        np.array(causes, np.int8),
        np.zeros((n, 3)),
        np.zeros((n, 3)),
        nan,
        nan,
        ages,
        False,
        30.0,
    )


def _pairs(systems):
    pairs = np.zeros(len(systems), PAIR_DTYPE)
    pairs["system"] = systems
    return pairs


def test_a_system_that_is_missing_is_named_with_age_and_limit():
    """Oracle: the sentence that operators were promised."""
    states = _states([0, 0, Cause.CORRECTIONS_TOO_OLD, Cause.CORRECTIONS_TOO_OLD], [1, 1, 74, 90])
    assert (
        missing_systems("GE", _pairs([0, 0, 2, 2]), states) == "no corrections for Galileo: last 74 s ago, limit 30 s"
    )


def test_corrections_from_the_future_are_told_as_such():
    """Oracle: the sign of the age: streams that were recorded with different clocks."""
    text = cause_text(Cause.CORRECTIONS_TOO_OLD, "GPS", [-41.0, -50.0, np.nan], 30.0)
    assert text == "no corrections for GPS: the next is 41 s ahead, limit 30 s"


def test_some_missing_satellites_are_no_reason_but_most_are():
    """Oracle: the counts."""
    third = _states([Cause.ISSUE_MISMATCH, 0, 0])
    assert missing_systems("G", _pairs([0, 0, 0]), third) == ""
    most = _states([Cause.ISSUE_MISMATCH, Cause.ISSUE_MISMATCH, 0])
    text = missing_systems("G", _pairs([0, 0, 0]), most)
    assert text == "corrections for 2 of 3 GPS satellites refer to ephemerides that have not been received"


def test_systems_not_asked_for_and_not_observed_are_not_named():
    """Oracle: silence."""
    states = _states([Cause.NO_CORRECTIONS, 0])
    assert missing_systems("E", _pairs([0, 2]), states) == ""
    assert missing_systems("EC", _pairs([0, 2]), states) == ""


@pytest.mark.parametrize("cause", list(Cause))
def test_every_cause_has_words(cause):
    """Oracle: the list of causes."""
    text = cause_text(cause, "BeiDou", [12.0], 30.0)
    assert (text == "") is (cause is Cause.USABLE)
    assert "{" not in text


def test_too_few_satellites_are_counted():
    """Oracle: the numbers."""
    assert too_few(3, 4, "no corrections for GPS") == "3 usable satellites, 4 needed; no corrections for GPS"
