"""Ephemeris and SSR decoders and the books under arbitrary bytes: no exception, no hang, no growth."""

import pickle
import random

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from plumbline.epochs.correction_book import AgeLimits, CorrectionBook
from plumbline.epochs.ephemeris_book import EphemerisBook
from plumbline.epochs.matched_corrections import matched
from plumbline.epochs.translate_ephemeris import NUMBERS as EPHEMERIS_NUMBERS
from plumbline.epochs.translate_ephemeris import Rejected, ephemeris_from_message
from plumbline.epochs.translate_ssr import NUMBERS as SSR_NUMBERS
from plumbline.epochs.translate_ssr import SsrTranslator
from plumbline.gps_time import NS_PER_S, gps_ns
from plumbline.rtcm3 import decode, encode
from plumbline.rtcm3.fields import Message

NUMBERS = sorted(EPHEMERIS_NUMBERS | SSR_NUMBERS)
T0 = gps_ns(2400, 302_400.0)


def _payload(number: int, body: bytes) -> bytes:
    head = number << 4 | body[0] >> 4
    return head.to_bytes(2, "big") + body[1:]


@settings(max_examples=600, deadline=None)
@given(number=st.sampled_from(NUMBERS), body=st.binary(min_size=1, max_size=1022), seconds=st.integers(-(10**9), 10**9))
def test_any_payload_decodes_translates_and_encodes(number, body, seconds):
    message = decode(_payload(number, body))
    if not isinstance(message, Message):
        return
    payload = _payload(number, body)
    encoded = encode(message)
    assert encoded[:-1] == payload[: len(encoded) - 1]  # but for the padding of the last byte, and what stands behind
    near_ns = T0 + seconds * NS_PER_S
    if number in EPHEMERIS_NUMBERS:
        ephemeris_from_message(message, near_ns)
    else:
        SsrTranslator().translate(message, near_ns)


def test_books_stay_bounded_under_garbage():
    rng = random.Random(7)
    ephemerides, corrections, translator = EphemerisBook(), CorrectionBook(), SsrTranslator()
    sizes = []
    for k in range(6000):
        body = rng.randbytes(rng.choice((48, 60, 62, 63, 64, 120)))
        message = decode(_payload(rng.choice(NUMBERS), body))
        t_ns = T0 + k * NS_PER_S // 4
        if not isinstance(message, Message):
            continue
        if message.number in EPHEMERIS_NUMBERS:
            ephemeris = ephemeris_from_message(message, t_ns)
            if not isinstance(ephemeris, Rejected):
                ephemerides.add(ephemeris)
        else:
            records = translator.translate(message, t_ns)
            for record in [] if isinstance(records, Rejected) else records:
                corrections.add(record)
        if len(sizes) < k // 500:
            matched(ephemerides, corrections, np.arange(448, dtype=np.int16), t_ns, t_ns, AgeLimits())
            sizes.append(len(pickle.dumps((ephemerides, corrections))))
    assert len(sizes) == 11
    assert max(sizes[6:]) < 1.5 * max(sizes[3:6])
