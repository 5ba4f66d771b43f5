"""What is known of the recordings: corrections that find their ephemeris, those that cannot, dialects, stale epochs."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from plumbline.epochs.correction_book import AgeLimits, CorrectionBook
from plumbline.epochs.encode_ssr import combined_messages, messages_from_correction
from plumbline.epochs.ephemeris_book import EphemerisBook, Match
from plumbline.epochs.matched_corrections import matched, reason
from plumbline.epochs.translate_ephemeris import NUMBERS as EPHEMERIS_NUMBERS
from plumbline.epochs.translate_ephemeris import Rejected, ephemeris_from_message
from plumbline.epochs.translate_ssr import NUMBERS as SSR_NUMBERS
from plumbline.epochs.translate_ssr import SsrTranslator
from plumbline.gps_time import NS_PER_S, gps_ns
from plumbline.records import SsrClock, SsrOrbit
from plumbline.rtcm3 import Message, decode, encode, scan_frames
from plumbline.signals import System, satellite_name, satellite_of_name, signal_id

HAS = ("has-idd-2023-229/idd2023229c.rtc", gps_ns(2275, 352_750.0))
SC134 = ("sc134-2026-037/SSRTEST_20260206_CORR.bin", gps_ns(2404, 504_038.0))
MADOCA = ("madoca-2025-091/madocalib_2025091A.204.rtcm3", gps_ns(2360, 172_835.0))
LIMITS = AgeLimits()


class Service:
    """A stream played into both books; time goes on with the epochs of GPS and Galileo orbits."""

    def __init__(self, data_dir: Path, source: tuple[str, int], frames: int | None = None) -> None:
        self.messages = [decode(f.payload) for f in scan_frames((data_dir / source[0]).read_bytes()).frames[:frames]]
        self.start_ns = self.now_ns = source[1]
        self.ephemerides, self.corrections, self.translator = EphemerisBook(), CorrectionBook(), SsrTranslator()

    def play(self):
        """Yields (seconds since the start, records) for each SSR message."""
        for message in self.messages:
            if not isinstance(message, Message):
                continue
            if message.number in EPHEMERIS_NUMBERS:
                ephemeris = ephemeris_from_message(message, self.now_ns)
                assert not isinstance(ephemeris, Rejected)
                self.ephemerides.add(ephemeris)
            elif message.number in SSR_NUMBERS:
                records = self.translator.translate(message, self.now_ns)
                if isinstance(records, Rejected):
                    continue
                for record in records:
                    self.corrections.add(record)
                if isinstance(records[0], SsrOrbit) and message.number != 1063:
                    self.now_ns = max(self.now_ns, records[0].header.t_gps_ns)
                yield (self.now_ns - self.start_ns) / NS_PER_S, records

    def match(self, satellites):
        ids = np.asarray(satellites, dtype=np.int16)
        return matched(self.ephemerides, self.corrections, ids, self.now_ns, self.now_ns, LIMITS)


@pytest.mark.realdata
def test_has_corrections_find_their_ephemerides(data_dir: Path):
    service, counts = Service(data_dir, HAS), Counter()
    for _, records in service.play():
        if isinstance(records[0], SsrOrbit):
            found = service.match(records[0].satellite)
            counts.update(Match(int(code)) for code in found.match)
    assert counts[Match.USABLE] / counts.total() >= 0.97
    assert counts[Match.USABLE] > 17_000


@pytest.mark.realdata
def test_has_biases_stay_usable_though_their_epoch_never_moves(data_dir: Path):
    """All bias messages carry 14:00:21 of the day; orbits and clocks run from 01:59:12 of the next."""
    service = Service(data_dir, HAS)
    epochs = {m["epoch_s"] for m in service.messages if isinstance(m, Message) and m.number in (1059, 1242)}
    assert len(epochs) == 1
    for _ in service.play():
        pass
    satellites = np.array([satellite_of_name(name) for name in ("G08", "E19")], dtype=np.int16)
    signals = np.array([signal_id(System.GPS, "1C"), signal_id(System.GALILEO, "1C")], dtype=np.int16)
    biases = service.corrections.code_biases(satellites, signals, service.now_ns, service.now_ns, LIMITS)
    assert np.all(np.isfinite(biases.bias_m))


@pytest.mark.realdata
def test_sc134_says_why_gps_cannot_be_used_while_galileo_goes_on(data_dir: Path):
    """From 20:01:00 on, GPS corrections refer to sets that the stream does not carry."""
    service, texts, galileo = Service(data_dir, SC134, 8000), [], Counter()
    for t, records in service.play():
        if t > 600.0:
            break
        if not isinstance(records[0], SsrOrbit) or t < 120.0 or records[0].satellite[0] >= 64:
            continue
        satellites = [*range(64), *range(128, 192)]
        found = service.match([s for s in satellites if service.ephemerides.newest(s, service.now_ns)])
        last_ns = service.corrections.last_epoch_ns(System.GPS, service.now_ns)
        assert last_ns is not None
        texts.append(reason(found, System.GPS, LIMITS, (service.now_ns - last_ns) / NS_PER_S))
        galileo[int(np.sum((found.match == Match.USABLE) & (found.satellite >= 128)))] += 1
    assert len(texts) > 400
    assert all(t.startswith("corrections for GPS refer to ephemerides that the stream does not carry") for t in texts)
    assert min(galileo) == 3  # while a new IODnav's set, sent every two minutes, has not come
    assert galileo.most_common(1)[0][0] == 7


@pytest.mark.realdata
def test_madocas_beidou_is_the_draft_dialect(data_dir: Path):
    """Satellites from zero (C07…C45, never C01), eight bits of toe as issue: 158 for 23:00, 96 for 00:00 BDT."""
    service, names, issues = Service(data_dir, MADOCA), set(), set()
    for _, records in service.play():
        if isinstance(records[0], SsrOrbit) and records[0].satellite.size and records[0].satellite[0] >= 320:
            names |= {satellite_name(int(s)) for s in records[0].satellite}
            issues |= set(records[0].issue.tolist())
    assert service.translator.beidou_is_draft is True
    assert issues == {158, 96}
    assert {"C07", "C08", "C09", "C10", "C13", "C16"} == {name for name in names if name < "C19"}  # BeiDou-2's IGSOs
    assert service.translator.skipped == {}


@pytest.mark.realdata
@pytest.mark.parametrize("source", [HAS, SC134], ids=["has", "sc134"])
def test_orbits_and_clocks_go_back_to_the_same_bytes(data_dir: Path, source):
    """Records → messages → the very payload that they came from, for orbit and clock messages."""
    frames = scan_frames((data_dir / source[0]).read_bytes()).frames
    translator, compared = SsrTranslator(), 0
    for found in frames[:9000]:
        message = decode(found.payload)
        if not isinstance(message, Message) or message.number not in SSR_NUMBERS:
            continue
        records = translator.translate(message, source[1])
        if isinstance(records, Rejected) or not isinstance(records[0], SsrOrbit | SsrClock):
            continue
        back = combined_messages(*records) if len(records) == 2 else messages_from_correction(records[0])
        assert [encode(m) for m in back] == [found.payload]
        compared += 1
    assert compared > 700


@pytest.mark.realdata
@pytest.mark.parametrize(
    "file",
    [HAS[0], SC134[0], MADOCA[0], "str-2018-195/week-rollover-STR17.rtcm3", "str-2018-195/week-rollover-STR24.rtcm3"],
)
def test_every_frame_is_encoded_bit_for_bit(data_dir: Path, file: str):
    compared = 0
    for found in scan_frames((data_dir / file).read_bytes()).frames:
        message = decode(found.payload)
        if isinstance(message, Message) and message.number in EPHEMERIS_NUMBERS | SSR_NUMBERS:
            encoded = encode(message)
            assert encoded == found.payload[: len(encoded)]
            assert not any(found.payload[len(encoded) :])  # sc134's 1046 has a byte too many
            compared += 1
    assert compared > 250


@pytest.mark.realdata
@pytest.mark.parametrize(("file", "satellites"), [("STR17", 25), ("STR24", 40)])
def test_str_ephemerides_across_the_week(data_dir: Path, file: str, satellites: int):
    """Sets received either side of the week's end serve at its end; the stale ones among them do not."""
    edge, book = gps_ns(2010, 0.0), EphemerisBook()
    for found in scan_frames((data_dir / f"str-2018-195/week-rollover-{file}.rtcm3").read_bytes()).frames:
        message = decode(found.payload)
        if isinstance(message, Message) and message.number in EPHEMERIS_NUMBERS:
            ephemeris = ephemeris_from_message(message, edge)
            assert not isinstance(ephemeris, Rejected)
            book.add(ephemeris)
    choices = {s: book.select(s, edge, edge) for s in book.satellites()}
    usable = [s for s, choice in choices.items() if choice.match is Match.USABLE]
    assert len(usable) >= satellites
    assert {choice.match for choice in choices.values()} <= {Match.USABLE, Match.UNHEALTHY, Match.EPHEMERIS_TOO_OLD}
    assert all(abs(choices[s].entry.ephemeris.toe_gps_ns - edge) <= 14_400 * NS_PER_S for s in usable)
