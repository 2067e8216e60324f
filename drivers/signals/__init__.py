"""Signals: points, units, roles, and codecs of raw numbers.

The names below are the package's interface. Other modules are private to the package.
"""

from drivers.signals.ascii_names import in_ascii
from drivers.signals.codec import (
    UNSIGNED,
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
    raw_bounds,
    raw_sentinels,
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
    prefixed_unit,
    split_column,
)

__all__ = [
    "FAN",
    "HEATER",
    "PLAUSIBLE",
    "ROLES",
    "ROOM",
    "SUFFIX_OF_UNIT",
    "UNSIGNED",
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
    "in_ascii",
    "known_unit",
    "nearest_role",
    "plausible_range",
    "prefixed_unit",
    "raw_bounds",
    "raw_sentinels",
    "split_column",
]
