"""Stations, thresholds, devices and alerts on both databases. Oracle: a plain model of each table's rules."""

from dataclasses import replace

import pytest

from plumbline.config import DeviceSettings, StationSettings
from plumbline.records import AlertEvent, AlertState, Severity, Threshold
from plumbline.store import Checkpoint, Device, Store

T0 = 1_400_000_000_000_000_000


async def test_a_station_is_created_changed_and_deleted(store: Store) -> None:
    settings = StationSettings(station="bridge-1", name="Brücke", device=DeviceSettings(registrations=("IMEI\\x00",)))
    row = await store.create_station(settings)
    assert row is not None
    assert (row.settings, row.version) == (settings, 1)
    assert await store.create_station(settings) is None
    changed = settings.model_copy(update={"name": "Bridge"})
    assert (await store.change_station(changed, expected_version=7)) is None
    after = await store.change_station(changed, expected_version=1)
    assert after is not None
    assert (after.settings, after.version, after.created_gps_ns) == (changed, 2, row.created_gps_ns)
    assert await store.station("bridge-1") == after
    assert await store.delete_station("bridge-1")
    assert not await store.delete_station("bridge-1")
    assert await store.station("bridge-1") is None
    assert await store.change_station(changed) is None


async def test_pages_of_stations_are_in_byte_order(store: Store) -> None:
    names = ["a", "B", "a.b", "a-b", "Z9", "10", "9", "a_b", "ab"]
    for name in names:
        await store.create_station(StationSettings(station=name))
    seen: list[str] = []
    cursor = None
    while True:
        page = await store.stations_page(2, cursor)
        seen += [row.settings.station for row in page.items]
        cursor = page.next
        if cursor is None:
            break
    assert seen == sorted(names, key=str.encode)
    assert [row.settings.station for row in await store.stations()] == seen


async def test_a_new_station_does_not_inherit_a_checkpoint(store: Store) -> None:
    settings = StationSettings(station="a")
    await store.create_station(settings)
    await store.delete_station("a")
    await store.write([], [Checkpoint("a", 1, b"late", {})])  # a worker that had not heard of it yet
    await store.create_station(settings)
    assert await store.checkpoint("a") is None


async def test_seeding_adds_and_never_overwrites(store: Store) -> None:
    mine = StationSettings(station="a", name="mine")
    await store.create_station(mine)
    threshold = Threshold("t", "b", "displacement_east", 0.05)
    await store.seed([StationSettings(station="a", name="seed"), StationSettings(station="b")], [threshold])
    await store.seed([StationSettings(station="b", name="again")], [replace(threshold, level=9.0)])
    assert [row.settings.name for row in await store.stations()] == ["mine", ""]
    assert await store.thresholds() == (threshold,)


async def test_thresholds(store: Store) -> None:
    first = Threshold("t1", "a", "displacement_horizontal", 0.05, Severity.WARNING, 1.0, 2.0, 0.01, False)
    second = Threshold("t2", "b", "displacement_up", 0.1)
    assert await store.create_threshold(first)
    assert await store.create_threshold(second)
    assert not await store.create_threshold(second)
    assert await store.thresholds() == (first, second)
    assert await store.thresholds("b") == (second,)
    changed = replace(first, level=0.07, enabled=True)
    assert await store.change_threshold(changed)
    assert not await store.change_threshold(replace(first, threshold_id="none"))
    assert await store.threshold("t1") == changed
    assert await store.delete_threshold("t1")
    assert not await store.delete_threshold("t1")
    await store.create_station(StationSettings(station="b"))
    await store.delete_station("b")
    assert await store.thresholds() == ()


def event(state: AlertState, t: int, alert_id: str = "a/t/0", value: float = 0.06) -> AlertEvent:
    text = f"{state.value} at {value}"
    return AlertEvent(
        alert_id, "a", "t", state, Severity.ALARM, T0 + t, T0, T0 + t, "displacement_east", value, 0.05, text
    )


async def test_the_life_of_an_alert(store: Store) -> None:
    await store.write([event(AlertState.ACTIVE, 1)])
    assert [e.alert_id for e in await store.open_alert_events("a")] == ["a/t/0"]
    (row,) = (await store.alerts(state="active")).items
    assert (row.state, row.t_onset_gps_ns, row.t_active_gps_ns) == (AlertState.ACTIVE, T0, T0 + 1)
    seen = await store.acknowledge("a/t/0", "Ada", "on my way")
    assert seen is not None
    assert (seen.state, seen.acknowledged_by) == (AlertState.ACKNOWLEDGED, "Ada")
    again = await store.acknowledge("a/t/0", "Bob")
    assert again == seen
    await store.write([event(AlertState.ACTIVE, 1)])  # replayed after the acknowledgement
    assert (await store.alert("a/t/0")) == seen
    await store.comment("a/t/0", "Ada", "a lorry")
    await store.write([event(AlertState.CLEARED, 9, value=0.01)])
    await store.write([event(AlertState.CLEARED, 9, value=0.01)])
    done = await store.alert("a/t/0")
    assert done is not None
    assert (done.state, done.t_cleared_gps_ns, done.value) == (AlertState.CLEARED, T0 + 9, 0.06)
    assert sorted(note.kind for note in done.history) == ["acknowledged", "active", "cleared", "comment"]
    assert await store.open_alert_events("a") == ()
    assert await store.acknowledge("none") is None
    assert await store.comment("none", "", "x") is None


async def test_a_threshold_that_goes_leaves_no_alert_active(store: Store) -> None:
    threshold = Threshold("t", "a", "displacement_east", 0.05)
    await store.create_threshold(threshold)
    await store.write([event(AlertState.ACTIVE, 1)])
    await store.change_threshold(replace(threshold, level=0.06))
    assert len(await store.open_alert_events("a")) == 1
    await store.change_threshold(replace(threshold, enabled=False))
    row = await store.alert("a/t/0")
    assert row is not None
    assert row.state is AlertState.CLEARED
    assert row.history[-1].text == "the threshold was changed"
    await store.write([event(AlertState.ACTIVE, 5, "a/t/5")])
    await store.delete_threshold("t")
    assert await store.open_alert_events("a") == ()


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
async def test_an_alert_ends_cleared_in_whatever_order_its_events_come(store: Store, order: tuple[int, int]) -> None:
    events = [event(AlertState.ACTIVE, 1), event(AlertState.CLEARED, 2)]
    for i in order:
        await store.write([events[i]])
    row = await store.alert("a/t/0")
    assert row is not None
    assert row.state is AlertState.CLEARED


async def test_lists_of_alerts_by_state_station_and_time(store: Store) -> None:
    for i in range(12):
        await store.write([event(AlertState.ACTIVE, 10 * (i // 3), f"a/{i:02d}")])
        if i % 2:
            await store.write([event(AlertState.CLEARED, 200, f"a/{i:02d}")])
    expected = [f"a/{i:02d}" for i in sorted(range(12), key=lambda i: (-(i // 3), -i))]
    seen, cursor = [], None
    while True:
        page = await store.alerts(limit=5, cursor=cursor)
        seen += [row.alert_id for row in page.items]
        cursor = page.next
        if cursor is None:
            break
    assert seen == expected
    assert [r.alert_id for r in (await store.alerts(state="cleared")).items] == [a for a in expected if int(a[2:]) % 2]
    assert not (await store.alerts(station="b")).items
    assert len((await store.alerts(start_gps_ns=T0 + 10, end_gps_ns=T0 + 30)).items) == 6


async def test_devices_are_remembered_and_adopted(store: Store) -> None:
    await store.save_devices([Device("866\\x00", "10.0.0.1", 5, 5)])
    await store.save_devices([Device("866\\x00", "10.0.0.2", 8, 9, 3, "unknown"), Device("x", "10.0.0.3", 1, 1)])
    first, second = await store.devices()
    assert first == Device("866\\x00", "10.0.0.2", 5, 9, 3, "unknown")
    adopted = await store.adopt_device(second, "a")
    assert adopted.station == "a"
    await store.save_devices([Device("x", "10.0.0.3", 2, 12)])
    assert (await store.devices())[0] == Device("x", "10.0.0.3", 1, 12, station="a")
