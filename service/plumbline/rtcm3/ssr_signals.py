"""Signal and tracking mode identifiers of SSR biases, which are not MSM's signal numbers: RTCM's and the IGS's.

RTCM 10403.4: DF380, DF381, DF382, DF461, DF464, DF467. IGS SSR 1.00: IDF024, which reserves the combined modes. Both
are given as RINEX codes; identifiers of signals that MSM does not know have no signal id (None).
"""

from typing import Final

from plumbline.signals import System, signal_id

_Codes = dict[System, dict[int, str]]


def _numbered(codes: str) -> dict[int, str]:
    """``"1C 1P - 2C"`` → {0: "1C", 1: "1P", 3: "2C"}."""
    return {number: code for number, code in enumerate(codes.split()) if code != "-"}


RTCM_CODES: Final[_Codes] = {
    System.GPS: _numbered("1C 1P 1W 1Y 1M 2C 2D 2S 2L 2X 2P 2W 2Y 2M 5I 5Q 5X 1S 1L 1X"),
    System.GLONASS: _numbered("1C 1P 2C 2P 4A 4B 4X 6A 6B 6X 3I 3Q 3X"),
    System.GALILEO: _numbered("1A 1B 1C 1X 1Z 5I 5Q 5X 7I 7Q 7X 8I 8Q 8X 6A 6B 6C 6X 6Z"),
    System.QZSS: _numbered("1C 1S 1L 2S 2L 2X 5I 5Q 5X 6S 6L 6X 1X 1Z 5D 5P 5Z 6E 6Z"),
    System.SBAS: _numbered("1C 5I 5Q 5X"),
    System.BEIDOU: _numbered("2I 2Q 2X 6I 6Q 6X 7I 7Q 7X 1D 1P 1X 5D 5P 5X 7D"),
}
IGS_CODES: Final[_Codes] = {
    System.GPS: _numbered("1C 1P 1W 1S 1L 2C 2D 2S 2L - 2P 2W - - 5I 5Q"),
    System.GLONASS: _numbered("1C 1P 2C 2P 4A 4B 6A 6B 3I 3Q"),
    System.GALILEO: _numbered("1A 1B 1C - - 5I 5Q - 7I 7Q - 8I 8Q - 6A 6B 6C"),
    System.QZSS: _numbered("1C 1S 1L 2S 2L - 5I 5Q - 6S 6L - - - - - - 6E"),
    System.SBAS: _numbered("1C 5I 5Q"),
    System.BEIDOU: _numbered("2I 2Q - 6I 6Q - 7I 7Q - 1D 1P - 5D 5P - 1A - - 6A"),
}


def _by_identifier(codes: _Codes) -> dict[tuple[System, int], int | None]:
    return {(s, n): signal_id(s, code) for s, numbered in codes.items() for n, code in numbered.items()}


_SIGNALS: Final = {False: _by_identifier(RTCM_CODES), True: _by_identifier(IGS_CODES)}
_IDENTIFIERS: Final = {
    igs: {signal: number for (_, number), signal in table.items() if signal is not None}
    for igs, table in _SIGNALS.items()
}


def signal_of_identifier(system: System, identifier: int, *, igs: bool) -> int | None:
    """Signal id of an SSR signal identifier of a system, or None where there is none."""
    return _SIGNALS[igs].get((system, identifier))


def identifier_of_signal(signal: int, *, igs: bool) -> int | None:
    """SSR signal identifier of a signal id, or None where the format has none for it."""
    return _IDENTIFIERS[igs].get(signal)
