"""Oracle: RTKLIB (pyrtklib5) reads what is encoded here: legacy observations and MSM of every system that it knows."""

import numpy as np
import pyrtklib5 as rtklib
import pytest

from plumbline.gps_time import GPS_EPOCH_UNIX_NS, NS_PER_S, gps_ns_from_calendar
from plumbline.rtcm3 import MsmHeader, Observations, decode, encode, encode_observations, frame
from plumbline.rtcm3.msm_encoder import system_epoch
from plumbline.rtcm3.observations import unroll_legacy_phase
from plumbline.signals import System, satellite_id, signal_id

CALENDAR = (2018, 7, 14, 23, 50, 20)
T_GPS_NS = gps_ns_from_calendar(*CALENDAR[:5], CALENDAR[5] * NS_PER_S)
CODES = {
    System.GPS: ("1C", "2W", "5Q"), System.GLONASS: ("1C", "2P"), System.GALILEO: ("1C", "7Q", "5Q"),
    System.QZSS: ("1C", "2L", "5Q"), System.BEIDOU: ("2I", "6I", "7I"),
}  # fmt: skip
_SYSTEMS = {
    System.GPS: rtklib.SYS_GPS, System.GLONASS: rtklib.SYS_GLO, System.GALILEO: rtklib.SYS_GAL,
    System.QZSS: rtklib.SYS_QZS, System.BEIDOU: rtklib.SYS_CMP,
}  # fmt: skip


def _rows(system: System, codes: tuple[str, ...]) -> Observations:
    """Rows of three satellites, with a missing code and a missing phase among the second band's."""
    numbers = [1, 4, 9]
    generator = np.random.default_rng(int(system))
    n = len(numbers) * len(codes)
    code = np.repeat(generator.uniform(2.0e7, 2.5e7, len(numbers)), len(codes)) + generator.uniform(-20, 20, n)
    phase = code + generator.uniform(-40, 40, n)
    code[1], phase[len(codes) + 1] = np.nan, np.nan
    epoch_ms, day = system_epoch(system, T_GPS_NS)
    missing = np.full(n, np.nan)
    return Observations(
        0, system, 5, epoch_ms, day, False, 0, 0, 0, False, 0,
        np.array([satellite_id(system, number) for number in numbers for _ in codes], dtype=np.int16),
        np.array([signal_id(system, code) for _ in numbers for code in codes], dtype=np.int16),
        code, phase, missing, generator.uniform(-700, 700, n), missing, generator.uniform(20, 50, n),
        np.full(n, 40.0), np.zeros(n, dtype=np.bool_),
        np.full(n, 2 if system is System.GLONASS else 0, dtype=np.int8),
    )  # fmt: skip


def _theirs(payload: bytes) -> dict[tuple[int, int, str], tuple[float, float, float, float]]:
    decoder = rtklib.rtcm_t()
    rtklib.init_rtcm(decoder)
    start = rtklib.Arr1Ddouble(6)
    for i, value in enumerate(CALENDAR):
        start[i] = value
    decoder.time = rtklib.epoch2time(start)
    assert [rtklib.input_rtcm3(decoder, byte) for byte in frame(payload)][-1] == 1
    number, rows = rtklib.Arr1Dint(1), {}
    for row in (decoder.obs.data[i] for i in range(decoder.obs.n)):
        assert row.time.time == T_GPS_NS // NS_PER_S + GPS_EPOCH_UNIX_NS // NS_PER_S
        system = rtklib.satsys(row.sat, number)
        for band in range(3):
            if row.code[band]:
                values = (row.P[band], row.L[band], row.D[band], row.SNR[band])
                rows[system, number[0], rtklib.code2obs(row.code[band])] = values
    return rows


def _compare(sent: Observations, payload: bytes, tolerance: tuple[float, ...], rollover: bool = False) -> None:
    theirs = _theirs(payload)
    ours = decode(payload)
    assert isinstance(ours, Observations)
    assert ours.n_rows == sent.n_rows
    assert len(theirs) >= 2 * sent.n_rows // 3  # RTKLIB's build keeps three bands, and not always ours
    for i in range(sent.n_rows):
        number = int(sent.satellite[i]) % 64 + 1 + (192 if sent.system is System.QZSS else 0)
        code = CODES[sent.system][[signal_id(sent.system, c) for c in CODES[sent.system]].index(int(sent.signal[i]))]
        if (_SYSTEMS[sent.system], number, code) not in theirs:
            continue
        expected = np.array(theirs[_SYSTEMS[sent.system], number, code])
        decoded = np.array((ours.pseudorange_m[i], ours.carrier_phase_cycles[i], ours.doppler_hz[i], ours.cn0_db_hz[i]))
        if rollover:
            decoded[1:2] = unroll_legacy_phase(expected[1:2], decoded[1:2])
        assert np.all(np.abs(np.nan_to_num(decoded) - expected) <= [1e-6, 1e-5, 1e-3, 0.06]), (decoded, expected)
        errors = (ours.pseudorange_m[i] - sent.pseudorange_m[i], ours.phase_range_m[i] - sent.phase_range_m[i])
        assert all(not abs(e) > t for e, t in zip(errors, tolerance, strict=True))


@pytest.mark.parametrize("system", list(CODES))
@pytest.mark.parametrize(
    ("kind", "tolerance"), [(4, (0.009, 0.0003)), (5, (0.009, 0.0003)), (6, (3e-4, 8e-5)), (7, (3e-4, 8e-5))]
)
def test_rtklib_reads_our_msm(system: System, kind: int, tolerance: tuple[float, ...]) -> None:
    rows = _rows(system, CODES[system])
    header = MsmHeader(system, kind, 5, rows.epoch_ms, rows.day_of_week)
    columns = (rows.pseudorange_m, rows.phase_range_m, rows.phase_range_rate_m_s, rows.cn0_db_hz, rows.lock_time_s)
    extra = (rows.half_cycle_ambiguous, rows.glonass_channel)
    (payload,) = encode_observations(header, rows.satellite, rows.signal, *columns, *extra)
    if system is System.GLONASS and kind in (4, 6):
        ours = decode(payload)
        assert isinstance(ours, Observations)
        assert np.isnan(ours.carrier_phase_cycles).all()  # the channel is not told: RTKLIB gives no phase either
        assert all(row[1] == 0.0 for row in _theirs(payload).values())
        return
    _compare(rows, payload, (0.009, 0.0003) if kind < 6 else (3e-4, 8e-5))  # half a step


@pytest.mark.parametrize("number", [1002, 1004, 1010, 1012])
def test_rtklib_reads_our_legacy_observations(number: int) -> None:
    system = System.GPS if number < 1009 else System.GLONASS
    both = number in (1004, 1012)
    rows = _rows(system, CODES[system][:2] if both else CODES[system][:1])
    if not both:
        rows.pseudorange_m[1] = 2.1e7  # the format cannot do without the first band
        rows.phase_range_m[:] = rows.pseudorange_m + np.array([3.0, -4.0, 5.0])
    rows = rows._replace(number=number, day_of_week=None)
    _compare(rows, encode(rows), (0.0201, 0.000251), rollover=True)
