"""The correction book and its matching. Oracles: pairs worked out by hand, and a book that is never asked twice."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plumbline.config import PositioningSettings
from plumbline.epochs.correction_book import AgeLimits, CorrectionBook
from plumbline.epochs.ephemeris_book import EphemerisBook, Match
from plumbline.epochs.matched_corrections import matched, reason
from plumbline.gnss.orbits_broadcast import AF0
from plumbline.gnss.ssr_orbits import CLOCK, CLOCK_T_S, HIGH_RATE_CLOCK, ORBIT, ORBIT_T_S
from plumbline.gps_time import NS_PER_S, gps_ns
from plumbline.records import KeplerEphemeris, SsrClock, SsrCodeBias, SsrHeader, SsrOrbit, SsrPhaseBias, SsrVtec
from plumbline.signals import System, satellite_of_name, signal_id

T0 = gps_ns(2400, 100_800.0)
LIMITS = AgeLimits()
G05, G06, E11 = (satellite_of_name(name) for name in ("G05", "G06", "E11"))
C1C, C2W = signal_id(System.GPS, "1C"), signal_id(System.GPS, "2W")
FAR = T0 + 10**15


def at(seconds):
    return T0 + round(seconds * NS_PER_S)


def header(t, received=None, iod=1, provider=260, interval=5.0):
    return SsrHeader(at(t), at(t + 0.5 if received is None else received), interval, iod, provider, 1)


def orbit(t, issue=10, radial=0.0, satellites=(G05,), **of_header):
    n = len(satellites)
    rac = np.tile([radial, 0.0, 0.0], (n, 1))
    ids = np.array(satellites, dtype=np.int16)
    return SsrOrbit(header(t, **of_header), ids, np.full(n, issue, dtype=np.int64), rac, np.zeros((n, 3)))


def clock(t, c0=0.0, satellites=(G05,), high_rate=False, **of_header):
    polynomial = np.tile([c0, 0.0, 0.0], (len(satellites), 1))
    return SsrClock(header(t, **of_header), np.array(satellites, dtype=np.int16), polynomial, high_rate)


def ephemeris(issue, satellite=G05, received=-3600.0, toe=T0, health=0):
    return KeplerEphemeris(
        satellite, "LNAV" if satellite < 64 else "INAV", at(received), toe, toe, issue, issue, issue * 1e-6, 0.0, 0.0,
        5153.5, 0.01, 0.5, *[0.0] * 12, (0.0, 0.0), health, 2,
    )  # fmt: skip


def books(ephemerides, corrections):
    of_ephemerides, of_corrections = EphemerisBook(), CorrectionBook()
    for record in ephemerides:
        of_ephemerides.add(record)
    for record in corrections:
        of_corrections.add(record)
    return of_ephemerides, of_corrections


def ask(made, t, as_of=None, satellites=(G05,), limits=LIMITS):
    ids = np.array(satellites, dtype=np.int16)
    return matched(*made, ids, at(t), FAR if as_of is None else at(as_of), limits)


def pair(found, row=0):
    """(radial, c0, ephemeris issue) of a satellite that can be used, else its Match."""
    if found.match[row] != Match.USABLE:
        return Match(int(found.match[row]))
    issue = round(found.rows[row, AF0] * 1e6)
    return found.corrections[row, ORBIT], found.corrections[row, CLOCK], issue


def test_orbit_and_clock_with_their_reference_times():
    found = ask(books([ephemeris(10)], [orbit(0, radial=1.5, interval=60.0), clock(2, 0.25)]), 3.0)
    assert pair(found) == (1.5, 0.25, 10)
    assert found.corrections[0, ORBIT_T_S] == at(30) // NS_PER_S  # half the update interval after the epoch
    assert found.corrections[0, CLOCK_T_S : CLOCK_T_S + 2].tolist() == [at(4) // NS_PER_S, 5e8]
    assert (found.orbit_age_s[0], found.clock_age_s[0]) == (3.0, 1.0)
    assert (found.issue_wanted[0], found.issue_held[0], found.iod_ssr[0]) == (10, 10, 1)


def test_an_update_that_has_half_arrived_does_not_mix():
    """A new IOD SSR: the old pair is used until the new one is whole, whichever half comes first."""
    old = [orbit(0, radial=1.0), clock(0, 0.1)]
    new = [orbit(30, radial=2.0, iod=2), clock(30, 0.2, iod=2)]
    for half in new:
        assert pair(ask(books([ephemeris(10)], [*old, half]), 29.0)) == (1.0, 0.1, 10)
    for both in (new, new[::-1]):
        assert pair(ask(books([ephemeris(10)], [*old, *both]), 30.0)) == (2.0, 0.2, 10)


def test_a_clock_newer_than_its_orbit_is_used_with_it():
    records = [orbit(0, radial=1.0), clock(0, 0.1), clock(5, 0.2), clock(10, 0.3)]
    assert pair(ask(books([ephemeris(10)], records), 12.0)) == (1.0, 0.3, 10)


def test_a_new_issue_waits_for_its_clock():
    """Same IOD SSR, new ephemeris: the clock from before the change is counted on the old ephemeris's clock."""
    sets = [ephemeris(10), ephemeris(11)]
    records = [orbit(0, radial=1.0), clock(25, 0.1), orbit(30, 11, 2.0)]
    assert pair(ask(books(sets, records), 30.0)) == (1.0, 0.1, 10)
    assert pair(ask(books(sets, [*records, clock(30, 0.2)]), 30.0)) == (2.0, 0.2, 11)
    assert pair(ask(books(sets, [*records, clock(30, 0.2), clock(35, 0.3)]), 36.0)) == (2.0, 0.3, 11)


def test_an_ephemeris_that_comes_late_is_bridged_by_the_old_pair():
    records = [orbit(0, radial=1.0), clock(25, 0.1), orbit(30, 11, 2.0), clock(30, 0.2)]
    late = [ephemeris(10), ephemeris(11, received=40.0)]
    assert pair(ask(books(late, records), 35.0, as_of=35.0)) == (1.0, 0.1, 10)
    assert pair(ask(books(late, records), 41.0, as_of=41.0)) == (2.0, 0.2, 11)
    never = books([ephemeris(10)], [*records, clock(55, 0.5), orbit(60, 11, 2.0)])
    found = ask(never, 60.0)
    assert pair(found) is Match.ISSUE_MISMATCH
    text = "corrections for GPS refer to ephemerides that the stream does not carry (IODE 11; we hold 10)"
    assert reason(found, System.GPS, LIMITS, 0.0) == text


def test_age_limits_and_their_words():
    made = books([ephemeris(10)], [orbit(0), clock(0), orbit(0, satellites=(E11,)), clock(0, satellites=(E11,))])
    assert pair(ask(made, 30.0)) == (0.0, 0.0, 10)
    assert pair(ask(made, 30.1)) is Match.CORRECTIONS_TOO_OLD
    strict = AgeLimits.of(PositioningSettings(max_correction_age_s=10.0, max_orbit_correction_age_s=5.0))
    assert (strict.clock_s, strict.orbit_s, strict.bias_s) == (10.0, 5.0, 7200.0)
    assert pair(ask(made, 6.0, limits=strict)) is Match.CORRECTIONS_TOO_OLD
    found = ask(made, 74.0, satellites=(E11, G05))
    assert reason(found, System.GALILEO, LIMITS, 74.0) == "no corrections for Galileo: last 74 s ago, limit 30 s"
    assert reason(found, System.GLONASS, LIMITS) == "no satellites of GLONASS"


def test_the_other_reasons_and_their_words():
    made = books([ephemeris(10, health=63), ephemeris(10, G06, toe=at(-90_000))],
                 [orbit(0, satellites=(G05, G06, E11)), clock(0, satellites=(G05, G06, E11))])  # fmt: skip
    found = ask(made, 1.0, satellites=(G05, G06, E11, satellite_of_name("E12"), satellite_of_name("C20")))
    expected = [
        Match.UNHEALTHY,
        Match.EPHEMERIS_TOO_OLD,
        Match.NO_EPHEMERIS,
        Match.NO_CORRECTIONS,
        Match.NO_CORRECTIONS,
    ]
    assert [pair(found, row) for row in range(5)] == expected
    assert np.all(np.isnan(found.corrections[:, ORBIT]))
    assert reason(found, System.BEIDOU, LIMITS) == "no corrections for BeiDou: none received"
    one = ask(made, 1.0, satellites=(G05,))
    assert reason(one, System.GPS, LIMITS, 1.0) == "all satellites of GPS are unhealthy"
    assert made[1].last_epoch_ns(System.GPS, FAR) == T0
    assert made[1].last_epoch_ns(System.BEIDOU, FAR) is None


def test_high_rate_clocks_stand_on_their_clock():
    base = [orbit(0), clock(0, 0.1)]
    rate = clock(4, 0.02, high_rate=True)
    assert ask(books([ephemeris(10)], [*base, rate]), 5.0).corrections[0, HIGH_RATE_CLOCK] == 0.02
    for other in (clock(4, 0.02, high_rate=True, iod=2), clock(-1, 0.02, high_rate=True)):
        assert ask(books([ephemeris(10)], [*base, other]), 5.0).corrections[0, HIGH_RATE_CLOCK] == 0.0
    assert ask(books([ephemeris(10)], [*base, rate]), 15.0).corrections[0, HIGH_RATE_CLOCK] == 0.0


def test_the_first_provider_stays_until_it_is_silent():
    first = [orbit(0, radial=1.0), clock(0, 0.1)]
    other = [orbit(5, radial=9.0, provider=270), clock(5, 0.9, provider=270)]
    made = books([ephemeris(10)], [*first, *other])
    assert pair(ask(made, 6.0)) == (1.0, 0.1, 10)
    assert made[1].state(System.GPS, FAR).ignored == 2
    later = [orbit(70, radial=9.0, provider=270), clock(70, 0.9, provider=270)]
    assert pair(ask(books([ephemeris(10)], [*first, *later]), 71.0)) == (9.0, 0.9, 10)


def bias(t, value, signal=C1C, provider=260, kind=SsrCodeBias, counter=3):
    one = np.ones(1)
    values = (header(t, provider=provider), np.array([G05], np.int16), np.array([signal], np.int16), value * one)
    if kind is SsrCodeBias:
        return SsrCodeBias(*values)
    return SsrPhaseBias(*values, one == 1, one.astype(np.int64) * 2, one.astype(np.int64) * counter, 0.1 * one, 0 * one)


def test_biases_by_signal_and_age():
    book = CorrectionBook()
    for record in (bias(0, 1.5), bias(10, 0.25, C2W), bias(20, 0.125, C2W, kind=SsrPhaseBias)):
        book.add(record)
    satellites = np.array([G05, G05, G06, E11], dtype=np.int16)
    signals = np.array([C1C, C2W, C1C, signal_id(System.GALILEO, "1C")], dtype=np.int16)
    code = book.code_biases(satellites, signals, at(60), FAR, LIMITS).bias_m
    np.testing.assert_array_equal(code, [1.5, 0.25, np.nan, np.nan])
    phase = book.phase_biases(satellites, signals, at(60), FAR, LIMITS)
    np.testing.assert_array_equal(phase.bias_m, [np.nan, 0.125, np.nan, np.nan])
    assert phase.discontinuity.tolist() == [-1, 3, -1, -1]
    assert phase.integer.tolist() == [False, True, False, False]
    assert phase.wide_lane_integer.tolist() == [-1, 2, -1, -1]
    old = book.code_biases(satellites[:2], signals[:2], at(7205), FAR, LIMITS).bias_m
    np.testing.assert_array_equal(old, [np.nan, 0.25])
    before = book.code_biases(satellites[:2], signals[:2], at(60), at(5), LIMITS).bias_m
    np.testing.assert_array_equal(before, [1.5, np.nan])


def test_biases_of_another_provider_than_the_clocks_are_not_mixed_in():
    book = CorrectionBook()
    for record in (bias(0, 9.0, provider=270), orbit(1), clock(1), bias(2, 8.0, C2W, provider=270)):
        book.add(record)
    rows = np.array([G05, G05], np.int16), np.array([C1C, C2W], np.int16)
    assert np.all(np.isnan(book.code_biases(*rows, at(3), FAR, LIMITS).bias_m))
    book.add(bias(3, 1.0))
    np.testing.assert_array_equal(book.code_biases(*rows, at(4), FAR, LIMITS).bias_m, [1.0, np.nan])


def test_the_ionosphere_is_kept():
    book = CorrectionBook()
    vtec = SsrVtec(header(0), 1.0, (450.0,), (np.zeros((2, 2)),), (np.zeros((2, 2)),))
    book.add(vtec)
    assert book.vtec(at(1)) is vtec
    assert book.vtec(at(0)) is None


def test_late_messages_change_nothing():
    records = [orbit(0, radial=1.0), clock(10, 0.2), clock(5, 0.1, received=11.0)]
    assert pair(ask(books([ephemeris(10)], records), 12.0)) == (1.0, 0.2, 10)


def stream(n):
    """Some minutes of a service: orbits every 30 s with changing issue and IOD SSR, clocks every 5 s, two systems."""
    records = []
    for k in range(n):
        t, satellites = 5 * (k // 2), (G05, G06) if k % 2 else (E11,)
        iod = t // 120 % 16
        if t % 30 == 0:
            records.append(orbit(t, 10 + t // 90, t / 100, satellites, iod=iod, received=t + 0.1 * (k % 2)))
        records.append(clock(t, t / 1000, satellites, iod=iod, received=t + 0.2 + 0.1 * (k % 2)))
    return records


def snapshot(book, as_of):
    states = book.states(at(as_of))
    return {s: (c.orbits.orbit_ints.tobytes(), c.orbits.clock.tobytes(), c.provider) for s, c in sorted(states.items())}


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.integers(1, 200), st.floats(0, 170)), min_size=1, max_size=12))
def test_a_question_about_the_past_gets_the_answer_of_the_past(questions):
    """Fed on and asked in any order, the book answers as one that had only received what came by then."""
    records, book, fed = stream(600), CorrectionBook(), 0
    for more, back in questions:
        for record in records[fed : fed + more]:
            book.add(record)
        fed = min(fed + more, len(records))
        as_of = (records[fed - 1].header.t_receive_ns - T0) / NS_PER_S - back
        fresh = CorrectionBook(history_s=1e6)
        for record in records[:fed]:
            if record.header.t_receive_ns <= at(as_of):
                fresh.add(record)
        assert snapshot(book, as_of) == snapshot(fresh, 1e6)


def test_memory_is_bounded_and_pickling_changes_nothing():
    book, sizes = CorrectionBook(), []
    for k, record in enumerate(stream(2400)):
        book.add(record)
        if k % 100 == 0:
            book.states(record.header.t_receive_ns)
            sizes.append(len(book._log))
    assert max(sizes) < 300
    assert len(book._known) < 8
    copy = pickle.loads(pickle.dumps(book))
    end = 5 * 1200
    for as_of in (end, end - 100, end - 170):
        assert snapshot(copy, as_of) == snapshot(book, as_of)


def test_records_of_several_systems_are_taken_apart():
    mixed = replace(orbit(0, radial=1.0, satellites=(G05, E11)), issue=np.array([10, 20]))
    made = books([ephemeris(10), ephemeris(20, E11)], [mixed, clock(0, 0.5, satellites=(G05, E11))])
    found = ask(made, 1.0, satellites=(E11, G05))
    assert [pair(found, 0), pair(found, 1)] == [(1.0, 0.5, 20), (1.0, 0.5, 10)]


@pytest.mark.parametrize("issues", [(10, 11)])
def test_as_of_decides_between_updates(issues):
    records = [orbit(0, issues[0], 1.0), clock(0, 0.1), orbit(10, issues[1], 2.0), clock(10, 0.2)]
    made = books([ephemeris(10), ephemeris(11)], records)
    assert pair(ask(made, 11.0, as_of=10.4)) == (1.0, 0.1, 10)
    assert pair(ask(made, 11.0, as_of=10.6)) == (2.0, 0.2, 11)
    assert pair(ask(made, 11.0, as_of=0.4)) is Match.NO_CORRECTIONS
