"""What a receiver and a correction service send, as RTCM3 frames."""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.epochs.encode_ssr import messages_from_correction
from plumbline.epochs.translate_ephemeris import Rejected, ephemeris_from_message, message_from_ephemeris
from plumbline.errors import ContractError
from plumbline.gps_time import NS_PER_MS, NS_PER_S, WEEK_NS
from plumbline.records import Booleans, Ephemeris, Epoch, Floats, InertialBlock, SsrCorrection
from plumbline.rtcm3 import InertialMessage, Message, PhaseAligner, decode, encode, encode_epoch, frame
from plumbline.signals import CHANNEL_STEP_HZ, FREQUENCY_HZ

_LONGEST_GAP_NS: Final = 600 * NS_PER_S
Key = tuple[int, int]  # satellite id, signal id


@dataclass(slots=True)
class ReceiverEncoder:
    """A receiver's output port: phases aligned to codes, lock times counted, epochs as MSM.

    Lock times count from a signal's first epoch, from every loss of lock that the source flags, and from new
    alignments; gaps that are not flagged, up to ten minutes, do not interrupt them.
    """

    station: int = 0
    kind: int = 7
    _aligner: PhaseAligner = field(default_factory=PhaseAligner)
    _locked_since_ns: dict[Key, int] = field(default_factory=dict)
    _last_seen_ns: dict[Key, int] = field(default_factory=dict)

    def frames(self, epoch: Epoch) -> list[bytes]:
        """An epoch's MSM frames."""
        steps = CHANNEL_STEP_HZ[epoch.signal] * epoch.glonass_channel
        wavelength_m = SPEED_OF_LIGHT_M_S / (FREQUENCY_HZ[epoch.signal] + steps)
        phase, restarted = self._aligner.align(
            epoch.satellite, epoch.signal, epoch.pseudorange_m, epoch.carrier_phase_cycles, wavelength_m
        )
        lost = restarted if epoch.loss_of_lock is None else restarted | epoch.loss_of_lock
        aligned = replace(epoch, carrier_phase_cycles=phase, lock_time_s=self._lock_times(epoch, lost))
        return [frame(payload) for payload in encode_epoch(aligned, self.kind, self.station)]

    def _lock_times(self, epoch: Epoch, lost: Booleans) -> Floats:
        times = np.zeros(len(epoch.satellite))
        keys = zip(epoch.satellite.tolist(), epoch.signal.tolist(), strict=True)
        for k, key in enumerate(keys):
            last = self._last_seen_ns.get(key)
            if lost[k] or last is None or epoch.t_gps_ns - last > _LONGEST_GAP_NS:
                self._locked_since_ns[key] = epoch.t_gps_ns
            self._last_seen_ns[key] = epoch.t_gps_ns
            times[k] = (epoch.t_gps_ns - self._locked_since_ns[key]) / NS_PER_S
        return times


def ephemeris_frame(ephemeris: Ephemeris) -> bytes:
    """The frame that carries an ephemeris; raises ContractError for values that its fields cannot hold."""
    return frame(encode(message_from_ephemeris(ephemeris)))


def as_received(ephemeris: Ephemeris) -> Ephemeris | None:
    """The ephemeris as a server has it after encoding and decoding; None if it does not survive that."""
    try:
        message = decode(encode(message_from_ephemeris(ephemeris)))
    except ContractError:
        return None
    if not isinstance(message, Message):
        return None
    decoded = ephemeris_from_message(message, ephemeris.t_receive_ns, ephemeris.toe_gps_ns)
    return None if isinstance(decoded, Rejected) else decoded


def correction_frames(correction: SsrCorrection) -> list[bytes]:
    """The frames that carry a correction."""
    return [frame(encode(message)) for message in messages_from_correction(correction)]


def station_frames(
    station: int, position_ecef_m: tuple[float, float, float], height_m: float, antenna: str, serial: str, receiver: str
) -> list[bytes]:
    """1006, 1008 and 1033: where the antenna's reference point is and what hardware there is."""
    x, y, z = position_ecef_m
    place = {
        "station": station, "itrf_realization_year": 0, "gps": True, "glonass": True, "galileo": True,
        "reference_station": False, "x_ecef_m": x, "single_oscillator": True, "y_ecef_m": y,
        "quarter_cycle": 0, "z_ecef_m": z, "antenna_height_m": max(height_m, 0.0),
    }  # fmt: skip
    hardware = {"station": station, "antenna_type": antenna, "antenna_setup": 0, "antenna_serial": serial}
    more = {"receiver_type": receiver, "receiver_firmware": "", "receiver_serial": ""}
    messages = (Message(1006, place), Message(1008, hardware), Message(1033, {**hardware, **more}))
    return [frame(encode(message)) for message in messages]


def inertial_frame(block: InertialBlock, station: int, number: int = 4001) -> bytes:
    """The project's inertial message of a block."""
    tow_ms, rest_ns = divmod(block.t_first_gps_ns % WEEK_NS, NS_PER_MS)
    message = InertialMessage(
        number,
        station,
        block.sensor,
        tow_ms,
        rest_ns // 1000,
        block.interval_ns // 1000,
        block.temperature_c,
        block.specific_force_m_s2,
        block.angular_rate_rad_s,
    )
    return frame(encode(message))
