"""The base's epochs as of a receive time, and when a rover's epoch waits for one. Oracle: the rules in words."""

import numpy as np

from plumbline.config import RtkSettings
from plumbline.epochs.base_book import BaseBook
from plumbline.positioning.rtk_base import base_view, due_until_ns, network_due_until_ns, network_views
from plumbline.records import AntennaDescription, Epoch

SECOND = 1_000_000_000
T = 1_300_000_000 * SECOND


def _epoch(t_gps_ns: int, t_receive_ns: int) -> Epoch:
    none, ids = np.zeros(0), np.zeros(0, np.int16)
    flags = np.zeros(0, bool)
    return Epoch(t_gps_ns, t_receive_ns, ids, ids, none, none, none, none, none, flags, np.zeros(0, np.int8))


def _book(seconds: range, delay_ns: int = 100_000_000) -> BaseBook:
    book = BaseBook()
    for s in seconds:
        book.add(_epoch(T + s * SECOND, T + s * SECOND + delay_ns))
    return book


def test_the_epoch_of_the_instant_else_the_last_before_it_as_received() -> None:
    book = _book(range(10))
    at = book.at(T + 5 * SECOND, T + 20 * SECOND)
    assert at is not None
    assert at.t_gps_ns == T + 5 * SECOND
    early = book.at(T + 5 * SECOND, T + 5 * SECOND + 50_000_000)
    assert early is not None
    assert early.t_gps_ns == T + 4 * SECOND
    between = book.at(T + 5 * SECOND + 400_000_000, T + 20 * SECOND)
    assert between is not None
    assert between.t_gps_ns == T + 5 * SECOND
    assert book.at(T - SECOND, T + 20 * SECOND) is None


def test_a_minute_is_kept_and_old_epochs_are_refused() -> None:
    book = _book(range(200))
    assert len(book.epochs) <= 61
    newest = book.epochs[-1]
    book.add(_epoch(T + 150 * SECOND, T + 300 * SECOND))
    assert book.epochs[-1] is newest
    book.add(_epoch(T - 7 * 86_400 * SECOND, T + 301 * SECOND))  # the series has gone back altogether
    assert len(book.epochs) == 1


def test_waiting_ends_with_the_epoch_or_the_deadline_and_answers_alike() -> None:
    settings = RtkSettings(base_stream="b", base_wait_s=0.3)
    rover = _epoch(T + 5 * SECOND, T + 5 * SECOND + 20_000_000)
    deadline = rover.t_receive_ns + 300_000_000
    waiting = {"b": _book(range(5))}
    assert due_until_ns(waiting, rover, rover.t_receive_ns, settings) is None
    assert due_until_ns(waiting, rover, deadline - 1, settings) is None
    assert due_until_ns(waiting, rover, deadline, settings) == deadline
    there = {"b": _book(range(6))}
    assert due_until_ns(there, rover, T + 5 * SECOND + 100_000_000, settings) == deadline
    ahead = {"b": _book(range(8))}  # the books may have been fed further than the rover
    assert due_until_ns(ahead, rover, T + 5 * SECOND + 100_000_000, settings) == deadline
    between = _epoch(T + 4 * SECOND + 500_000_000, T + 4 * SECOND + 520_000_000)  # a base at 1 Hz has none for it
    assert due_until_ns(there, between, between.t_receive_ns, settings) == between.t_receive_ns
    silent = _epoch(T + 30 * SECOND, T + 30 * SECOND)
    assert due_until_ns(waiting, silent, silent.t_receive_ns, settings) == silent.t_receive_ns


def test_a_setting_for_the_position_comes_first_and_missing_things_are_said() -> None:
    book = _book(range(3))
    late = T + 10 * SECOND
    assert base_view({"b": book}, late, late, RtkSettings()).position_ecef_m is None
    book.describe(AntennaDescription(0, (1.0, 2.0, 3.0)), T + SECOND)
    told = base_view({"b": book}, late, late, RtkSettings())
    assert told.position_ecef_m is not None
    assert told.position_ecef_m.tolist() == [1.0, 2.0, 3.0]
    assert base_view({"b": book}, T, T + 200_000_000, RtkSettings()).position_ecef_m is None
    given = base_view({"b": book}, late, late, RtkSettings(base_position_ecef_m=(4.0, 5.0, 6.0)))
    assert given.position_ecef_m is not None
    assert given.position_ecef_m.tolist() == [4.0, 5.0, 6.0]
    assert "no observations of base c yet" in base_view({"b": book}, late, late, RtkSettings(base_stream="c")).reason
    several = base_view({"a": book, "b": book}, late, late, RtkSettings())
    assert "no base stream is set" in several.reason
    assert "a, b" in several.reason


def test_a_network_waits_for_its_slowest_base() -> None:
    settings = RtkSettings(base_wait_s=0.3)
    rover = _epoch(T + 5 * SECOND, T + 5 * SECOND + 20_000_000)
    now = T + 5 * SECOND + 150_000_000
    there, missing = _book(range(6)), _book(range(5))
    deadline = rover.t_receive_ns + 300_000_000
    assert network_due_until_ns({"a": there, "b": missing}, rover, now, settings) is None
    assert network_due_until_ns({"a": there, "b": there}, rover, now, settings) == deadline
    assert network_due_until_ns({"a": there, "b": missing}, rover, deadline, settings) == deadline
    assert network_due_until_ns({}, rover, rover.t_receive_ns, settings) == rover.t_receive_ns
    named = RtkSettings(base_wait_s=0.3, base_streams=("b",), base_position_ecef_m=(1.0, 2.0, 3.0))
    views = network_views({"a": there, "b": missing}, rover.t_gps_ns, deadline, named)
    assert [view.station for view in views] == ["b"]
    assert views[0].position_ecef_m is None  # one setting cannot be the position of several
    assert "no base stream is set" in network_views({}, rover.t_gps_ns, deadline, settings)[0].reason
