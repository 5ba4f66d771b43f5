"""A sky, antennas under it, and noise drawn from exactly the distribution that relative positioning assumes."""

from dataclasses import replace

import numpy as np

from plumbline.config import PositioningSettings, RtkSettings, StationSettings
from plumbline.epochs.correction_book import CorrectionBook
from plumbline.epochs.ephemeris_book import EphemerisBook
from plumbline.gnss.earth_frames import ecef_from_geodetic, geodetic_from_ecef, rotation_enu_from_ecef
from plumbline.positioning.broadcast_source import BroadcastSource
from plumbline.records import Epoch
from plumbline.signals import FREQUENCY_HZ
from plumbline_dtu.simulation.constellation import Constellation
from plumbline_dtu.simulation.motion import Motion, static
from plumbline_dtu.simulation.station import PERFECT, Receiver, StationPlan

C_M_S = 299_792_458.0
T_NS = 1_383_900_000 * 1_000_000_000
BASE_ECEF_M = ecef_from_geodetic(0.3896, 1.9923, 60.0)
ENU = rotation_enu_from_ecef(*geodetic_from_ecef(BASE_ECEF_M)[:2])
SKY = Constellation(T_NS, "GEC")
CODE_SIGMA_M, PHASE_SIGMA_M = 0.30, 0.002


def source_of(settings: StationSettings, hours: float = 1.0) -> BroadcastSource:
    """The sky's own broadcast ephemerides, known from the start."""
    book = EphemerisBook()
    for second in range(0, int(hours * 3600) + 1, 600):
        for ephemeris in SKY.broadcast(T_NS + second * 1_000_000_000).values():
            book.add(replace(ephemeris, t_receive_ns=0))
    return BroadcastSource(book, CorrectionBook(), settings.positioning)


def settings_of(mask_deg: float = 12.0, systems: str = "GEC", **rtk: object) -> StationSettings:
    """Settings whose noise is the noise that :func:`noisy` draws."""
    values = {"code_sigma_m": CODE_SIGMA_M, "phase_sigma_m": PHASE_SIGMA_M} | rtk
    return StationSettings(
        station="rover",
        positioning=PositioningSettings(systems=systems, elevation_mask_deg=mask_deg),
        rtk=RtkSettings.model_validate(values),
    )


def antenna(offset_enu_m: np.ndarray | list[float], seed: int, motion: Motion | None = None) -> Receiver:
    """A perfect receiver at an offset from the base."""
    x, y, z = (BASE_ECEF_M + ENU.T @ np.asarray(offset_enu_m, float)).tolist()
    return Receiver(StationPlan("a", (x, y, z), motion or static(), errors=PERFECT, seed=seed), SKY)


def sine_of(epoch: Epoch) -> np.ndarray:
    """Sine of the elevation of each row, from the sky itself."""
    states = source_of(settings_of()).broadcast(epoch.t_gps_ns, epoch.t_gps_ns, epoch.satellite, epoch.pseudorange_m)
    line = states.position_ecef_m - BASE_ECEF_M
    return (line @ ENU[2]) / np.linalg.norm(line, axis=1)


def noisy(epoch: Epoch, sine: np.ndarray, rng: np.random.Generator, code: float = 1.0, phase: float = 1.0) -> Epoch:
    """The epoch with noise of the assumed variance: half constant, half with 1/sin² (and strong signals)."""
    sigma = np.sqrt(0.5 + 0.5 / np.maximum(sine, 0.05) ** 2)
    n = epoch.satellite.size
    wavelength = C_M_S / FREQUENCY_HZ[epoch.signal]
    return replace(
        epoch,
        pseudorange_m=epoch.pseudorange_m + code * CODE_SIGMA_M * sigma * rng.normal(size=n),
        carrier_phase_cycles=epoch.carrier_phase_cycles
        + phase * PHASE_SIGMA_M * sigma / wavelength * rng.normal(size=n),
        cn0_db_hz=np.full(n, 48.0),
        loss_of_lock=None,
    )
