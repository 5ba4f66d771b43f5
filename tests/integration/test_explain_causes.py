"""Every cause that an explanation names, produced in a station's bytes. Oracle: the fault that was put in."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from plumbline.config import StationSettings
from plumbline.constants import LIGHT_MILLISECOND_M, SPEED_OF_LIGHT_M_S
from plumbline.epochs.stream import Books, NavigationFeed
from plumbline.gps_time import NS_PER_S
from plumbline.pipeline import Pipeline
from plumbline.quality import receiver_events as events
from plumbline.quality.explain import Finding, explain
from plumbline.records import Epoch, QualityReport, Solution, StationStatus
from plumbline.signals import FREQUENCY_HZ, satellite_name
from plumbline_dtu.encoding import ReceiverEncoder, ephemeris_frame
from plumbline_dtu.simulation.constellation import Constellation, simulate_corrections
from plumbline_dtu.simulation.station import Receiver

from .witnesses import START, plan

N = 130
Spoil = Callable[[int, Epoch], Epoch]


def healthy(k: int, epoch: Epoch) -> Epoch:
    return epoch


class Case:
    """A station for two minutes; what is done to its epochs, ephemerides, corrections and packets."""

    def __init__(
        self,
        spoil: Spoil = healthy,
        ephemerides: bool = True,
        corrections_until_s: int = N,
        delay_s: float = 0.1,
        connections: int = 1,
    ) -> None:
        sky, encoder, books = Constellation(START), ReceiverEncoder(1), Books()
        settings = StationSettings.model_validate(
            {"station": "a", "mode": "ppp", "positioning": {"systems": "GEC"}, "silent_after_s": 20}
        )
        feed, self.pipeline = NavigationFeed("corrections", books), Pipeline(settings, (), books)
        receiver, outputs = Receiver(plan("a"), sky), []
        pieces = [(t, 0, data) for t, data in simulate_corrections(sky, START, START + corrections_until_s * NS_PER_S)]
        for k in range(N):
            t = START + k * NS_PER_S
            head = (
                b"".join(ephemeris_frame(e) for e in sky.broadcast(t).values()) if ephemerides and k % 60 == 0 else b""
            )
            data = head + b"".join(encoder.frames(spoil(k, receiver.epoch(t))))
            pieces.append((t + round(delay_s * NS_PER_S), 1, data))
        for t, kind, data in sorted(pieces, key=lambda piece: piece[:2]):
            if kind == 0:
                feed.receive(data, t)
            else:
                outputs += self.pipeline.receive(data, t)
        for k in range(connections):
            outputs += self.pipeline.connection_event("connected", "line", START + (N + k) * NS_PER_S)
        solutions = [o for o in outputs if isinstance(o, Solution)][-100:]
        reports = [o for o in outputs if isinstance(o, QualityReport)][-100:]
        self.status = [o for o in outputs if isinstance(o, StationStatus)][-1]
        self.findings = explain(solutions, reports, self.status)

    def found(self, cause: str) -> Finding:
        """The finding of a cause; fails with all that was found where it is missing."""
        named = [finding for finding in self.findings if finding.cause == cause]
        assert named, [(finding.cause, finding.text) for finding in self.findings]
        return named[0]


def test_a_station_that_is_well_but_for_its_youth() -> None:
    case = Case()
    assert {finding.cause for finding in case.findings} <= {"ppp_converging"}, case.findings
    assert not [name for name in case.status.counters if name.startswith("receiver_")], case.status.counters


def test_without_ephemerides() -> None:
    found = Case(ephemerides=False, corrections_until_s=-10).found("waiting")
    assert "waiting for an ephemeris" in found.text
    assert "1019" in found.advice


def test_corrections_that_stop() -> None:
    case = Case(corrections_until_s=20)
    assert any("corrections" in finding.text and "ago" in finding.text for finding in case.findings), case.findings


def test_packets_that_come_late() -> None:
    assert "late" in Case(delay_s=5.0).found("latency").text


def test_a_device_that_starts_anew_and_anew() -> None:
    assert "8 times" in Case(connections=8).found("power").text


def test_signals_weaker_at_once_are_interference() -> None:
    def jammed(k: int, epoch: Epoch) -> Epoch:
        return replace(epoch, cn0_db_hz=epoch.cn0_db_hz - 10.0) if k >= 100 else epoch

    case = Case(jammed)
    assert "10 dB" in case.found("interference").text
    assert case.status.counters[events.WEAKER] == N - 100


def test_a_reflector_is_found_where_it_stands() -> None:
    chosen: list[int] = []

    def reflected(k: int, epoch: Epoch) -> Epoch:
        if not chosen:
            chosen.append(int(epoch.satellite[np.argmax(epoch.cn0_db_hz)]))  # the highest: nobody expects it there
        error = 2.0 * np.sin(2.0 * np.pi * k / 40.0) * (epoch.satellite == chosen[0])
        return replace(epoch, pseudorange_m=epoch.pseudorange_m + error)

    found = [finding for finding in Case(reflected).findings if finding.cause == "multipath"]
    (finding,) = found
    assert f"code minus carrier of {satellite_name(chosen[0])}" in finding.text


@pytest.mark.parametrize("in_phase", [True, False])
def test_a_clock_jump_is_named_and_counted(in_phase: bool) -> None:
    """Of code and phase alike, and of the code alone: receivers do either."""

    def jumped(k: int, epoch: Epoch) -> Epoch:
        if k < 80:
            return epoch
        cycles = LIGHT_MILLISECOND_M / SPEED_OF_LIGHT_M_S * FREQUENCY_HZ[epoch.signal] if in_phase else 0.0
        return replace(
            epoch,
            pseudorange_m=epoch.pseudorange_m + LIGHT_MILLISECOND_M,
            carrier_phase_cycles=epoch.carrier_phase_cycles + cycles,
        )

    case = Case(jumped)
    assert case.status.counters[events.CLOCK_JUMP] == 1
    assert "1 times" in case.found("clock").text


def test_half_cycles_and_lost_locks_are_counted() -> None:
    def poor(k: int, epoch: Epoch) -> Epoch:
        n = epoch.satellite.size
        half = np.arange(n) == 0 if k >= 120 else np.zeros(n, bool)
        lost = (np.arange(n) < 3) & (k == 100)
        return replace(epoch, half_cycle_ambiguous=half, loss_of_lock=lost)

    counters = Case(poor).status.counters
    assert counters[events.HALF_CYCLE] == N - 120
    assert counters[events.LOCK_LOST] >= 3
