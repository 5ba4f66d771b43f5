"""The ephemeris book. Oracles: choices made by hand, and a plain search through all sets as its twin."""

import dataclasses
import pickle

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plumbline.epochs.ephemeris_book import MAX_AGE_S, EphemerisBook, Match, issue_by_rule, issue_matches
from plumbline.gps_time import NS_PER_S, gps_ns
from plumbline.records import UNKNOWN_CHANNEL, GlonassEphemeris, KeplerEphemeris
from plumbline.signals import System, satellite_of_name

T0 = gps_ns(2400, 100_800.0)
HOUR = 3600 * NS_PER_S
G05, E11, R07, C20 = (satellite_of_name(name) for name in ("G05", "E11", "R07", "C20"))
FAR = T0 + 1000 * HOUR


def kepler(satellite=G05, toe=T0, received=None, issue=1, message="LNAV", health=0, bias=0.0):
    return KeplerEphemeris(
        satellite, message, toe - 2 * HOUR if received is None else received, toe, toe, issue, issue, bias, 0.0, 0.0,
        5153.5, 0.01, 0.5, *[0.0] * 12, (0.0, 0.0), health, 2,
    )  # fmt: skip


def glonass(toe=T0, channel=-3):
    zero = (0.0, 0.0, 0.0)
    return GlonassEphemeris(
        R07, toe - 900 * NS_PER_S, toe, 11, channel, (2.5e7, 0.0, 0.0), zero, zero, 0.0, 0.0, 0.0, 0
    )


def book(*sets):
    made = EphemerisBook()
    for ephemeris in sets:
        made.add(ephemeris)
    return made


def issue_of(choice):
    return choice.entry.ephemeris.issue if choice.entry else choice.match


def test_the_nearest_reference_time_is_taken_and_the_change_comes_half_way():
    made = book(kepler(issue=1), kepler(toe=T0 + 2 * HOUR, issue=2))
    for t, issue in ((T0 - HOUR, 1), (T0 + HOUR - 1, 1), (T0 + HOUR + 1, 2), (T0 + 4 * HOUR, 2)):
        assert issue_of(made.select(G05, t, FAR)) == issue
    assert made.select(G05, T0 + 5 * HOUR, FAR) == (None, Match.EPHEMERIS_TOO_OLD)


def test_only_what_had_been_received_is_known():
    made = book(kepler(issue=1, received=T0), kepler(toe=T0 + 2 * HOUR, issue=2, received=T0 + HOUR))
    assert made.select(G05, T0 + 2 * HOUR, T0 - 1) == (None, Match.NO_EPHEMERIS)
    assert issue_of(made.select(G05, T0 + 2 * HOUR, T0)) == 1
    assert issue_of(made.select(G05, T0 + 2 * HOUR, FAR)) == 2
    assert issue_of(made.select(G05, T0 + 2 * HOUR, T0 + HOUR - 1)) == 1  # after a later question, too


def test_a_set_is_kept_once_from_its_first_receive_time():
    made = book(kepler(received=T0))
    assert made.add(kepler(received=T0 + HOUR)) is False
    assert made.add(kepler(received=T0 - HOUR)) is True
    assert issue_of(made.select(G05, T0, T0 - HOUR)) == 1
    assert len(made._kept[G05].entries) == 1


def test_previous_issues_stay_and_unknown_ones_are_told_apart():
    made = book(kepler(issue=1), kepler(toe=T0 + 2 * HOUR, issue=2))
    assert issue_of(made.select(G05, T0 + 2 * HOUR, FAR, issue=1)) == 1
    assert made.select(G05, T0, FAR, issue=45) == (None, Match.ISSUE_MISMATCH)
    assert made.select(G05, T0 + 5 * HOUR, FAR, issue=2).match is Match.USABLE  # its corrections carry it on
    assert made.select(E11, T0, FAR) == (None, Match.NO_EPHEMERIS)


def test_health_of_the_newest_set_counts():
    made = book(kepler(issue=1))
    assert made.select(G05, T0, FAR).match is Match.USABLE
    made.add(kepler(issue=2, toe=T0 + 2 * HOUR, health=63, received=T0))
    assert made.select(G05, T0, FAR) == (None, Match.UNHEALTHY)
    assert made.select(G05, T0, FAR, issue=1) == (None, Match.UNHEALTHY)
    assert made.select(G05, T0, T0 - 1).match is Match.USABLE
    made.add(kepler(issue=2, toe=T0 + 2 * HOUR, health=0, received=T0 + 1))
    assert made.select(G05, T0, FAR).match is Match.USABLE


def test_galileos_message_is_preferred_not_demanded():
    inav, fnav = kepler(E11, message="INAV", bias=1e-3), kepler(E11, message="FNAV", bias=2e-3)
    for wanted in ("INAV", "FNAV"):
        assert book(inav, fnav).select(E11, T0, FAR, message=wanted).entry.ephemeris.message == wanted
        assert book(fnav).select(E11, T0, FAR, message=wanted).entry.ephemeris.message == "FNAV"
    assert book(inav).select(E11, T0, FAR, issue=1, message="FNAV").entry.ephemeris.message == "INAV"


def test_glonass_channels_come_from_their_ephemerides():
    made = book(glonass())
    assert made.glonass_channel(R07, FAR) == -3
    assert made.glonass_channel(R07, T0 - HOUR) == UNKNOWN_CHANNEL
    assert made.glonass_channel(G05, FAR) == UNKNOWN_CHANNEL
    assert made.select(R07, T0 + 1861 * NS_PER_S, FAR).match is Match.EPHEMERIS_TOO_OLD


@pytest.mark.parametrize(("toe_bdt_s", "modulo", "iod"), [(172_800, 96, 0), (169_200, 670, 235), (604_792, 847, 119)])
def test_beidous_issues(toe_bdt_s, modulo, iod):
    """DF470: toe in 8 s modulo 1024; IDF012: in 720 s modulo 240. madoca-2025-091 sends 96 and 158 = 670 mod 256."""
    ephemeris = kepler(C20, toe=gps_ns(2360, toe_bdt_s + 14.0), message="D1")
    assert issue_by_rule(ephemeris, "toe_8s") == modulo
    assert issue_by_rule(ephemeris, "toe_720s") == iod
    assert issue_matches(ephemeris, modulo % 256, "toe_8s")
    assert not issue_matches(ephemeris, (modulo + 1) % 256, "toe_8s")
    assert not issue_matches(ephemeris, (iod + 1) % 240, "toe_720s")


def test_memory_is_bounded_and_pickling_changes_nothing():
    made = book(*(kepler(issue=k % 256, toe=T0 + k * HOUR) for k in range(500)))
    assert len(made._kept[G05].entries) == 24
    copy = pickle.loads(pickle.dumps(made))
    for k in range(470, 505):
        assert copy.select(G05, T0 + k * HOUR, FAR) is not None
        assert issue_of(copy.select(G05, T0 + k * HOUR, FAR)) == issue_of(made.select(G05, T0 + k * HOUR, FAR))


sets = st.builds(
    lambda toe, received, issue, message, health: kepler(
        E11, T0 + toe * 600 * NS_PER_S, T0 + received * 300 * NS_PER_S, issue, message, health
    ),
    st.integers(-20, 20), st.integers(-30, 30), st.integers(0, 3), st.sampled_from(["INAV", "FNAV"]), st.integers(0, 1),
)  # fmt: skip


@settings(max_examples=150, deadline=None)
@given(
    st.lists(sets, max_size=10),
    st.lists(st.tuples(st.integers(-200, 200), st.integers(-35, 35), st.sampled_from([None, 0, 1]),
                       st.sampled_from([None, "INAV", "FNAV"])), max_size=30),
)  # fmt: skip
def test_remembered_answers_are_the_ones_a_search_gives(ephemerides, questions):
    """Whatever was asked before, the answer is that of a book which was never asked, limited to what had come."""
    made = book(*ephemerides)
    for minutes, received, issue, message in questions:
        t, as_of = T0 + minutes * 60 * NS_PER_S + 7, T0 + received * 300 * NS_PER_S
        fresh = book(*sorted((e for e in ephemerides if e.t_receive_ns <= as_of), key=lambda e: e.t_receive_ns))
        got = made.select(E11, t, as_of, issue=issue, message=message)
        expected = fresh.select(E11, t, FAR, issue=issue, message=message)
        assert got.match == expected.match
        if got.entry is not None:
            assert dataclasses.replace(got.entry.ephemeris, t_receive_ns=0) == dataclasses.replace(
                expected.entry.ephemeris, t_receive_ns=0
            )
            limit = MAX_AGE_S[System.GALILEO] * (1 if issue is None else 2)
            assert abs(got.entry.ephemeris.toe_gps_ns - t) <= limit * NS_PER_S
