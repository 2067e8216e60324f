"""A DBC of J1939 messages as they are met: null source address, PDU1 and PDU2, and what a rig file says of them."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from pathlib import Path

from drivers.rig_file.bus_sections import CanBus
from drivers.rig_file.model import Point

ET1, EEC1, TSC1, PLAIN = 0x18FEEEFE, 0x0CF00400, 0x0C0000FE, 0x18FF0142
DBC = """VERSION ""

NS_ :

BS_:

BU_: ECU

BO_ {et1} ET1: 8 ECU
 SG_ T_coolant : 0|8@1+ (1,-40) [0|0] "degC" ECU
 SG_ T_fuel : 8|8@1+ (1,-40) [-40|210] "degC" ECU
 SG_ T_oil : 16|16@1+ (0.03125,-273) [-273|1735] "degC" ECU
 SG_ fan_state : 32|2@1+ (1,0) [0|3] "" ECU

BO_ {eec1} EEC1: 8 ECU
 SG_ speed : 24|16@1+ (0.125,0) [0|8031.875] "1/min" ECU

BO_ {tsc1} TSC1: 8 ECU
 SG_ torque : 0|8@1+ (1,-125) [-125|125] "%" ECU

BO_ {plain} PLAIN: 8 ECU
 SG_ level : 0|16@1+ (1,0) [0|1000] "" ECU

CM_ BO_ {et1} "Engine temperature 1";
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "VFrameFormat" "ExtendedCAN";
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "VFrameFormat" BO_ {et1} 3;
BA_ "VFrameFormat" BO_ {eec1} 3;
BA_ "VFrameFormat" BO_ {tsc1} 3;
BA_ "GenMsgCycleTime" BO_ {et1} 1000;
"""


def dbc_in(folder: Path, **ids: int) -> Path:
    """The DBC, with other identifiers where `ids` say so."""
    found = {"et1": ET1, "eec1": EEC1, "tsc1": TSC1, "plain": PLAIN} | ids
    path = folder / "j1939.dbc"
    path.write_text(DBC.format(**{name: value | 1 << 31 for name, value in found.items()}), encoding="utf-8")
    return path


POINTS = (
    Point(name="T_coolant", bus="c", unit="degC", message="ET1", signal="T_coolant", stale_after_s=0.3),
    Point(name="T_oil", bus="c", unit="degC", message="ET1", signal="T_oil", stale_after_s=0.3),
)


def section(dbc: Path, messages: Iterable[dict[str, object]] = (), **keys: object) -> CanBus:
    """A CAN section with entries for messages."""
    return CanBus.model_validate({"transport": "virtual", "dbc": dbc, "message": tuple(messages)} | keys)


def et1(coolant_C: float, oil_C: float) -> bytes:
    """The bytes of ET1; temperatures in whole degrees."""
    return struct.pack("<BBHB3x", round(coolant_C + 40), 0xFF, round((oil_C + 273) / 0.03125), 0xFF)
