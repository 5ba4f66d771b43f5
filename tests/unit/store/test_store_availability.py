"""The book of days. Oracle: lives and days written down by hand, read back the same."""

from plumbline.app.day_keeper import DayKeeper
from plumbline.config import StationSettings
from plumbline.gps_time import DAY_NS, NS_PER_S
from plumbline.quality.availability import availability, day_start_ns
from plumbline.records import Solution, Status
from plumbline.store import Store

DAY = day_start_ns(1_400_000_000 * NS_PER_S)
HOUR = 3600 * NS_PER_S


def epoch(t_ns: int, status: Status = Status.PPP_FLOAT) -> Solution:
    return Solution("dam", t_ns, t_ns + NS_PER_S // 2, status, "" if status is Status.PPP_FLOAT else "no corrections")


async def test_between_two_lives_the_server_was_down(store: Store) -> None:
    assert await store.downtimes() == ()
    for start, now in ((10, 12), (10, 20), (10, 15), (30, 40), (35, 50), (60, 61)):
        await store.note_alive(start * NS_PER_S, now * NS_PER_S)
    assert await store.downtimes() == tuple((a * NS_PER_S, b * NS_PER_S) for a, b in ((20, 30), (50, 60)))


async def test_a_day_that_is_over_is_kept_once_and_read_back(store: Store) -> None:
    await store.create_station(StationSettings(station="dam"))
    came = [epoch(DAY + k * HOUR, Status.PPP_FLOAT if k % 5 else Status.NO_CORRECTIONS) for k in range(30) if k != 7]
    await store.write(came)
    keeper = DayKeeper(store)
    await keeper.close_days(DAY + 29 * HOUR)
    days = await store.days("dam", 0, 2**62)
    assert list(days) == [DAY]
    first = [s for s in came if s.t_gps_ns < DAY + DAY_NS]
    assert days[DAY] == availability(first, DAY, DAY + DAY_NS, ())
    assert [gap.reason for gap in days[DAY].gaps].count("no observations received") == 1
    await keeper.close_days(DAY + 100 * HOUR)  # silent since: the days after are gaps, and rows all the same
    later = await store.days("dam", 0, 2**62)
    assert list(later) == [DAY + k * DAY_NS for k in range(4)]
    assert later[DAY + 2 * DAY_NS].received == 0
    assert later[DAY + 2 * DAY_NS].gaps
    assert later[DAY] == days[DAY]
