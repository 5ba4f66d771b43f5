"""Solutions, motion and checkpoints on both databases.

Oracles: what was written (identity up to the documented quantum), and NumPy's statistics of the very samples that the
store gives back, for every summary.
"""

import asyncio
import math
from collections.abc import Iterable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sqlalchemy import select

from plumbline.gps_time import DAY_NS, NS_PER_S
from plumbline.records import AlertEvent, AlertState, Motion, Severity, Solution, StationStatus, Status
from plumbline.store import Checkpoint, Store
from plumbline.store.tables import metadata

T0 = 1_400_000 * 1000 * NS_PER_S
VECTORS = ("velocity_enu_m_s", "acceleration_enu_m_s2", "sigma_displacement_enu_m")
INTERVAL_NS = 100_000_000  # ten samples a block: small, and yet several a second


def solution(t_gps_ns: int, station: str = "a", **changes: Any) -> Solution:
    values: dict[str, Any] = {
        "status": Status.PPP_FLOAT,
        "reason": "",
        "n_satellites": 17,
        "position_ecef_m": np.array([4.0e6, 5.0e5, 4.9e6]) + 1e-9 * (t_gps_ns % 997),
        "displacement_enu_m": np.array([0.001, -0.002, 0.003]),
        "covariance_enu_m2": np.array([[4.0, 1.0, 2.0], [1.0, 5.0, 3.0], [2.0, 3.0, 6.0]]) * 1e-6,
        "velocity_enu_m_s": np.array([0.1, 0.2, 0.3]),
        "systems": "GE",
        "zenith_delay_m": 2.4123,
        "receiver_clock_s": -1.5e-7,
        "correction_age_s": 7.25,
        "pdop": 1.6,
        "extras": {"ratio": 3.5},
    }
    return Solution(station, t_gps_ns, t_gps_ns + 7, **(values | changes))


def block(second: int, station: str = "a", revision: int = 0, n: int = 10, t_gps_ns: int | None = None) -> Motion:
    rng = np.random.default_rng([second, revision])
    d, v, a, s = (rng.normal(0, scale, (n, 3)) for scale in (0.004, 0.0007, 0.005, 0.001))
    first = T0 + second * NS_PER_S if t_gps_ns is None else t_gps_ns
    status, reason = (Status.PPP_FLOAT, "") if revision else (Status.COASTING, "no displacement from GNSS for 12 s")
    return Motion(station, first, first + NS_PER_S, INTERVAL_NS, d, v, a, s, status, revision, reason)


def same(left: Any, right: Any) -> bool:
    """Whether two records hold the same, arrays by value."""
    for f in fields(left):
        a, b = getattr(left, f.name), getattr(right, f.name)
        if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
            if not np.array_equal(a, b, equal_nan=True):
                return False
        elif a != b:
            return False
    return True


async def dump(store: Store) -> dict[str, list[tuple[Any, ...]]]:
    """Every row of every table."""
    return await store._read(
        lambda connection: {
            table.name: sorted(map(tuple, connection.execute(select(table)).all()), key=repr)
            for table in metadata.tables.values()
        }
    )


async def test_solutions_come_back_as_they_were(store: Store) -> None:
    bare = Solution("a", T0 + 1, T0 + 2, Status.NO_CORRECTIONS, "no corrections for Galileo: last 74 s ago, limit 30 s")
    written = [solution(T0), bare, solution(T0 + NS_PER_S, covariance_enu_m2=None, pdop=None, extras={})]
    await store.write(written)
    read = (await store.solutions("a")).items
    assert len(read) == 3
    assert all(same(a, b) for a, b in zip(written, read, strict=True))
    assert same(await store.latest_solution("a"), written[2])
    assert await store.latest_solution("b") is None


async def test_attitudes_come_back(store: Store) -> None:
    """Of solutions as they were, what antennas do not tell missing; of samples to within half a microradian."""
    pair = solution(T0, attitude_rad=np.array([0.01, np.nan, 6.1]), sigma_attitude_rad=np.array([0.002, np.nan, 0.001]))
    rng = np.random.default_rng(7)
    turned = replace(
        block(0), attitude_rad=rng.uniform(-1, 6, (10, 3)), sigma_attitude_rad=rng.uniform(0, 0.1, (10, 3))
    )
    await store.write([pair, turned, block(1)])
    read = (await store.solutions("a")).items[0]
    assert same(read, pair)
    series = await store.motion("a", bucket_ns=0)
    assert series.attitude_rad is not None
    assert series.sigma_attitude_rad is not None
    assert np.abs(series.attitude_rad[:10] - turned.attitude_rad).max() <= 0.5e-6 * (1 + 1e-9)
    assert np.abs(series.sigma_attitude_rad[:10] - turned.sigma_attitude_rad).max() <= 0.5e-6 * (1 + 1e-9)
    assert np.isnan(series.attitude_rad[10:]).all()
    whole = (await store.motion_blocks("a"))[0]
    assert whole.attitude_rad is not None
    assert np.array_equal(whole.attitude_rad, series.attitude_rad[:10])


async def test_pages_hold_every_solution_once(store: Store) -> None:
    await store.write([solution(T0 + i * NS_PER_S) for i in range(25)] + [solution(T0, "b")])
    times, cursor, pages = [], None, 0
    while True:
        page = await store.solutions("a", T0 + 2 * NS_PER_S, T0 + 24 * NS_PER_S, 7, cursor)
        times += [item.t_gps_ns for item in page.items]
        pages, cursor = pages + 1, page.next
        if cursor is None:
            break
    assert times == [T0 + i * NS_PER_S for i in range(2, 24)]
    assert pages == math.ceil(22 / 7)


async def test_a_foreign_cursor_is_a_value_error(store: Store) -> None:
    for cursor in ("", "!", "WyJhIl0", "é", "bnVsbA", "WzFlOTld", "W10"):
        with pytest.raises(ValueError, match="cursor"):
            await store.solutions("a", cursor=cursor)


def everything() -> list[Any]:
    events = [
        AlertEvent("a/1", "a", "t", state, Severity.ALARM, T0 + i, T0, T0, "displacement_east", 0.1, 0.05, "far")
        for i, state in enumerate((AlertState.ACTIVE, AlertState.CLEARED))
    ]
    status = StationStatus("a", T0, "receiving", "", T0, Status.PPP_FLOAT, 12, {"frames": 3})
    return [solution(T0), solution(T0 + 1), *events, status, *(block(i) for i in range(130)), block(5, revision=2)]


async def test_writing_twice_changes_nothing(store: Store) -> None:
    checkpoints = [Checkpoint("a", T0, b"\x00state", {"a": 4096, "ssr": 17})]
    await store.write(everything(), checkpoints)
    before = await dump(store)
    assert all(before[name] for name in ("solutions", "motion", "motion_summaries", "alerts", "checkpoints"))
    await store.write(everything(), checkpoints)
    await store.write(list(reversed(everything())), checkpoints)
    assert await dump(store) == before


async def test_the_order_of_writing_does_not_matter(store: Store) -> None:
    rng = np.random.default_rng(0)
    blocks = [block(i) for i in range(90)] + [block(i, revision=1) for i in range(0, 90, 7)]
    await store.write(blocks)
    before = await dump(store)
    await store._write(
        lambda connection: [connection.execute(metadata.tables[t].delete()) for t in ("motion", "motion_summaries")]
    )
    for i in rng.permutation(len(blocks)):
        await store.write([blocks[i]])
    assert await dump(store) == before


async def test_a_higher_revision_replaces_and_a_lower_never_does(store: Store) -> None:
    for revision, expected in ((1, 1), (0, 1), (3, 3), (2, 3), (3, 3)):
        await store.write([block(0, revision=revision)])
        (stored,) = await store.motion_blocks("a")
        assert stored.revision == expected
        assert (stored.status, stored.reason) == (
            block(0, revision=expected).status,
            block(0, revision=expected).reason,
        )
        assert np.abs(stored.displacement_enu_m - block(0, revision=expected).displacement_enu_m).max() <= 5.001e-6
        (mean,) = (await store.motion("a", bucket_ns=DAY_NS)).displacement_enu_m
        assert np.allclose(mean, stored.displacement_enu_m.mean(axis=0), atol=1e-12)


def check_buckets(series: Any, samples: Any) -> None:
    """Every bucket's statistics are NumPy's of the samples in it."""
    values = np.hstack((samples.displacement_enu_m, samples.velocity_enu_m_s, samples.acceleration_enu_m_s2))
    utc_ns = samples.t_gps_ns - 18 * NS_PER_S
    bucket = utc_ns // series.bucket_ns * series.bucket_ns + 18 * NS_PER_S
    assert np.array_equal(series.t_gps_ns, np.unique(bucket))
    for i, t in enumerate(series.t_gps_ns):
        inside = values[bucket == t]
        assert series.count[i] == len(inside)
        assert np.array_equal(series.summary.minimum[i], inside.min(axis=0))
        assert np.array_equal(series.summary.maximum[i], inside.max(axis=0))
        assert np.allclose(series.summary.mean[i], inside.mean(axis=0), atol=1e-12)
        assert np.allclose(series.summary.rms[i], np.sqrt((inside**2).mean(axis=0)), atol=1e-12)


async def test_summaries_are_numpys_of_the_samples(store: Store) -> None:
    seconds = [*range(200), *range(3600, 3700), *range(90_000, 90_003)]
    await store.write([block(s, n=10 if s % 3 else 7) for s in seconds])
    samples = await store.motion("a", max_points=10_000)
    assert samples.bucket_ns == 0
    assert len(samples.t_gps_ns) == sum(10 if s % 3 else 7 for s in seconds)
    for bucket_s in (1, 5, 60, 900, 3600, 86_400, 5 * 86_400):
        check_buckets(await store.motion("a", bucket_ns=bucket_s * NS_PER_S, max_points=5000), samples)


async def test_blocks_that_cross_seconds_and_overlap_keep_the_newer_samples(store: Store) -> None:
    crossing = block(0, n=25, t_gps_ns=T0 + 350_000_000)
    newer = block(1, revision=1)
    await store.write([crossing, newer])
    series = await store.motion("a", max_points=100)
    times = np.union1d(
        crossing.t_first_gps_ns + INTERVAL_NS * np.arange(25), newer.t_first_gps_ns + INTERVAL_NS * np.arange(10)
    )
    assert np.array_equal(series.t_gps_ns, times)
    at_newer = np.isin(series.t_gps_ns, newer.t_first_gps_ns + INTERVAL_NS * np.arange(10))
    assert np.abs(series.displacement_enu_m[at_newer] - newer.displacement_enu_m).max() <= 5.001e-6
    count = (await store.motion("a", bucket_ns=60 * NS_PER_S)).count.sum()
    assert count == 35  # a summary counts what is stored


async def test_missing_channels_have_no_statistics(store: Store) -> None:
    whole = block(0)
    nothing = np.full((10, 3), np.nan)
    await store.write(
        [Motion("a", T0, T0, INTERVAL_NS, whole.displacement_enu_m, nothing, nothing, nothing, whole.status)]
    )
    series = await store.motion("a", bucket_ns=60 * NS_PER_S)
    assert series.summary is not None
    assert np.isfinite(series.displacement_enu_m).all()
    assert np.isnan(series.velocity_enu_m_s).all()
    assert np.isnan(series.summary.rms[:, 3:]).all()


def spans() -> Iterable[Any]:
    edge = st.none() | st.integers(T0 - 5 * NS_PER_S, T0 + 4000 * NS_PER_S)
    return (edge, edge, st.integers(1, 3000), st.sampled_from([None, 0, NS_PER_S, 60 * NS_PER_S, 3600 * NS_PER_S]))


async def test_never_more_points_than_asked_and_none_lost(tmp_path: Any) -> None:
    store = await Store.open(f"sqlite:///{tmp_path / 'm.sqlite'}", readers=1)
    await store.write([block(s) for s in (*range(300), *range(2000, 2040))])
    every = await store.motion("a", bucket_ns=0, max_points=10**6)
    loop = asyncio.get_running_loop()

    def run(start: int | None, end: int | None, max_points: int, bucket_ns: int | None) -> None:
        series = asyncio.run_coroutine_threadsafe(store.motion("a", start, end, max_points, bucket_ns), loop).result(10)
        assert len(series.t_gps_ns) <= max_points
        assert (np.diff(series.t_gps_ns) > 0).all()
        inside = (every.t_gps_ns >= (start or 0)) & (every.t_gps_ns < (end or 2**62))
        if bucket_ns is None:
            assert series.next_start_gps_ns is None
            assert series.count.sum() >= inside.sum()  # whole buckets: at most a part more at the edges
        if series.bucket_ns == 0:
            assert np.array_equal(series.t_gps_ns, every.t_gps_ns[inside][:max_points])
            rest = every.t_gps_ns[inside][max_points:]
            assert series.next_start_gps_ns == (rest[0] if len(rest) else None)

    checked = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))(given(*spans())(run))
    try:
        await asyncio.to_thread(checked)
    finally:
        await store.close()


async def test_auto_takes_the_samples_when_they_fit(store: Store) -> None:
    await store.write([block(s) for s in range(100)])
    assert (await store.motion("a", max_points=1000)).bucket_ns == 0
    coarse = await store.motion("a", max_points=999)
    assert coarse.bucket_ns == NS_PER_S
    assert len(coarse.t_gps_ns) == 100
    assert (await store.motion("nobody", max_points=9)).t_gps_ns.size == 0


async def test_paging_through_explicit_buckets(store: Store) -> None:
    await store.write([block(s) for s in range(65)])
    seen: list[int] = []
    start: int | None = T0
    while start is not None:
        series = await store.motion("a", start, None, 20, NS_PER_S)
        seen += series.t_gps_ns.tolist()
        start = series.next_start_gps_ns
    assert seen == [T0 + s * NS_PER_S for s in range(65)]


async def test_a_failed_batch_leaves_nothing(store: Store) -> None:
    broken = Checkpoint("a", 2**70, b"", {})  # no database holds such a time
    with pytest.raises(Exception):  # noqa: B017 - which error is the driver's affair
        await store.write([solution(T0), block(0)], [broken])
    assert not (await store.solutions("a")).items
    assert not await store.motion_blocks("a")
    assert await store.checkpoint("a") is None
    await store.write([solution(T0)])
    assert len((await store.solutions("a")).items) == 1


async def test_only_a_newer_checkpoint_or_status_replaces(store: Store) -> None:
    def status(t: int) -> StationStatus:
        return StationStatus("a", t, "receiving", str(t), None, None, 0, {})

    for t, expected in ((5, 5), (3, 5), (9, 9)):
        await store.write([status(t)], [Checkpoint("a", t, bytes([t]), {"a": t})])
        assert await store.checkpoint("a") == Checkpoint("a", expected, bytes([expected]), {"a": expected})
        assert (await store.status("a")) == status(expected)
