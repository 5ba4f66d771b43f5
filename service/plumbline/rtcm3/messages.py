"""Payloads to messages and back, by message number."""

from plumbline.errors import ContractError
from plumbline.rtcm3.fields import Malformed, Message, Unknown, decode_table, encode_table, subtype_of, table_of
from plumbline.rtcm3.inertial import DEFAULT_INERTIAL_NUMBER, InertialMessage, decode_inertial, encode_inertial
from plumbline.rtcm3.legacy import LEGACY_TABLES, decode_legacy, encode_legacy
from plumbline.rtcm3.msm import decode_msm
from plumbline.rtcm3.msm_encoder import encode_msm
from plumbline.rtcm3.msm_layout import MSM_NUMBERS
from plumbline.rtcm3.observations import Observations

Encodable = Observations | InertialMessage | Message
DecodedMessage = Encodable | Malformed | Unknown


def decode(payload: bytes, inertial_number: int = DEFAULT_INERTIAL_NUMBER) -> DecodedMessage:
    """Decode a payload: never raises, whatever the bytes; what cannot be understood is a value that says so."""
    if len(payload) < 2:
        return Malformed(0, "too_short")
    number = (payload[0] << 4) | (payload[1] >> 4)
    if number == inertial_number:
        return decode_inertial(payload)
    if number in MSM_NUMBERS:
        return decode_msm(number, payload)
    if number in LEGACY_TABLES:
        return decode_legacy(number, payload)
    table = table_of(number)
    if table is None:
        subtype = subtype_of(number, payload)
        table = table_of(number, subtype)
        if table is None:
            return Unknown(number, subtype)
    return decode_table(table, payload)


def encode(message: Encodable) -> bytes:
    """Encode a message to a payload; raises :class:`ContractError` for what its type cannot hold."""
    if isinstance(message, InertialMessage):
        return encode_inertial(message)
    if isinstance(message, Observations):
        return encode_legacy(message) if message.number in LEGACY_TABLES else encode_msm(message)
    table = table_of(message.number, message.subtype)
    if table is None:
        raise ContractError(f"no table for message {message.number}, subtype {message.subtype}")
    return encode_table(table, message.fields)
