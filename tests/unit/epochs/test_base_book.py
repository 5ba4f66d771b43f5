"""A base's epochs as of a receive time. Oracle: a book that has been given only what had come by then."""

import random

import numpy as np
import pytest

from plumbline.epochs.base_book import BaseBook
from plumbline.epochs.history import HISTORY_NS
from plumbline.gps_time import NS_PER_S
from plumbline.records import AntennaDescription, Epoch

START_NS = 1_400_000_000 * NS_PER_S


def epoch(t_gps_ns: int, t_receive_ns: int) -> Epoch:
    none, whole = np.empty(0), np.empty(0, np.int16)
    return Epoch(t_gps_ns, t_receive_ns, whole, whole, none, none, none, none, none, whole > 0, whole.astype(np.int8))


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("times_faster", [1, 100])
def test_late_questions_get_the_answers_of_their_time(seed: int, times_faster: int) -> None:
    choice = random.Random(seed)
    interval_ns = choice.choice((NS_PER_S // 20, NS_PER_S, 5 * NS_PER_S))
    book, arrivals = BaseBook(), []
    t_receive_ns = START_NS
    for i in range(4 * HISTORY_NS // max(interval_ns, NS_PER_S // 5) * min(times_faster, 4)):
        t_receive_ns = max(
            t_receive_ns + 1, START_NS + i * interval_ns // times_faster + choice.randrange(NS_PER_S // 5)
        )
        if choice.random() < 0.9:
            arrivals.append(epoch(START_NS + i * interval_ns, t_receive_ns))
            book.add(arrivals[-1])
    book.describe(AntennaDescription(0), t_receive_ns)
    for _ in range(30):
        as_of_ns = max(t_receive_ns - choice.randrange(HISTORY_NS - 20 * NS_PER_S), arrivals[0].t_receive_ns)
        of_then = BaseBook()
        for one in arrivals:
            if one.t_receive_ns <= as_of_ns:
                of_then.add(one)
        asked_ns = of_then.epochs[-1].t_gps_ns + choice.randrange(-4, 3) * interval_ns
        assert book.at(asked_ns, as_of_ns) is of_then.at(asked_ns, as_of_ns)
        assert book.is_due(asked_ns, as_of_ns) == of_then.is_due(asked_ns, as_of_ns)
        assert book.is_silent(as_of_ns) == of_then.is_silent(as_of_ns)
    assert book.description(t_receive_ns - 1) is None
