"""Recordings of two receivers side by side, decoded once: epochs in pairs, for runs with something put into them."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from plumbline.config import PositioningSettings, RtkSettings, StationSettings
from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.epochs.recording import read_recording
from plumbline.epochs.stream import Books, NavigationFeed
from plumbline.positioning import rtk
from plumbline.positioning.broadcast_source import BroadcastSource
from plumbline.positioning.facts import StationFacts
from plumbline.positioning.rtk_state import BaseView
from plumbline.positioning.solutions import rotation_at
from plumbline.records import UNKNOWN_CHANNEL, Epoch, Floats, Solution
from plumbline.signals import CHANNEL_STEP_HZ, FREQUENCY_HZ

Edit = Callable[[int, Epoch], Epoch]
DAY_NS = 86_400 * 1_000_000_000


@dataclass(frozen=True)
class Recording:
    """A folder's two receivers; where the base does not tell its position, a given one."""

    folder: str
    base: str
    rover: str
    navigation: tuple[str, ...]
    t_near_gps_ns: int


STR = Recording(
    "str-2018-195", "week-rollover-STR24.rtcm3", "week-rollover-STR17.rtcm3", (), 1_215_648_000_000_000_000
)  # fmt: skip
SC134 = Recording(
    "sc134-2026-037", "ROMAMSG.bin", "ROVRMSG.bin", ("SSRTEST_20260206_CORR.bin",), 1_454_443_200_000_000_000
)  # fmt: skip


class Bench:
    """The epochs that both receivers have, and the filter to run over them."""

    def __init__(self, data_dir: Path, recording: Recording, first: int = 0, last: int = 10_000) -> None:
        folder, books = data_dir / recording.folder, Books()
        for name in (recording.base, recording.rover, *recording.navigation):
            if not (folder / name).is_file():
                pytest.skip(f"no {folder / name}")
        epochs = {}
        for name in (*recording.navigation, recording.base, recording.rover):
            epochs[name] = _epochs(folder / name, name, recording.t_near_gps_ns, books)
        base, rover = epochs[recording.base], epochs[recording.rover]
        times = sorted(t for t in base.keys() & rover.keys() if abs(t - recording.t_near_gps_ns) < DAY_NS)
        self.pairs = [(rover[t], base[t]) for t in times][first:last]
        self._books = books
        settings = self.settings()
        self.source = BroadcastSource(books.ephemerides, books.corrections, settings.positioning)
        descriptions = books.bases[recording.base].descriptions
        told = descriptions[-1][1].position_ecef_m if descriptions else None
        position = rtk.single_point_of(self.pairs[-1][1], self.source) if told is None else np.array(told)
        assert position is not None
        self.base_position_ecef_m: Floats = position

    @staticmethod
    def settings(quality_control: str = "on", **values: object) -> StationSettings:
        """Of two frequencies of all systems."""
        return StationSettings(
            station="rover",
            positioning=PositioningSettings.model_validate(
                {"systems": "GREJC", "elevation_mask_deg": 10.0, "quality_control": quality_control}
            ),
            rtk=RtkSettings.model_validate(values),
        )

    def run(
        self, edit: Edit = lambda _, epoch: epoch, settings: StationSettings | None = None
    ) -> list[tuple[Solution, rtk.RtkDiagnostics | None]]:
        """All epochs, the rover's edited. The oracle's side of a comparison is a run with another edit."""
        state, made = rtk.initial_state(), []
        settings, facts = settings or self.settings(), StationFacts("rover")
        for k, (rover, base) in enumerate(self.pairs):
            view = BaseView("base", base, self.base_position_ecef_m)
            state, solution, seen = rtk.step(state, edit(k, rover), view, self.source, settings, facts)
            made.append((solution, seen))
        return made


def _epochs(path: Path, stream: str, t_near_ns: int, books: Books) -> dict[int, Epoch]:
    """Epochs of a recording by time, all signals; its ephemerides go into the books, known from the start."""
    feed, found = NavigationFeed(stream, books), dict[int, Epoch]()
    for piece in read_recording(path, stream, t_near_ns=t_near_ns):
        feed.receive(piece.data, piece.t_ns)
        if stream in books.bases:
            found |= {epoch.t_gps_ns: replace(epoch, t_receive_ns=2**62) for epoch in books.bases[stream].epochs[-3:]}
    return found


def displaced(epoch: Epoch, bench: Bench, enu_m: Floats) -> Epoch:
    """The epoch as an antenna displaced by ``enu_m`` (3,) would have observed it."""
    states = bench.source.broadcast(epoch.t_gps_ns, epoch.t_receive_ns, epoch.satellite, epoch.pseudorange_m)
    line = states.position_ecef_m - bench.base_position_ecef_m
    line /= np.linalg.norm(line, axis=1)[:, None]
    shift_m = np.nan_to_num(-line @ rotation_at(bench.base_position_ecef_m).T @ enu_m)
    channel = np.where(epoch.glonass_channel == UNKNOWN_CHANNEL, 0, epoch.glonass_channel)
    frequency = FREQUENCY_HZ[epoch.signal] + channel * CHANNEL_STEP_HZ[epoch.signal]
    return replace(
        epoch,
        pseudorange_m=epoch.pseudorange_m + shift_m,
        carrier_phase_cycles=epoch.carrier_phase_cycles + shift_m * frequency / SPEED_OF_LIGHT_M_S,
    )
