"""IGS SSR 1.00 (2020): message 4076 with subtypes 21–127 by system and 201 for the ionosphere."""

from typing import Final

from plumbline.rtcm3.fields import Group, Item, Table, flag, register, register_subtypes, unsigned
from plumbline.rtcm3.ssr import VTEC_ROWS, SsrKind, satellite_rows
from plumbline.signals import System

NUMBER: Final = 4076
VTEC_SUBTYPE: Final = 201
#: Subtype that each system counts from (table 6); its first message is this plus one.
BASES: Final = {
    System.GPS: 20,
    System.GLONASS: 40,
    System.GALILEO: 60,
    System.QZSS: 80,
    System.BEIDOU: 100,
    System.SBAS: 120,
}
#: Kinds in the order of their subtypes.
KINDS: Final = (
    SsrKind.ORBIT,
    SsrKind.CLOCK,
    SsrKind.COMBINED,
    SsrKind.HIGH_RATE_CLOCK,
    SsrKind.CODE_BIAS,
    SsrKind.PHASE_BIAS,
    SsrKind.URA,
)
SUBTYPES: Final[dict[int, tuple[System, SsrKind]]] = {
    base + place: (system, kind) for system, base in BASES.items() for place, kind in enumerate(KINDS, start=1)
}

_HEADER: Final[tuple[Item, ...]] = (
    unsigned("IDF001", "version", 3),
    unsigned("IDF002", "subtype", 8),
    unsigned("IDF003", "epoch_s", 20),
    unsigned("IDF004", "update_interval", 4),
    flag("IDF005", "more_follows"),
    unsigned("IDF007", "iod_ssr", 4),
    unsigned("IDF008", "provider", 16),
    unsigned("IDF009", "solution", 4),
)
_ISSUE: Final = (unsigned("IDF012", "iod", 8),)


def _table(subtype: int, system: System, kind: SsrKind) -> Table:
    between: tuple[Item, ...] = ()
    if kind in (SsrKind.ORBIT, SsrKind.COMBINED):
        between = (flag("IDF006", "regional_datum"),)
    elif kind is SsrKind.PHASE_BIAS:
        between = (flag("IDF032", "dispersive_bias_consistent"), flag("IDF033", "mw_consistent"))
    rows = (unsigned("IDF011", "satellite", 6), *satellite_rows(kind, _ISSUE, "IDF024"))
    return Table(
        NUMBER,
        f"IGS {system.name} SSR {kind.name.lower().replace('_', ' ')}",
        (*_HEADER, *between, unsigned("IDF010", "n_satellites", 6), Group("satellites", "n_satellites", rows)),
        subtype,
    )


VTEC: Final = Table(NUMBER, "IGS SSR ionosphere VTEC", (*_HEADER, *VTEC_ROWS), VTEC_SUBTYPE)

register_subtypes(NUMBER, 15, 8)
register(*(_table(subtype, *meaning) for subtype, meaning in SUBTYPES.items()), VTEC)
