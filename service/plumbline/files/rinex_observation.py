"""RINEX 2.11 and 3 observation files → epochs, streaming (RINEX 3.05, section 6 and table A3).

A record's fields stand in fixed columns of 16 characters (F14.3, loss-of-lock digit, signal strength digit), so all
satellites of an epoch are parsed as one matrix of bytes: digits times powers of ten, exactly.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plumbline.files.calendar_time import fractional_second_ns, gps_ns_of_calendar
from plumbline.files.rinex2_observation import TYPES_V2, epoch_lines_v2
from plumbline.files.rinex_header import RinexObservationHeader, read_observation_header
from plumbline.files.text import LineSource
from plumbline.records import UNKNOWN_CHANNEL, Epoch
from plumbline.signals import SATELLITES_PER_SYSTEM, System, satellite_of_name, signal_id

Bytes = NDArray[np.uint8]
_FIELD = 16
_WEIGHTS = np.array([10.0**k for k in range(12, 2, -1)] + [0.0, 100.0, 10.0, 1.0])  # thousandths of an F14.3 field
_LOSS_OF_LOCK_BIT, _HALF_CYCLE_BIT = 1, 2  # RINEX 3.05, table A3: LLI bits 0 and 1
_NEWLY_STARTED = 1  # epoch flag: power failure between the previous and this epoch
_EVENT = 2  # epoch flags from here on announce header records


@dataclass(frozen=True, slots=True)
class _Columns:
    """Where one system's signals stand in its records; −1 where a signal lacks the observable. All (n_signals,)."""

    signal: NDArray[np.int16]
    code: NDArray[np.intp]
    phase: NDArray[np.intp]
    doppler: NDArray[np.intp]
    strength: NDArray[np.intp]
    divisor: NDArray[np.float64]  # (n_types + 1,)


class RinexObservations:
    """An observation file: ``header``, then iterate once for its epochs in file order.

    ``fraction`` (0…1) is for a progress bar; ``skipped`` counts what was left out, by reason. Signals that MSM does not
    know are dropped. An epoch's receive time is its own time.
    """

    def __init__(self, path: Path | str) -> None:
        self._source = LineSource(path)
        self.header: RinexObservationHeader = read_observation_header(self._source)
        self.skipped: Counter[str] = Counter()
        types = self.header.observation_types or dict.fromkeys(TYPES_V2, self.header.observation_types_v2)
        self._columns = {system: _columns(self.header, system, codes) for system, codes in types.items()}
        self._n_types = {system: len(codes) for system, codes in types.items()}

    @property
    def fraction(self) -> float:
        """How much of the file has been read, 0…1."""
        return self._source.fraction

    def __iter__(self) -> Iterator[Epoch]:
        blocks = epoch_lines_v2(self._source, self.header, self.skipped) if self.header.version < 3 else self._blocks()
        for t_gps_ns, flag, lines in blocks:
            epoch = self._epoch(t_gps_ns, flag, lines)
            if len(epoch.satellite):
                yield epoch
            else:
                self.skipped["epoch without observations"] += 1

    def _blocks(self) -> Iterator[tuple[int, int, list[bytes]]]:
        """Time, epoch flag and records (name of the satellite, then its fields) of each epoch."""
        for line in self._source:
            if not line.startswith(b">"):
                self.skipped["line outside an epoch"] += 1
                continue
            try:
                flag, count = int(line[31:32]), int(line[32:35])
            except ValueError:
                self.skipped["damaged epoch line"] += 1
                continue
            lines = [record for _, record in zip(range(count), self._source, strict=False)]
            if flag >= _EVENT:
                self.skipped["event record"] += 1
                continue
            if len(lines) < count:
                self.skipped["truncated epoch"] += 1
                continue
            try:
                yield _epoch_time(line, self.header.time_scale), flag, lines
            except ValueError:
                self.skipped["damaged epoch line"] += 1

    def _epoch(self, t_gps_ns: int, flag: int, lines: list[bytes]) -> Epoch:
        by_system: dict[System, dict[int, bytes]] = {}
        for line in lines:
            try:
                satellite = satellite_of_name(line[:3].decode("ascii"))
            except ValueError:
                self.skipped["unknown satellite"] += 1
                continue
            system = System(satellite // SATELLITES_PER_SYSTEM)
            if system in self._columns:
                by_system.setdefault(system, {})[satellite] = line[3:]
        parts = [self._rows(system, by_system[system]) for system in sorted(by_system)]
        rows: list[NDArray[Any]] = (
            [np.concatenate(column) for column in zip(*parts, strict=True)] if parts else [np.zeros(0)] * 8
        )
        satellites, signal, code, phase, doppler, strength, loss, half = rows
        satellite_ids = satellites.astype(np.int16)
        return Epoch(
            t_gps_ns=t_gps_ns,
            t_receive_ns=t_gps_ns,
            satellite=satellite_ids,
            signal=signal.astype(np.int16),
            pseudorange_m=code,
            carrier_phase_cycles=phase,
            doppler_hz=doppler,
            cn0_db_hz=strength,
            lock_time_s=np.full(len(satellite_ids), np.nan),
            half_cycle_ambiguous=half.astype(bool),
            glonass_channel=self._channels(satellite_ids),
            loss_of_lock=loss.astype(bool) | (flag == _NEWLY_STARTED),
        )

    def _rows(self, system: System, lines: dict[int, bytes]) -> tuple[NDArray[np.generic], ...]:
        """Rows of one system: satellite, signal, code, phase, Doppler, C/N0, loss of lock, half cycle."""
        columns, n_types = self._columns[system], self._n_types[system]
        satellites = np.array(sorted(lines), np.int16)
        width = n_types * _FIELD
        text = b"".join(lines[satellite][:width].ljust(width) for satellite in sorted(lines))
        fields = np.frombuffer(text, np.uint8).reshape(len(lines), n_types, _FIELD)
        values = parse_f14_3(fields[:, :, :14])
        values = np.concatenate([values, np.full((len(lines), 1), np.nan)], axis=1) / columns.divisor
        lli = np.where(fields[:, :, 14] == ord(" "), 0, fields[:, :, 14] - ord("0"))
        lli = np.concatenate([lli, np.zeros((len(lines), 1), lli.dtype)], axis=1)[:, columns.phase]
        code, phase = values[:, columns.code], values[:, columns.phase]
        doppler, strength = values[:, columns.doppler], values[:, columns.strength]
        keep = np.isfinite(code) | np.isfinite(phase)
        satellite = np.broadcast_to(satellites[:, None], keep.shape)[keep]
        signal = np.broadcast_to(columns.signal, keep.shape)[keep]
        flags = (lli & _LOSS_OF_LOCK_BIT) != 0, (lli & _HALF_CYCLE_BIT) != 0
        return (satellite, signal, *(a[keep] for a in (code, phase, doppler, strength, *flags)))

    def _channels(self, satellite: NDArray[np.int16]) -> NDArray[np.int8]:
        channels = np.zeros(len(satellite), np.int8)
        for row in np.flatnonzero(satellite // SATELLITES_PER_SYSTEM == System.GLONASS):
            channels[row] = self.header.glonass_channels.get(int(satellite[row]), UNKNOWN_CHANNEL)
        return channels


def read_observations(path: Path | str, on_progress: Callable[[float], None] | None = None) -> list[Epoch]:
    """All epochs of a file; ``on_progress`` is told the fraction read after each."""
    observations = RinexObservations(path)
    epochs = []
    for epoch in observations:
        epochs.append(epoch)
        if on_progress:
            on_progress(observations.fraction)
    return epochs


def parse_f14_3(characters: Bytes) -> NDArray[np.float64]:
    """Numbers of F14.3 fields, exactly; blank, zero (RINEX: missing) and malformed fields are NaN.

    ``characters`` (…, 14) → (…,).
    """
    is_digit = (characters >= ord("0")) & (characters <= ord("9"))
    is_minus = characters == ord("-")
    digits = np.where(is_digit, characters - np.uint8(ord("0")), 0)
    thousandths = digits @ _WEIGHTS
    allowed = is_digit | is_minus | (characters == ord(" "))
    good = (characters[..., 10] == ord(".")) & allowed[..., :10].all(-1) & is_digit[..., 11:].all(-1)
    good &= (is_minus.sum(-1) <= 1) & (thousandths != 0)
    return np.where(good, np.where(is_minus.any(-1), -thousandths, thousandths) / 1000.0, np.nan)


def _epoch_time(line: bytes, scale: str) -> int:
    """GPS time of an epoch line; raises ``ValueError``."""
    text = line.decode("ascii", "replace")
    year, month, day, hour, minute = (int(text[a:b]) for a, b in ((2, 6), (7, 9), (10, 12), (13, 15), (16, 18)))
    return gps_ns_of_calendar(scale, year, month, day, hour, minute, fractional_second_ns(text[18:29]))


def _columns(header: RinexObservationHeader, system: System, codes: tuple[str, ...]) -> _Columns:
    types = [TYPES_V2[system].get(code, "") for code in codes] if header.version < 3 else list(codes)
    if system is System.BEIDOU and header.version < 3.03:  # RINEX 3.02 called B1I's band 1
        types = [code[0] + "2" + code[2] if code[1:] in ("1I", "1Q", "1X") else code for code in types]
    signals = {signal_id(system, code[1:]): code[1:] for code in types if code[:1] in ("C", "L")}
    known = sorted(signal for signal in signals if signal is not None)

    def where(kind: str) -> NDArray[np.intp]:
        return np.array([_index(types, kind + signals[signal]) for signal in known], np.intp)

    divisor = [header.scale_factors.get((system, code), 1.0) for code in types]
    return _Columns(
        np.array(known, np.int16), where("C"), where("L"), where("D"), where("S"), np.array([*divisor, 1.0])
    )


def _index(types: list[str], code: str) -> int:
    return types.index(code) if code in types else -1
