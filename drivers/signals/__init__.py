"""Signals: points, units, roles, and codecs of raw numbers.

The names below are the package's interface. Other modules are private to the package.
"""

from drivers.signals.codec import (
    WIDTH,
    ByteOrder,
    CodecError,
    RegisterType,
    decode,
    decode_text,
    decoder,
    encode,
    encode_text,
    encoder,
)
from drivers.signals.points import (
    ConfigurationError,
    DeadlineError,
    DeviceExceptionError,
    DriverError,
    LateReplyError,
    LinkError,
    ProtocolError,
    Quality,
    Signal,
    Snapshot,
)
from drivers.signals.roles import FAN, HEATER, ROLES, ROOM, nearest_role
from drivers.signals.units import (
    PLAUSIBLE,
    SUFFIX_OF_UNIT,
    canonical_unit,
    column_name,
    known_unit,
    plausible_range,
    split_column,
)

__all__ = [
    "FAN",
    "HEATER",
    "PLAUSIBLE",
    "ROLES",
    "ROOM",
    "SUFFIX_OF_UNIT",
    "WIDTH",
    "ByteOrder",
    "CodecError",
    "ConfigurationError",
    "DeadlineError",
    "DeviceExceptionError",
    "DriverError",
    "LateReplyError",
    "LinkError",
    "ProtocolError",
    "Quality",
    "RegisterType",
    "Signal",
    "Snapshot",
    "canonical_unit",
    "column_name",
    "decode",
    "decode_text",
    "decoder",
    "encode",
    "encode_text",
    "encoder",
    "known_unit",
    "nearest_role",
    "plausible_range",
    "split_column",
]
