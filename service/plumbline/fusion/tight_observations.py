"""What the tight filter takes of an epoch: single differences of every antenna of the platform to one base.

Dai 2024 (eqs 3-6) differences the primary antenna with the base and the auxiliaries with the primary. The single
differences of every antenna with the base carry the same information, once their covariance is right: antennas that
share the base's measurement of a satellite share its noise. Differences between satellites are formed in the update,
where a row's reference is chosen among those at hand.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plumbline.config import RtkSettings, StationSettings
from plumbline.positioning.gather import mask_rad_of, select_rows
from plumbline.positioning.rtk_model import fill_model, place_of, satellites_of
from plumbline.positioning.rtk_observations import single_difference_rows
from plumbline.positioning.satellites import SatelliteSource
from plumbline.positioning.state import Records
from plumbline.records import Booleans, Epoch, Floats, Ints

ANTENNA_KEY: Final = 1 << 20
SIGNAL_KEY: Final = 1 << 8
_BASE_SHARE: Final = 0.5  # of a single difference's variance that is the base's


@dataclass(frozen=True, slots=True)
class TightEpoch:
    """Single differences of all antennas at one instant, observed less computed at ``origin_ecef_m``; m rows."""

    t_gps_ns: int
    antenna: NDArray[np.int64]  # (m,) index of the lever arm
    key: Ints  # (m,) names antenna, satellite and signal: an ambiguity
    group: Ints  # (m,) rows that share a receiver clock: antenna and pair of signals
    link: Ints  # (m,) rows that share a measurement of the base
    wavelength_m: Floats
    line: Floats  # (m, 3) antenna → satellite, Earth-fixed
    sine: Floats  # of the elevation
    phase_m: Floats  # NaN where missing
    code_m: Floats
    rate_m_s: Floats
    variance: Floats  # (m, 3) of phase m², code m², range rate (m/s)²
    integer: Booleans  # the double difference's ambiguity is an integer
    lost_lock: Booleans
    lock_time_s: Floats
    origin_ecef_m: Floats  # (antennas, 3)

    @property
    def rank(self) -> int:
        """Before standstills of the same time."""
        return 0


def tight_epoch(
    epochs: Sequence[Epoch | None],
    base: Epoch,
    base_position_ecef_m: Floats,
    origin_ecef_m: Floats,
    source: SatelliteSource,
    settings: StationSettings,
    rows_of: "RowsOfAntenna | None" = None,
) -> TightEpoch | None:
    """Rows of a platform's antennas, one epoch each or None, against the base; None where there are none.

    ``origin_ecef_m`` (antennas, 3): where the antennas are, to some ten metres. Settings: systems, mask, and of ``rtk``
    frequencies and noise. ``rows_of`` takes the place of :func:`antenna_rows` where rows can be had for less.
    """
    parts = []
    model = rows_of or antenna_rows
    for number, epoch in enumerate(epochs):
        if epoch is not None:
            rows = model(epoch, base, base_position_ecef_m, origin_ecef_m[number], source, settings)
            if rows.size:
                parts.append((number, epoch.t_gps_ns, rows))
    if not parts:
        return None
    rows = np.concatenate([part for _, _, part in parts])
    antenna = np.concatenate([np.full(part.size, number, np.int64) for number, _, part in parts])
    return _epoch_of(parts[0][1], rows, antenna, origin_ecef_m)


RowsOfAntenna = Callable[[Epoch, Epoch, Floats, Floats, SatelliteSource, StationSettings], Records]


def antenna_rows(
    epoch: Epoch, base: Epoch, base_position: Floats, origin: Floats, source: SatelliteSource, settings: StationSettings
) -> Records:
    """Modelled rows of one antenna that have a weight for their phase."""
    rtk: RtkSettings = settings.rtk
    epoch, base = (select_rows(one, settings.positioning.systems) for one in (epoch, base))
    rows = single_difference_rows(epoch, base, rtk.frequencies)
    if not rows.size:
        return rows
    states, base_states, index = satellites_of(rows, epoch, base, source)
    age_s = (epoch.t_gps_ns - base.t_gps_ns) * 1e-9
    place, base_place = place_of(origin, epoch.t_gps_ns), place_of(base_position, epoch.t_gps_ns)
    fill_model(rows, states, base_states, index, place, base_place, mask_rad_of(settings.positioning), age_s, rtk)
    used: Records = rows[rows["phase_weight"] > 0.0]
    return used


def _epoch_of(t_gps_ns: int, rows: Records, antenna: Ints, origin_ecef_m: Floats) -> TightEpoch:
    signal, base_signal = rows["signal"].astype(np.int64), rows["base_signal"].astype(np.int64)
    satellite = rows["satellite"].astype(np.int64)
    weights = np.column_stack([rows["phase_weight"], rows["code_weight"], rows["range_rate_weight"]])
    with np.errstate(divide="ignore"):
        variance = 1.0 / weights
    return TightEpoch(
        t_gps_ns=t_gps_ns,
        antenna=antenna,
        key=antenna * ANTENNA_KEY + satellite * SIGNAL_KEY + signal,
        group=antenna * ANTENNA_KEY + signal * SIGNAL_KEY + base_signal,
        link=satellite * SIGNAL_KEY + base_signal,
        wavelength_m=rows["wavelength_m"].copy(),
        line=np.ascontiguousarray(rows["line"]),
        sine=rows["sine"].copy(),
        phase_m=rows["phase_oc_m"].copy(),
        code_m=np.where(weights[:, 1] > 0.0, rows["code_oc_m"], np.nan),
        rate_m_s=np.where(weights[:, 2] > 0.0, rows["range_rate_oc_m_s"], np.nan),
        variance=variance,
        integer=rows["integer"].copy(),
        lost_lock=rows["lost_lock"].copy(),
        lock_time_s=np.fmin(rows["lock_time_s"], rows["base_lock_time_s"]),
        origin_ecef_m=origin_ecef_m,
    )


def of_antennas(epoch: TightEpoch, antennas: Sequence[int]) -> TightEpoch:
    """The rows of some antennas alone: the schemes G1 … GI123 of one recording."""
    keep = np.isin(epoch.antenna, antennas)
    cut = {
        name: getattr(epoch, name)[keep]
        for name in (
            "antenna", "key", "group", "link", "wavelength_m", "line", "sine", "phase_m", "code_m", "rate_m_s",
            "variance", "integer", "lost_lock", "lock_time_s",
        )
    }  # fmt: skip
    return replace(epoch, **cut)


def base_share() -> float:
    """Share of a single difference's variance that antennas have in common through the base."""
    return _BASE_SHARE
