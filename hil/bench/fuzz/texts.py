"""Small files of every kind that a user may give, and mutations that keep their structure. Pure, from a given seed."""

from __future__ import annotations

import json
import random
import re
from collections.abc import Callable
from typing import Any

VALUES = (
    "0",
    "-1",
    "1.5",
    "1e308",
    "-1e-320",
    "70000",
    "99999999999999999999",
    "0x10",
    "nan",
    "inf",
    "true",
    '""',
    '"x"',
    "'°C'",
    '"\\u0000"',
    "[]",
    "[1]",
    "[1, 2, 3]",
    "[[]]",
    '["a"]',
    "{}",
    "{ a = 1 }",
    "1979-05-27",
    "null",
    "~",
    "!secret k",
    "!include k.yaml",
    "${VAR}",
    "*a",
    "&a",
    "0,1",
    "1/10",
    "x10",
    "-",
    "|",
    ">",
    "<<",
    "<<:",
    "1.000,5",
    "٣",
    "é",
    "\x7f",
)
"""Replacements of a value: wrong types, ends of ranges, other tools' placeholders, decimal commas."""
MARKS = (
    '"',
    "'",
    "[",
    "]",
    "{",
    "}",
    "=",
    ":",
    ",",
    ";",
    "#",
    "\\",
    "\t",
    "\n",
    "\r",
    "\0",
    "\ufeff",
    "|",
    "@",
    "-",
    " ",
)
_TOKEN = re.compile(r"\"[^\"\n]*\"|'[^'\n]*'|[-+]?\d[\w.]*|[A-Za-z_][\w./°-]*")
_MOST_DIGITS = 300
"""Most digits of a counted number: Python reads some thousands."""
_DEEP = 3000
"""Levels of nested lists, beyond Python's call stack."""

RIG = """\
[rig]
name = "small"
period_s = 0.5

[heartbeat]
point = "beat"

[bus.plc]
transport = "modbus_tcp"
host = "127.0.0.1"
port = 502
hole = [{ table = "input", first = 90, last = 95 }]

[bus.can]
transport = "virtual"
channel = "c"
dbc = "bus.dbc"

[[point]]
name = "heater_set"
bus = "plc"
table = "holding"
address = 0
type = "int16"
scale = 0.1
unit = "W"
access = "rw"
limits = [0.0, 900.0]
safe_value = 0.0
readback = "heater"

[[point]]
name = "heater"
bus = "plc"
table = "input"
address = 2
type = "float32"
order = "CDAB"
unit = "W"
plausible = [-1.0, 1000.0]
alarm = [-5.0, 950.0]
invalid = [nan]

[[point]]
name = "mode"
bus = "plc"
table = "input"
address = 8
bits = [0, 2]
kind = "status"
labels = { 0 = "off", 1 = "on" }
unit = "1"

[[point]]
name = "beat"
bus = "plc"
table = "holding"
address = 7
unit = "1"
access = "rw"

[[point]]
name = "T_wall"
bus = "can"
message = "Tank"
signal = "T_wall"
unit = "degC"

[[interlock]]
kind = "no_flow"
level = "alarm"
heater = "heater"
above = 10.0
flow = "mode"
low = 1.0
"""
EFFECTS = """\
[[effect]]
kind = "heat_loss"
where = "tank"
driver = "temperature_difference"
conductance_W_per_K = 2.0
onset_s = 600.0
ramp_s = 60.0
note = "wet insulation"

[[effect]]
kind = "heat_source"
where = "tank"
driver = "pump_speed"
power_W = 15.0
exponent = 3.0
end_s = 900.0
"""
TABLE = """\
Name;Address;Function code;Data type;Byte order;Scale;Offset;Unit;Access;Length;Bit;Min;Max;Remark
Supply;30001;4;INT16;;0,1;;°C;R;;;-10;95;to the rig
Flow;30003;4;FLOAT32;CDAB;;;l/min;R;2;;;;
Serial;30010;4;STRING;;;;;R;6;;;;
Pump on;30020;4;WORD;;;;;R;;0;;;
Set point;40001;3,6;INT16;;0.1;-5;°C;RW;;;0;60;
Remote;00005;1,5;BOOL;;;;;RW;;;;;
"""
TELEGRAF = """\
[[inputs.modbus]]
  name = "plant"
  slave_id = 1
  controller = "tcp://10.0.0.3:502"
  coils = [ { name = "run", address = [3] } ]
  holding_registers = [
    { name = "level", byte_order = "AB", data_type = "FIXED", scale = 0.01, address = [8] },
    { name = "speed", byte_order = "CDAB", data_type = "FLOAT32", scale = "0.1", address = [10, 11] },
  ]

[[inputs.modbus]]
  controller = "file:///dev/ttyUSB0"
  baud_rate = 9600
  configuration_type = "request"
  [[inputs.modbus.request]]
    slave_id = 2
    byte_order = "DCBA"
    register = "input"
    fields = [
      { address = 4, name = "flow", type = "FLOAT32", scale = 0.5, measurement = "m" },
      { address = 7, name = "state", type = "BIT", bit = 3 },
      { address = 9, name = "text", type = "STRING", length = 4 },
    ]
    [inputs.modbus.request.tags]
      a = "b"
"""
HOME = """\
modbus:
  - name: cellar
    type: tcp
    host: 10.0.0.4
    port: 502
    sensors:
      - name: Flow
        slave: 1
        input_type: input
        address: 0x10
        data_type: float32
        swap: word
        unit_of_measurement: L/min
        min_value: 0
        max_value: 8
      - &base
        name: Wall
        address: 4
        scale: 0.1
        virtual_count: 2
        nan_value: "0x8000"
      - <<: *base
        name: Floor
        address: 40
    switches:
      - name: Fan
        address: 9
        command_on: 5
        verify:
          address: 10
          state_on: [5, 6]
    climates:
      - name: room
  - name: line
    type: serial
    method: rtu
    port: /dev/ttyUSB0
    baudrate: 9600
    parity: N
    stopbits: 1
    bytesize: 8
    binary_sensors:
      - name: Door
        address: 3
        slave_count: 1
"""
DBC = """\
VERSION "1"

NS_ :

BS_:

BU_: PLC PC

BO_ 300 Tank: 4 PLC
 SG_ T_wall : 0|16@1- (0.01,0) [-40|200] "degC" PC
 SG_ Mode : 16|4@1+ (1,0) [0|15] "" PC,PLC

BO_ 2566844158 ET1: 8 PLC
 SG_ T_oil : 16|16@1+ (0.03125,-273) [-273|1735] "degC" PC

BO_ 301 Mux: 3 PLC
 SG_ page M : 0|8@1+ (1,0) [0|1] "" PC
 SG_ U m0 : 8|16@1+ (0.001,0) [0|60] "V" PC
 SG_ I m1 : 8|16@1+ (0.001,0) [0|60] "A" PC

CM_ SG_ 300 T_wall "of the
tank";
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 300 500;
VAL_ 300 Mode 0 "off" 1 "on" ;
"""
RUN = {
    "uid": "a",
    "format": 1,
    "exit_status": "done",
    "files": {"rig": {"path": "rig.toml", "sha256": "00"}},
    "segments": [{"number": 2, "from_s": 9.0, "gap_s": 3.0, "profile_s": 9.0, "why": "cut", "exit_status": "done"}],
    "settings": {"speed": 1.0, "seed": 3},
}
CARD = {
    "format": 3,
    "name": "loop",
    "members": {"a.safetensors": "00", "b.safetensors": "11"},
    "modes": {"causal": {"outputs": {"overall": [1.0], "binned": {"0": [1.0]}}, "parameters": None}},
}


def mutated(text: str, pick: random.Random) -> bytes:
    """Return a text with one to three of its lines, words or marks changed, and now and then its bytes."""
    for _ in range(pick.randint(1, 3)):
        text = pick.choice(_CHANGES)(text, pick)
    raw = text.encode("utf-8", "surrogatepass")
    chance = pick.random()
    if chance < 0.03:
        at = pick.randrange(len(raw) + 1)
        raw = raw[:at] + pick.randbytes(pick.randint(1, 4)) + raw[at:]
    elif chance < 0.04:
        raw = text.encode("utf-16" if pick.random() < 0.5 else "cp1252", "replace")
    elif chance < 0.05:
        raw = raw[: pick.randrange(len(raw) + 1)]
    return raw


def mutated_json(document: Any, pick: random.Random) -> bytes:
    """Return JSON of a document in which one to three values, keys or marks are changed."""
    document = json.loads(json.dumps(document))
    for _ in range(pick.randint(1, 3)):
        document = _changed(document, pick)
    text = json.dumps(document)
    return mutated(text, pick) if pick.random() < 0.3 else text.encode()


def _changed(node: Any, pick: random.Random) -> Any:
    if isinstance(node, dict) and node and pick.random() < 0.8:
        key = pick.choice(list(node))
        kind = pick.random()
        if kind < 0.2:
            return {name: value for name, value in node.items() if name != key}
        if kind < 0.3:
            return {("x" if name == key else name): value for name, value in node.items()}
        return {name: (_changed(value, pick) if name == key else value) for name, value in node.items()}
    if isinstance(node, list) and node and pick.random() < 0.7:
        at = pick.randrange(len(node))
        return [*node[:at], _changed(node[at], pick), *node[at + 1 :]]
    return pick.choice(
        (None, True, -1, 0, 1e308, float("nan"), 10**30, "", "x", "\0", "../a", [], [node], {}, {"a": node})
    )


def _word(text: str, pick: random.Random) -> str:
    """Replace a word or a number by another value."""
    words = list(_TOKEN.finditer(text))
    if not words:
        return text + pick.choice(VALUES)
    one = pick.choice(words)
    new = pick.choice(VALUES) if pick.random() < 0.7 else pick.choice(words)[0]
    return text[: one.start()] + new + text[one.end() :]


def _number(text: str, pick: random.Random) -> str:
    """Replace a number by another."""
    numbers = list(re.finditer(r"\d+", text))
    if not numbers:
        return text
    one = pick.choice(numbers)
    near = int(one[0][:_MOST_DIGITS])
    new = str(pick.choice((0, 1, 7, 16, 31, 64, 255, 65535, 65536, 10**9, -1, near + 1, near * 10)))
    return text[: one.start()] + new + text[one.end() :]


def _line(text: str, pick: random.Random) -> str:
    """Delete, repeat or move a line."""
    lines = text.splitlines(keepends=True)
    if not lines:
        return text
    one = lines.pop(pick.randrange(len(lines)))
    kind = pick.random()
    if kind < 0.4:
        return "".join(lines)
    lines.insert(pick.randrange(len(lines) + 1), one)
    if kind < 0.6:
        lines.insert(pick.randrange(len(lines) + 1), one)
    return "".join(lines)


def _mark(text: str, pick: random.Random) -> str:
    """Insert or delete a mark of the format's syntax."""
    at = pick.randrange(len(text) + 1)
    if pick.random() < 0.5:
        return text[:at] + pick.choice(MARKS) + text[at:]
    places = [i for i, letter in enumerate(text) if letter in MARKS]
    if not places:
        return text
    at = pick.choice(places)
    return text[:at] + text[at + 1 :]


def _letter(text: str, pick: random.Random) -> str:
    """Change a letter: a misspelt key, a wrong digit."""
    if not text:
        return text
    at = pick.randrange(len(text))
    return text[:at] + chr(pick.choice((pick.randrange(33, 127), pick.randrange(0xA0, 0x250)))) + text[at + 1 :]


def _odd(text: str, pick: random.Random) -> str:
    """Apply a rare change: lists without end, long words, another line end, an empty file."""
    kind = pick.random()
    if kind < 0.1:
        return ""
    if kind < 0.3:
        return text.replace("\n", pick.choice(("\r", "\r\n", "\n\n")))
    if kind < 0.6:
        return _word_by(text, pick, "9" * pick.choice((400, 5000)))
    if kind < 0.65:
        return _word_by(text, pick, "[" * _DEEP)
    return _word_by(text, pick, pick.choice(("a" * 10_000, "[[[[[[1]]]]]]", "\u202e", "\U0001f525", "\ud800")))


def _word_by(text: str, pick: random.Random, new: str) -> str:
    words = list(_TOKEN.finditer(text))
    if not words:
        return new
    one = pick.choice(words)
    return text[: one.start()] + new + text[one.end() :]


_CHANGES: tuple[Callable[[str, random.Random], str], ...] = (
    _word,
    _word,
    _word,
    _number,
    _number,
    _line,
    _line,
    _mark,
    _letter,
    _letter,
    _odd,
)
"""Changes; the first have more weight: they keep most of the file unchanged."""
