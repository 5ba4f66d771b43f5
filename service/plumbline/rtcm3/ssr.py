"""State space corrections (SSR): orbits, clocks, biases, accuracies and the ionosphere.

1057–1068 and 1240–1263 orbit, clock, code bias, accuracy; 1264 ionosphere; 1265–1270 phase bias (RTCM 10403.3, and its
amendments for QZSS, SBAS, BeiDou and phase biases). The six systems share their rows and differ in the widths of
satellite number and issue of data. BeiDou's issue comes in two layouts under the same numbers: 10 bits of toe modulo
and 8 bits of IOD (the standard), and an earlier draft's 24 bits of IOD that some encoders still send; see
:func:`beidou_orbit_is_draft`.
"""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from plumbline.rtcm3.fields import Fields, Group, Item, Message, Row, Table, Values, flag, register, signed, unsigned
from plumbline.signals import System


class SsrKind(IntEnum):
    """What an SSR message carries; the first six in the order of their message numbers within a system."""

    ORBIT = 0
    CLOCK = 1
    CODE_BIAS = 2
    COMBINED = 3
    URA = 4
    HIGH_RATE_CLOCK = 5
    PHASE_BIAS = 6
    VTEC = 7


#: Update interval by its 4-bit code (DF391), s. Code 0 stands for 1 s.
UPDATE_INTERVALS_S: Final = (1, 2, 5, 10, 15, 30, 60, 120, 240, 300, 600, 900, 1800, 3600, 7200, 10800)


@dataclass(frozen=True, slots=True)
class Dialect:
    """What differs between the systems: first message number, phase bias message, epoch, satellite and issue."""

    system: System
    base: int
    phase_bias: int
    epoch: Row
    satellite: Row
    issue: tuple[Row, ...]
    signal_df: str
    draft_issue: tuple[Row, ...] | None = None


def _epoch(df: str, bits: int = 20) -> Row:
    return unsigned(df, "epoch_s", bits)


_BEIDOU_MODULO: Final = unsigned("DF470", "toe_modulo", 10)  # toe / 8 s modulo 1024

DIALECTS: Final = (
    Dialect(
        System.GPS,
        1057,
        1265,
        _epoch("DF385"),
        unsigned("DF068", "satellite", 6),
        (unsigned("DF071", "iod", 8),),
        "DF380",
    ),
    Dialect(
        System.GLONASS,
        1063,
        1266,
        _epoch("DF386", 17),
        unsigned("DF384", "satellite", 5),
        (unsigned("DF392", "iod", 8),),
        "DF381",
    ),
    Dialect(
        System.GALILEO,
        1240,
        1267,
        _epoch("DF458"),
        unsigned("DF252", "satellite", 6),
        (unsigned("DF459", "iod", 10),),
        "DF382",
    ),
    Dialect(
        System.QZSS,
        1246,
        1268,
        _epoch("DF460"),
        unsigned("DF429", "satellite", 4),
        (unsigned("DF434", "iod", 8),),
        "DF461",
    ),
    Dialect(
        System.SBAS,
        1252,
        1269,
        _epoch("DF462"),
        unsigned("DF463", "satellite", 6),  # PRN − 120
        (unsigned("DF468", "t0_modulo", 9), unsigned("DF469", "iod_crc", 24)),
        "DF464",
    ),
    Dialect(
        System.BEIDOU,
        1258,
        1270,
        _epoch("DF465"),
        unsigned("DF488", "satellite", 6),
        (_BEIDOU_MODULO, unsigned("DF471", "iod", 8)),
        "DF467",
        (_BEIDOU_MODULO, unsigned("DF471", "iod_crc", 24)),
    ),
)

_ORBIT_ROWS: Final = (
    signed("DF365", "radial_m", 22, 1e-4),
    signed("DF366", "along_m", 20, 4e-4),
    signed("DF367", "cross_m", 20, 4e-4),
    signed("DF368", "radial_rate_m_s", 21, 1e-6),
    signed("DF369", "along_rate_m_s", 19, 4e-6),
    signed("DF370", "cross_rate_m_s", 19, 4e-6),
)
_CLOCK_ROWS: Final = (
    signed("DF376", "c0_m", 22, 1e-4),
    signed("DF377", "c1_m_s", 21, 1e-6),
    signed("DF378", "c2_m_s2", 27, 2e-8),
)
_N_SATELLITES: Final = unsigned("DF387", "n_satellites", 6)


def _identity_rows(*, datum: bool) -> tuple[Item, ...]:
    """From the update interval to the solution id; orbit messages say their datum in between."""
    return (
        unsigned("DF391", "update_interval", 4),
        flag("DF388", "more_follows"),
        *((flag("DF375", "regional_datum"),) if datum else ()),
        unsigned("DF413", "iod_ssr", 4),
        unsigned("DF414", "provider", 16),
        unsigned("DF415", "solution", 4),
    )


def code_bias_rows(signal_df: str) -> tuple[Item, ...]:
    """Rows of a satellite's code biases, after its number."""
    bias = (unsigned(signal_df, "signal", 5), signed("DF383", "bias_m", 14, 0.01))
    return (unsigned("DF379", "n_biases", 5), Group("biases", "n_biases", bias))


def phase_bias_rows(signal_df: str) -> tuple[Item, ...]:
    """Rows of a satellite's phase biases, after its number."""
    bias = (
        unsigned(signal_df, "signal", 5),
        flag("DF483", "integer"),
        unsigned("DF484", "wide_lane_integer", 2),
        unsigned("DF485", "discontinuity", 4),
        signed("DF482", "bias_m", 20, 1e-4),
    )
    return (
        unsigned("DF479", "n_biases", 5),
        unsigned("DF480", "yaw_angle_rad", 9, math.pi / 256),
        signed("DF481", "yaw_rate_rad_s", 8, math.pi / 8192),
        Group("biases", "n_biases", bias),
    )


def satellite_rows(kind: SsrKind, issue: tuple[Row, ...], signal_df: str) -> tuple[Item, ...]:
    """Rows that follow a satellite's number in a message of a kind; RTCM and IGS SSR share them."""
    return {
        SsrKind.ORBIT: (*issue, *_ORBIT_ROWS),
        SsrKind.CLOCK: _CLOCK_ROWS,
        SsrKind.COMBINED: (*issue, *_ORBIT_ROWS, *_CLOCK_ROWS),
        SsrKind.HIGH_RATE_CLOCK: (signed("DF390", "high_rate_m", 22, 1e-4),),
        SsrKind.CODE_BIAS: code_bias_rows(signal_df),
        SsrKind.PHASE_BIAS: phase_bias_rows(signal_df),
        SsrKind.URA: (unsigned("DF389", "ura", 6),),
    }[kind]


def _table(dialect: Dialect, kind: SsrKind, issue: tuple[Row, ...], alternative: Table | None = None) -> Table:
    number = dialect.phase_bias if kind is SsrKind.PHASE_BIAS else dialect.base + kind
    consistency = (flag("DF486", "dispersive_bias_consistent"), flag("DF487", "mw_consistent"))
    rows: tuple[Item, ...] = (
        dialect.epoch,
        *_identity_rows(datum=kind in (SsrKind.ORBIT, SsrKind.COMBINED)),
        *(consistency if kind is SsrKind.PHASE_BIAS else ()),
        _N_SATELLITES,
        Group("satellites", "n_satellites", (dialect.satellite, *satellite_rows(kind, issue, dialect.signal_df))),
    )
    title = f"{dialect.system.name} SSR {kind.name.lower().replace('_', ' ')}"
    return Table(number, title, rows, alternative=alternative)


def _tables(dialect: Dialect) -> list[Table]:
    tables = []
    for kind in SsrKind:
        if kind is SsrKind.VTEC:
            continue
        draft = None
        if dialect.draft_issue is not None and kind in (SsrKind.ORBIT, SsrKind.COMBINED):
            draft = _table(dialect, kind, dialect.draft_issue)
        tables.append(_table(dialect, kind, dialect.issue, draft))
    return tables


def n_cosine(fields: Fields) -> int:
    """Number of cosine coefficients up to a degree and order (IGS SSR 1.00, 4.5.1)."""
    degree, order = fields["degree"], min(fields["order"], fields["degree"])
    return int((degree + 1) * (degree + 2) // 2 - (degree - order) * (degree - order + 1) // 2)


def n_sine(fields: Fields) -> int:
    """Number of sine coefficients: those of order zero are not sent."""
    return n_cosine(fields) - int(fields["degree"]) - 1


#: Quality and layers of the ionosphere's spherical harmonics; coefficients by order, then degree.
VTEC_ROWS: Final[tuple[Item, ...]] = (
    unsigned("DF478", "quality_tecu", 9, 0.05),
    unsigned("DF472", "n_layers", 2, offset=1),
    Group(
        "layers",
        "n_layers",
        (
            unsigned("DF473", "height_km", 8, 10.0),
            unsigned("DF474", "degree", 4, offset=1),
            unsigned("DF475", "order", 4, offset=1),
            Values("cosine_tecu", n_cosine, signed("DF476", "cosine", 16, 0.005)),
            Values("sine_tecu", n_sine, signed("DF477", "sine", 16, 0.005)),
        ),
    ),
)
VTEC: Final = Table(1264, "SSR ionosphere VTEC", (_epoch("DF385"), *_identity_rows(datum=False), *VTEC_ROWS))
MESSAGES: Final[dict[int, tuple[System, SsrKind]]] = {}  #: message number → system and kind, 1264 left out

for _dialect in DIALECTS:
    for _entry in _tables(_dialect):
        register(_entry)
        _is_phase = _entry.number == _dialect.phase_bias
        _kind = SsrKind.PHASE_BIAS if _is_phase else SsrKind(_entry.number - _dialect.base)
        MESSAGES[_entry.number] = (_dialect.system, _kind)
register(VTEC)


def beidou_orbit_is_draft(message: Message) -> bool | None:
    """Whether a 1258 or 1261 has the draft's layout; None where it has no satellite to tell by.

    Encoders of that draft number BeiDou's satellites from zero and give the epoch in GPS time, in all of 1258–1263 and
    1270; the standard's encoders number them from one and give it in BDT (``madoca-2025-091`` is of the first kind).
    """
    satellites = message["satellites"]
    return "iod_crc" in satellites[0] if satellites else None
