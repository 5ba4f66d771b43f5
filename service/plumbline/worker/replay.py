"""An archive through the pipelines again: what live processing made of it, row for row."""

from collections.abc import Iterator, Mapping, Sequence

from plumbline.archive import Archive, replay
from plumbline.bus.messages import StationConfig
from plumbline.config import Mode
from plumbline.gps_time import NS_PER_S
from plumbline.records import Output
from plumbline.worker.processing import Processing, real_processing
from plumbline.worker.shared_books import SharedBooks
from plumbline.worker.station import StationRunner

QUIET_NS = 60 * NS_PER_S


def replay_archive(
    archive: Archive,
    configs: Sequence[StationConfig],
    from_ns: int | None = None,
    to_ns: int | None = None,
    processing: Processing | None = None,
) -> Iterator[Output]:
    """Outputs of all stations from an archive's bytes with ``from_ns`` ≤ receive time < ``to_ns`` (GPS ns).

    Correction streams among ``configs`` feed the books. A minute of silence is assumed to follow, as it closes the last
    epochs.
    """
    processing = processing or real_processing()
    books = SharedBooks(processing)
    present = [config for config in configs if config.settings is not None]
    corrections = [c.station for c in present if c.settings and c.settings.mode is Mode.CORRECTIONS]
    books.restore((), corrections, needed_ns=0)
    stations = {c.station: c for c in present if c.station not in corrections}
    runners = {
        name: StationRunner(processing, c, books.books, None, _named(c, stations)) for name, c in stations.items()
    }
    last_ns = 0
    for chunk in replay(archive, [config.station for config in present], from_ns, to_ns):
        last_ns = chunk.t_receive_ns
        if chunk.station in books:
            books.receive(chunk)
            continue
        for name, runner in runners.items():
            if chunk.station == name or chunk.station in runner.neighbours:
                yield from runner.receive(chunk)
    for runner in runners.values():
        yield from runner.advance(last_ns + QUIET_NS)


def _named(config: StationConfig, stations: Mapping[str, StationConfig]) -> list[StationConfig]:
    """The neighbours that a station's settings name."""
    names = config.settings.neighbours if config.settings is not None else ()
    return [stations[name] for name in names if name in stations and name != config.station]
