"""Rig files of two rigs that are served: odd encodings on two Modbus devices, and CAN with Modbus."""

from __future__ import annotations

from pathlib import Path

PROJECT = Path(__file__).resolve().parents[3]
BENCH = """
[rig]
name = "bench"
period_s = 0.25
abort_after_s = 2.0

[heartbeat]
point = "beat"
counter = "cycles"
arm = "enable"
status = "state"
trip_mask = 6
watchdog_mask = 2
watchdog = "patience"

[bus.plc]
transport = "modbus_tcp"
host = "192.168.1.20"
port = 502
device_id = 7
uptime = "up"
hole = [{ table = "input", first = 26, last = 27 }]

[bus.meter]
transport = "modbus_rtu"
serial_port = "/dev/ttyUSB7"
device_id = 3

[[point]]
name = "heater_power_set"
bus = "plc"
table = "holding"
address = 10
type = "float32"
order = "CDAB"
unit = "W"
access = "rw"
limits = [0.0, 2000.0]
max_rate = 2000.0
safe_value = 0.0
readback = "heater_power"
readback_tolerance = 10.0

[[point]]
name = "valve_set"
bus = "plc"
table = "holding"
address = 14
type = "int16"
order = "BADC"
scale = 0.5
offset = -10.0
unit = "%"
access = "rw"
limits = [0.0, 100.0]
safe_value = 30.0

[[point]]
name = "beat"
bus = "plc"
table = "holding"
address = 12
unit = "1"
access = "rw"
kind = "status"

[[point]]
name = "patience"
bus = "plc"
table = "holding"
address = 13
scale = 0.1
unit = "s"
access = "rw"
kind = "status"

[[point]]
name = "enable"
bus = "plc"
table = "coil"
address = 4
unit = "1"
access = "rw"
kind = "status"

[[point]]
name = "serial_number"
bus = "plc"
table = "holding"
address = 40
type = "string"
length = 4
order = "BADC"
unit = "1"
expect = "SN-4711"

[[point]]
name = "heater_power"
bus = "meter"
table = "input"
address = 100
type = "int32"
order = "DCBA"
scale = -0.01
unit = "W"
plausible = [-10, 3000]

[[point]]
name = "T_tank"
bus = "plc"
table = "input"
address = 20
type = "int16"
order = "BADC"
scale = 0.01
unit = "degC"
plausible = [-10, 95]
alarm = [30, 80]
invalid = [5500]
stuck_after_s = 10.0

[[point]]
name = "pump_on"
bus = "plc"
table = "input"
address = 21
bits = [0, 0]
unit = "1"
kind = "status"

[[point]]
name = "mode"
bus = "plc"
table = "input"
address = 21
bits = [4, 6]
unit = "1"
kind = "status"
labels = { 5 = "manual", 3 = "auto" }

[[point]]
name = "state"
bus = "plc"
table = "input"
address = 22
unit = "1"
kind = "status"

[[point]]
name = "cycles"
bus = "plc"
table = "input"
address = 23
unit = "1"
kind = "status"

[[point]]
name = "up"
bus = "plc"
table = "input"
address = 24
type = "uint32"
order = "CDAB"
scale = 0.001
unit = "s"
kind = "status"

[[point]]
name = "energy"
bus = "plc"
table = "input"
address = 28
type = "uint64"
order = "BADC"
unit = "Wh"
plausible = [1000, 3000]

[[interlock]]
kind = "limit"
level = "alarm"
point = "T_tank"
high = 70.0
"""
DBC = """VERSION ""

NS_ :

BS_:

BU_: NODE

BO_ 2566834432 TEMPS: 8 NODE
 SG_ Page M : 0|8@1+ (1,0) [0|3] "" NODE
 SG_ T_heater m0 : 15|16@0- (0.01,0) [-40|150] "degC" NODE
 SG_ T_radiator m0 : 31|16@0- (0.01,0) [-40|150] "degC" NODE
 SG_ T_tank m1 : 8|16@1+ (0.01,-40) [-40|150] "degC" NODE
 SG_ clock m1 : 24|32@1+ (0.1,0) [0|400000000] "s" NODE

BO_ 512 ROOM: 4 NODE
 SG_ T_room : 0|32@1- (1,0) [-40|60] "degC" NODE

SIG_VALTYPE_ 512 T_room : 1;
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 512 100;
"""
LOOP = """
[rig]
name = "loop"
twin = "twin.toml"

[heartbeat]
point = "beat"
status = "state"
trip_mask = 1
watchdog_mask = 1

[bus.heaters]
transport = "modbus_rtu_tcp"
host = "10.0.0.7"
port = 4001
device_id = 1

[bus.drives]
transport = "modbus_rtu_tcp"
host = "10.0.0.7"
port = 4001
device_id = 2

[bus.can]
transport = "socketcan"
channel = "can1"
dbc = "temps.dbc"
uptime = "can_clock"

[[point]]
name = "heater_power_set"
bus = "heaters"
table = "holding"
address = 0
type = "int16"
order = "BADC"
scale = 0.5
unit = "W"
access = "rw"
limits = [0.0, 2000.0]
safe_value = 0.0
readback = "heater_power"
readback_tolerance = 20

[[point]]
name = "heater_power"
bus = "heaters"
table = "input"
address = 4
type = "float64"
order = "CDAB"
unit = "W"

[[point]]
name = "beat"
bus = "drives"
table = "holding"
address = 90
unit = "1"
access = "rw"
kind = "status"

[[point]]
name = "state"
bus = "drives"
table = "discrete"
address = 3
unit = "1"
kind = "status"

[[point]]
name = "pump_speed_set"
bus = "drives"
table = "holding"
address = 91
unit = "%"
access = "rw"
limits = [0.0, 100.0]
safe_value = 100.0
readback = "pump_speed"

[[point]]
name = "pump_speed"
bus = "drives"
table = "input"
address = 10
bits = [0, 7]
unit = "%"

[[point]]
name = "fan_speed"
bus = "drives"
table = "input"
address = 10
bits = [8, 15]
unit = "%"
plausible = [0, 100]

[[point]]
name = "T_heater"
bus = "can"
message = "TEMPS"
signal = "T_heater"
unit = "degC"
alarm = [0, 75]

[[point]]
name = "T_radiator"
bus = "can"
message = "TEMPS"
signal = "T_radiator"
unit = "degC"

[[point]]
name = "T_tank"
bus = "can"
message = "TEMPS"
signal = "T_tank"
unit = "degC"

[[point]]
name = "T_ambient"
bus = "can"
message = "ROOM"
signal = "T_room"
unit = "degC"
stale_after_s = 0.6

[[point]]
name = "can_clock"
bus = "can"
message = "TEMPS"
signal = "clock"
unit = "s"
kind = "status"
"""


def bench_file(folder: Path, **changes: str) -> Path:
    """Return a rig file with two devices of odd encodings; `changes` replace texts in it."""
    text = BENCH
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    path = folder / "bench.toml"
    path.write_text(text)
    return path


def loop_file(folder: Path) -> Path:
    """Return a rig file with CAN and two devices on one converter, its DBC and its twin beside it."""
    (folder / "temps.dbc").write_text(DBC)
    parts = (PROJECT / "profiles" / "twins" / "loop.toml").read_text().split("[elements.")
    (folder / "twin.toml").write_text("[elements.".join(p for p in parts if not p.startswith("T_modules_C]")))
    path = folder / "loop.toml"
    path.write_text(LOOP)
    return path
