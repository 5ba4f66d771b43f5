"""Satellite systems, satellites, signals and their frequencies, each as a small dense integer.

A *satellite id* is ``system * 64 + number - 1`` and a *signal id* ``system * 32 + msm_signal - 1`` (RTCM 10403.3, DF394
and DF395), so that arrays indexed by them stay small: 448 satellites, 224 signals. Names are RINEX's: ``G05``, ``1C``.
"""

from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray


class System(IntEnum):
    """The seven satellite systems, in the order of their MSM message numbers (1071, 1081, …, 1131)."""

    GPS = 0
    GLONASS = 1
    GALILEO = 2
    SBAS = 3
    QZSS = 4
    BEIDOU = 5
    NAVIC = 6

    @property
    def letter(self) -> str:
        """RINEX letter."""
        return SYSTEM_LETTERS[self]


SYSTEM_LETTERS: Final = "GRESJCI"
SATELLITES_PER_SYSTEM: Final = 64
SIGNALS_PER_SYSTEM: Final = 32
N_SATELLITES: Final = len(System) * SATELLITES_PER_SYSTEM
N_SIGNALS: Final = len(System) * SIGNALS_PER_SYSTEM
_SBAS_RINEX_OFFSET = 19  # SBAS PRN 120 is S20 and MSM satellite 1

# RTCM 10403.3 tables 3.5-91 (GPS), 96 (GLONASS), 99 (Galileo), 102 (SBAS), 105 (QZSS), 108 (BeiDou), and NavIC's:
# MSM signal number -> RINEX observation code.
MSM_SIGNAL_CODES: Final[dict[System, dict[int, str]]] = {
    System.GPS: {
        2: "1C", 3: "1P", 4: "1W", 8: "2C", 9: "2P", 10: "2W", 15: "2S", 16: "2L", 17: "2X",
        22: "5I", 23: "5Q", 24: "5X", 30: "1S", 31: "1L", 32: "1X",
    },
    System.GLONASS: {2: "1C", 3: "1P", 8: "2C", 9: "2P"},
    System.GALILEO: {
        2: "1C", 3: "1A", 4: "1B", 5: "1X", 6: "1Z", 8: "6C", 9: "6A", 10: "6B", 11: "6X", 12: "6Z",
        14: "7I", 15: "7Q", 16: "7X", 18: "8I", 19: "8Q", 20: "8X", 22: "5I", 23: "5Q", 24: "5X",
    },
    System.SBAS: {2: "1C", 22: "5I", 23: "5Q", 24: "5X"},
    System.QZSS: {
        2: "1C", 9: "6S", 10: "6L", 11: "6X", 15: "2S", 16: "2L", 17: "2X", 22: "5I", 23: "5Q", 24: "5X",
        30: "1S", 31: "1L", 32: "1X",
    },
    System.BEIDOU: {
        2: "2I", 3: "2Q", 4: "2X", 8: "6I", 9: "6Q", 10: "6X", 14: "7I", 15: "7Q", 16: "7X",
        22: "5D", 23: "5P", 24: "5X", 25: "7D", 30: "1D", 31: "1P", 32: "1X",
    },
    System.NAVIC: {8: "9A", 22: "5A"},
}  # fmt: skip

# Carrier frequencies by system and RINEX band, Hz (RINEX 3.05, tables 4-10); GLONASS: channel 0, and the step below.
BAND_FREQUENCIES_HZ: Final[dict[System, dict[str, float]]] = {
    System.GPS: {"1": 1575.42e6, "2": 1227.60e6, "5": 1176.45e6},
    System.GLONASS: {"1": 1602.0e6, "2": 1246.0e6},
    System.GALILEO: {"1": 1575.42e6, "5": 1176.45e6, "6": 1278.75e6, "7": 1207.14e6, "8": 1191.795e6},
    System.SBAS: {"1": 1575.42e6, "5": 1176.45e6},
    System.QZSS: {"1": 1575.42e6, "2": 1227.60e6, "5": 1176.45e6, "6": 1278.75e6},
    System.BEIDOU: {"1": 1575.42e6, "2": 1561.098e6, "5": 1176.45e6, "6": 1268.52e6, "7": 1207.14e6, "8": 1191.795e6},
    System.NAVIC: {"5": 1176.45e6, "9": 2492.028e6},
}
GLONASS_CHANNEL_STEPS_HZ: Final = {"1": 0.5625e6, "2": 0.4375e6}

_CODE_OF_SIGNAL: Final[list[str]] = [""] * N_SIGNALS
_SIGNAL_OF_CODE: Final[dict[tuple[int, str], int]] = {}
#: Carrier frequency of each signal id, Hz (GLONASS: channel 0); NaN where no signal is defined.
FREQUENCY_HZ: Final[NDArray[np.float64]] = np.full(N_SIGNALS, np.nan)
#: Frequency step per GLONASS channel of each signal id, Hz; zero for the other systems.
CHANNEL_STEP_HZ: Final[NDArray[np.float64]] = np.zeros(N_SIGNALS)
for _system, _codes in MSM_SIGNAL_CODES.items():
    for _msm_signal, _code in _codes.items():
        _id = _system * SIGNALS_PER_SYSTEM + _msm_signal - 1
        _CODE_OF_SIGNAL[_id] = _code
        _SIGNAL_OF_CODE[_system, _code] = _id
        FREQUENCY_HZ[_id] = BAND_FREQUENCIES_HZ[_system][_code[0]]
        if _system is System.GLONASS:
            CHANNEL_STEP_HZ[_id] = GLONASS_CHANNEL_STEPS_HZ[_code[0]]


def system_of_letter(letter: str) -> System:
    """System of a RINEX letter; raises ``ValueError`` for an unknown one."""
    return System(SYSTEM_LETTERS.index(letter))


def satellite_id(system: System, number: int) -> int:
    """Satellite id of a system's satellite ``number``, 1…64 (SBAS: PRN − 119, QZSS: PRN − 192, as in MSM)."""
    return system * SATELLITES_PER_SYSTEM + number - 1


def system_of(satellite: int) -> System:
    """System of a satellite id."""
    return System(satellite // SATELLITES_PER_SYSTEM)


def number_of(satellite: int) -> int:
    """Number of a satellite within its system, 1…64."""
    return satellite % SATELLITES_PER_SYSTEM + 1


def satellite_name(satellite: int) -> str:
    """RINEX name of a satellite id: ``G05``, ``S20`` for SBAS PRN 120."""
    system = system_of(satellite)
    return f"{system.letter}{number_of(satellite) + (_SBAS_RINEX_OFFSET if system is System.SBAS else 0):02d}"


def satellite_of_name(name: str) -> int:
    """Satellite id of a RINEX name (``G05``, ``G 5``); raises ``ValueError`` when it is none."""
    system = system_of_letter(name[0])
    number = int(name[1:]) - (_SBAS_RINEX_OFFSET if system is System.SBAS else 0)
    if not 1 <= number <= SATELLITES_PER_SYSTEM:
        raise ValueError(f"no such satellite: {name!r}")
    return satellite_id(system, number)


def signal_id(system: System, code: str) -> int | None:
    """Signal id of a RINEX code (``1C``) of a system, or None where MSM knows no such signal."""
    return _SIGNAL_OF_CODE.get((system, code))


def signal_code(signal: int) -> str:
    """RINEX code of a signal id (``1C``), empty where undefined."""
    return _CODE_OF_SIGNAL[signal]


def carrier_frequency_hz(signal: int, glonass_channel: int = 0) -> float:
    """Carrier frequency of a signal id, Hz, on a GLONASS channel (−7…+6)."""
    return float(FREQUENCY_HZ[signal] + glonass_channel * CHANNEL_STEP_HZ[signal])
