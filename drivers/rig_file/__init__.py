"""Rig file: its model, its checks, and messages with the line of each mistake.

The names below are the package's interface. Other modules are private to the package.
"""

from drivers.rig_file.bus_sections import (
    AnyBus,
    CanBus,
    CanMessage,
    Hole,
    ModbusBusSection,
    ModbusRtuBus,
    ModbusRtuTcpBus,
    ModbusTcpBus,
    ModbusTlsBus,
    is_numbered,
    is_rtu,
)
from drivers.rig_file.can_ids import IdMatch, Senders, by_id, by_j1939, pgn_of
from drivers.rig_file.checks import QUALITY_SUFFIX, RESERVED_COLUMNS, Layout, cross_checks, unwritable
from drivers.rig_file.host_address import addresses, is_own
from drivers.rig_file.interlock_specs import (
    AlarmSpec,
    HeaterPowerSpec,
    InterlockSpec,
    Level,
    LimitSpec,
    NoFlowSpec,
    Priority,
    RateOfRiseSpec,
    ResidualSpec,
    SensorSpec,
)
from drivers.rig_file.messages import mistake, shown
from drivers.rig_file.model import LONGEST_NAME, Heartbeat, Point, Rig
from drivers.rig_file.plain_values import checked_host
from drivers.rig_file.reader import RigFileError, file_sha256, load_rig, located
from drivers.rig_file.text import (
    MOST_DESCRIPTION,
    decoded,
    line_of,
    parse_toml,
    read_regular,
    refuse_irregular,
    tables_of,
)
from drivers.rig_file.wires import device_of_bus, serial_device, wire_of_bus

__all__ = [
    "LONGEST_NAME",
    "MOST_DESCRIPTION",
    "QUALITY_SUFFIX",
    "RESERVED_COLUMNS",
    "AlarmSpec",
    "AnyBus",
    "CanBus",
    "CanMessage",
    "Heartbeat",
    "HeaterPowerSpec",
    "Hole",
    "IdMatch",
    "InterlockSpec",
    "Layout",
    "Level",
    "LimitSpec",
    "ModbusBusSection",
    "ModbusRtuBus",
    "ModbusRtuTcpBus",
    "ModbusTcpBus",
    "ModbusTlsBus",
    "NoFlowSpec",
    "Point",
    "Priority",
    "RateOfRiseSpec",
    "ResidualSpec",
    "Rig",
    "RigFileError",
    "Senders",
    "SensorSpec",
    "addresses",
    "by_id",
    "by_j1939",
    "checked_host",
    "cross_checks",
    "decoded",
    "device_of_bus",
    "file_sha256",
    "is_numbered",
    "is_own",
    "is_rtu",
    "line_of",
    "load_rig",
    "located",
    "mistake",
    "parse_toml",
    "pgn_of",
    "read_regular",
    "refuse_irregular",
    "serial_device",
    "shown",
    "tables_of",
    "unwritable",
    "wire_of_bus",
]
