"""Oracle: RTKLIB's decoder (pyrtklib5) on the recordings' MSM4, MSM5 and MSM7: pseudorange, phase, Doppler, C/N0."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyrtklib5 as rtklib
import pytest

from plumbline.gps_time import GPS_EPOCH_UNIX_NS, NS_PER_S, gps_ns_from_calendar
from plumbline.rtcm3 import Observations, decode, scan_frames
from plumbline.signals import satellite_id, satellite_name, signal_code, system_of_letter

pytestmark = pytest.mark.realdata

N_EPOCHS = 120
Key = tuple[int, str, str]  # GPS time in s, satellite, RINEX code
Values = tuple[float, float, float, float]  # P m, L cycles, D Hz, C/N0 dB-Hz
_SYSTEM_LETTERS = {
    rtklib.SYS_GPS: "G", rtklib.SYS_GLO: "R", rtklib.SYS_GAL: "E", rtklib.SYS_QZS: "J", rtklib.SYS_CMP: "C",
}  # fmt: skip


def _their_epochs(path: Path, calendar: tuple[int, ...]) -> Iterator[dict[Key, Values]]:
    decoder = rtklib.rtcm_t()
    rtklib.init_rtcm(decoder)
    start = rtklib.Arr1Ddouble(6)
    for i, value in enumerate(calendar):
        start[i] = value
    decoder.time = rtklib.epoch2time(start)
    stream = rtklib.FileWrapper(str(path), "rb")
    number = rtklib.Arr1Dint(1)
    for _ in range(N_EPOCHS):
        while (state := rtklib.input_rtcm3f(decoder, stream)) != 1:
            if state == -2:
                return
        epoch: dict[Key, Values] = {}
        for row in (decoder.obs.data[i] for i in range(decoder.obs.n)):
            letter = _SYSTEM_LETTERS.get(rtklib.satsys(row.sat, number))
            if letter is None:
                continue
            prn = number[0] - (192 if letter == "J" else 0)
            name = satellite_name(satellite_id(system_of_letter(letter), prn))
            t_s = row.time.time - GPS_EPOCH_UNIX_NS // NS_PER_S  # gtime_t counts GPS time from 1970
            for band in range(3):
                if row.code[band]:
                    values = (row.P[band], row.L[band], row.D[band], row.SNR[band])
                    epoch[t_s, name, rtklib.code2obs(row.code[band])] = values
        yield epoch


def _our_rows(path: Path, calendar: tuple[int, ...]) -> dict[Key, Values]:
    year, month, day, hour, minute, second = calendar
    near = gps_ns_from_calendar(year, month, day, hour, minute, second * NS_PER_S)
    rows: dict[Key, Values] = {}
    for frame in scan_frames(path.read_bytes()).frames:
        message = decode(frame.payload)
        if not isinstance(message, Observations):
            continue
        t_s = message.t_gps_ns(near) // NS_PER_S
        columns = (message.pseudorange_m, message.carrier_phase_cycles, message.doppler_hz, message.cn0_db_hz)
        for i in range(message.n_rows):
            key = (t_s, satellite_name(int(message.satellite[i])), signal_code(int(message.signal[i])))
            rows[key] = tuple(float(column[i]) for column in columns)  # type: ignore[assignment]
    return rows


@pytest.mark.parametrize(
    ("name", "calendar", "least"),
    [
        ("str-2018-195/week-rollover-STR17.rtcm3", (2018, 7, 14, 23, 50, 0), 10_000),
        ("str-2018-195/week-rollover-STR24.rtcm3", (2018, 7, 14, 23, 50, 0), 5_000),
        ("sc134-2026-037/ROMAMSG.bin", (2026, 2, 6, 20, 0, 0), 4_000),
    ],
)
def test_values_agree_with_rtklib(data_dir: Path, name: str, calendar: tuple[int, ...], least: int) -> None:
    ours = _our_rows(data_dir / name, calendar)
    compared = 0
    for epoch in _their_epochs(data_dir / name, calendar):
        for key, theirs in epoch.items():
            known = np.nan_to_num(np.array(ours[key]))  # RTKLIB writes zero for missing
            expected = np.array(theirs)
            if known[1] == 0.0:
                expected[1] = 0.0  # a GLONASS phase whose channel only an ephemeris tells
            tolerance = np.array([1e-6, 1e-5, 1e-3, 0.06])  # RTKLIB keeps D in single precision, C/N0 in 1/16 dB
            assert np.all(np.abs(known - expected) <= tolerance), (key, known, expected)
            compared += 1
    assert compared >= least
