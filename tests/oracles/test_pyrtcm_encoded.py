"""Oracle: pyrtcm reads what is encoded here, also what RTKLIB does not know: MSM1, MSM3, NavIC, SBAS, 1001, texts."""

import math

import numpy as np
import pytest
from pyrtcm import RTCMMessage

from plumbline.constants import LIGHT_MILLISECOND_M
from plumbline.rtcm3 import Message, MsmHeader, Observations, decode, encode, encode_observations
from plumbline.signals import System, satellite_id, signal_id

CODES = ("1C", "2P", "5Q", "1C", "2L", "6I", "5A")


def _rows(system: System) -> dict[str, np.ndarray]:
    code = CODES[system]
    ids = [satellite_id(system, number) for number in (1, 5, 7)]
    pseudorange = np.array([2.01e7, 2.3456789e7, np.nan])
    return {
        "satellite": np.array(ids, dtype=np.int16),
        "signal": np.full(3, signal_id(system, code), dtype=np.int16),
        "pseudorange_m": pseudorange,
        "phase_range_m": np.array([2.01e7 + 3.3, np.nan, 2.4e7]),
        "phase_range_rate_m_s": np.array([10.5, -300.25, np.nan]),
        "cn0_db_hz": np.array([44.0, 33.0, np.nan]),
        "lock_time_s": np.array([70.0, 0.01, 2.0]),
        "half_cycle_ambiguous": np.array([True, False, False]),
        "glonass_channel": np.full(3, 4 if system is System.GLONASS else 0, dtype=np.int8),
    }


@pytest.mark.parametrize("system", list(System))
@pytest.mark.parametrize("kind", [1, 3, 4, 5, 6, 7])  # pyrtcm 1.2 breaks on its own table of MSM2
def test_pyrtcm_reads_our_msm(system: System, kind: int) -> None:
    rows = _rows(system)
    header = MsmHeader(system, kind, 1234, 3_600_000, 3 if system is System.GLONASS else None, True, 2, 1, 3, True, 5)
    (payload,) = encode_observations(header, **rows)
    theirs = RTCMMessage(payload=payload)
    assert theirs.identity == str(1070 + 10 * system + kind)
    common = (theirs.DF003, theirs.DF393, theirs.DF409, theirs.DF411, theirs.DF412, theirs.DF417, theirs.DF418)
    assert common == (1234, 1, 2, 1, 3, 1, 5)
    assert (theirs.NSat, theirs.NSig, theirs.NCell) == (3, 1, 3)
    if system is System.GLONASS:
        assert (theirs.DF416, theirs.DF034) == (3, 3_600_000)
    for i, (code_m, phase_m) in enumerate(zip(rows["pseudorange_m"], rows["phase_range_m"], strict=True), 1):
        rough_ms = getattr(theirs, f"DF398_{i:02d}") + (getattr(theirs, f"DF397_{i:02d}") if kind > 3 else 0)
        for names, value_m, invalid in (
            (("DF400", "DF405"), code_m, -(2.0**-10)),
            (("DF401", "DF406"), phase_m, -(2.0**-8)),
        ):
            fine = next((getattr(theirs, f"{n}_{i:02d}") for n in names if hasattr(theirs, f"{n}_{i:02d}")), None)
            if fine is None:
                continue
            got_m = math.nan if fine == invalid else (rough_ms + fine) * LIGHT_MILLISECOND_M
            difference = got_m - value_m
            if kind <= 3:
                difference -= LIGHT_MILLISECOND_M * np.round(difference / LIGHT_MILLISECOND_M)
            assert math.isnan(got_m) == math.isnan(value_m)
            assert not abs(difference) > 0.009


@pytest.mark.parametrize("number", [1001, 1002, 1003, 1004, 1009, 1010, 1011, 1012])
def test_pyrtcm_reads_our_legacy_observations(number: int) -> None:
    glonass = number >= 1009
    system = System.GLONASS if glonass else System.GPS
    codes = ("1C", "2P" if glonass else "2W") if (number - (1009 if glonass else 1001)) & 2 else ("1C",)
    code_m = 2.1234567e7 + np.arange(2.0 * len(codes)) * 7.0
    n = code_m.size
    missing = np.full(n, np.nan)
    sent = Observations(
        number, system, 9, 4_000_000, None, False, 0, 0, 0, True, 3,
        np.array([satellite_id(system, s) for s in (3, 11) for _ in codes], dtype=np.int16),
        np.array([signal_id(system, c) for _ in range(2) for c in codes], dtype=np.int16),
        code_m, code_m + 1.5, missing, missing, missing, np.full(n, 41.25), np.full(n, 30.0),
        np.zeros(n, dtype=np.bool_), np.full(n, -5 if glonass else 0, dtype=np.int8),
    )  # fmt: skip
    if number in (1001, 1003, 1009, 1011):
        modulus = LIGHT_MILLISECOND_M * (2 if glonass else 1)
        whole = np.floor(code_m[0] / modulus) * modulus
        sent = sent._replace(pseudorange_modulo_m=code_m - whole, phase_range_modulo_m=code_m - whole + 1.5)
    payload = encode(sent)
    theirs = RTCMMessage(payload=payload)
    got = decode(payload)
    assert isinstance(got, Observations)
    names = ("DF041", "DF042", "DF043", "DF047", "DF048") if glonass else ("DF011", "DF012", "DF013", "DF017", "DF018")
    ours = got.pseudorange_m if got.pseudorange_modulo_m is None else got.pseudorange_modulo_m
    for i, first in enumerate(range(0, n, len(codes)), 1):
        whole_ms = getattr(theirs, f"{'DF044' if glonass else 'DF014'}_{i:02d}", 0) * (2 if glonass else 1)
        base_m = getattr(theirs, f"{names[0]}_{i:02d}") + whole_ms * LIGHT_MILLISECOND_M
        assert ours[first] == pytest.approx(base_m, abs=1e-6)
        assert getattr(theirs, f"{names[1]}_{i:02d}") == pytest.approx(1.5, abs=0.0103)
        assert getattr(theirs, f"{names[2]}_{i:02d}") == 27  # 2 · 27 − 24 = 30 s
        if len(codes) == 2:
            assert getattr(theirs, f"{names[3]}_{i:02d}") == pytest.approx(7.0, abs=0.0201)
            assert getattr(theirs, f"{names[4]}_{i:02d}") == pytest.approx(8.5, abs=0.0103)


def test_pyrtcm_reads_our_descriptions() -> None:
    fields = {"station": 5, "antenna_type": "TRM59800.00     SCIS", "antenna_setup": 2, "antenna_serial": "5225"}
    receiver = {"receiver_type": "TRIMBLE ALLOY", "receiver_firmware": "6.20", "receiver_serial": "604"}
    theirs = RTCMMessage(payload=encode(Message(1033, fields | receiver)))
    for df, expected in (("DF030", "antenna_type"), ("DF033", "antenna_serial"), ("DF228", "receiver_type")):
        value = str({**fields, **receiver}[expected])
        assert "".join(getattr(theirs, f"{df}_{i:02d}") for i in range(1, len(value) + 1)) == value
    biases = {"station": 5, "aligned": True, "signal_mask": 0b1010, "biases_m": (-1.5, 2.04)}
    theirs = RTCMMessage(payload=encode(Message(1230, biases)))
    assert (1, pytest.approx(-1.5), pytest.approx(2.04)) == (theirs.DF421, theirs.DF423, theirs.DF425)
