"""Oracle: a real correction stream against itself, where the ephemeris it refers to changes (has-idd-2023-229).

The broadcast orbit jumps by decimetres from one issue to the next, the satellite does not: only the right signs, axes
and reference times of orbit and clock corrections make the corrected orbit and clock pass through.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from plumbline.epochs.translate_ephemeris import Rejected, ephemeris_from_message
from plumbline.epochs.translate_ssr import SsrTranslator
from plumbline.gnss.orbits_broadcast import broadcast_state, pack
from plumbline.gnss.ssr_orbits import clock_correction_s, correct_orbit, pack_correction
from plumbline.gps_time import NS_PER_S, gps_ns_from_calendar
from plumbline.records import Ephemeris, Floats, SsrClock, SsrOrbit
from plumbline.rtcm3.fields import Message
from plumbline.rtcm3.framing import scan_frames
from plumbline.rtcm3.messages import decode
from plumbline.signals import system_of

pytestmark = pytest.mark.realdata
C = 299_792_458.0
EPHEMERIDES, COMBINED = (1019, 1046), (1060, 1243)
Both = tuple[Ephemeris, Floats, SsrClock]


def _corrected(both: Both, t_gps_ns: int) -> tuple[Floats, float, Floats]:
    """Corrected position [m] and clock [m], and the broadcast position."""
    row, position, velocity = pack(both[0]), np.empty(3), np.empty(3)
    clock, _, _ = broadcast_state(row, t_gps_ns, position, velocity)
    broadcast = position.copy()
    correct_orbit(both[1], t_gps_ns, position, velocity)
    return position, (clock + clock_correction_s(both[1], t_gps_ns)) * C, broadcast


def _changes(path: Path) -> Iterator[tuple[Both, Both, int]]:
    """Pairs of (ephemeris, packed correction) on either side of a change of issue, and the time of the change."""
    near = gps_ns_from_calendar(2023, 8, 17, 2, 0, 0)
    translator, ephemerides = SsrTranslator(), dict[tuple[int, int], Ephemeris]()
    orbits: dict[int, tuple[SsrOrbit, int]] = {}
    last: dict[int, Both] = {}
    for frame in scan_frames(path.read_bytes()).frames:
        message = decode(frame.payload)
        if isinstance(message, Message) and message.number in EPHEMERIDES:
            ephemeris = ephemeris_from_message(message, near)
            if not isinstance(ephemeris, Rejected):
                ephemerides[ephemeris.satellite, ephemeris.issue] = ephemeris
        if not isinstance(message, Message) or message.number not in COMBINED:
            continue
        corrections = translator.translate(message, near)
        assert not isinstance(corrections, Rejected)
        for correction in corrections:
            if isinstance(correction, SsrOrbit):
                near = max(near, correction.header.t_gps_ns)
                orbits |= {int(s): (correction, k) for k, s in enumerate(correction.satellite)}
            elif isinstance(correction, SsrClock):
                for k, satellite in enumerate(correction.satellite):
                    orbit, row = orbits[int(satellite)]
                    found = ephemerides.get((int(satellite), int(orbit.issue[row])))
                    if found is None:
                        continue
                    now = found, pack_correction(orbit, row, correction, k), correction
                    before = last.get(int(satellite))
                    age_ns = now[2].header.t_gps_ns - before[2].header.t_gps_ns if before else 0
                    if before and before[0].issue != found.issue and age_ns < 60 * NS_PER_S:
                        yield before, now, correction.header.t_gps_ns
                    last[int(satellite)] = now


def test_corrected_orbits_and_clocks_pass_through_a_change_of_issue(data_dir: Path) -> None:
    jumps: dict[str, list[tuple[float, float, float]]] = {}
    for before, now, t_gps_ns in _changes(data_dir / "has-idd-2023-229" / "idd2023229c.rtc"):
        position, clock_m, broadcast = _corrected(now, t_gps_ns)
        old_position, old_clock_m, old_broadcast = _corrected(before, t_gps_ns)
        jump = (
            float(np.linalg.norm(position - old_position)),
            abs(clock_m - old_clock_m),
            float(np.linalg.norm(broadcast - old_broadcast)),
        )
        jumps.setdefault(system_of(now[0].satellite).letter, []).append(jump)
    assert len(jumps["G"]) >= 15
    assert len(jumps["E"]) >= 80
    for letter, broadcast_m, clock_m in (("G", 0.2, 0.01), ("E", 0.04, 0.02)):
        table = np.array(jumps[letter])
        assert np.median(table[:, 2]) > broadcast_m  # there is something to correct
        assert table[:, 0].max() < 0.001
        assert np.median(table[:, 1]) < clock_m
