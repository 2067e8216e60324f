"""Importer of a description: heaters, pumps, fans and thermocouples of a person's words, as a draft of a rig file."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from drivers.can import DbcSignal, describe_dbc
from drivers.importers.draft import Draft, DraftBus, DraftPoint
from drivers.signals import ROLES, WIDTH, ByteOrder, ConfigurationError, RegisterType, canonical_unit

MODBUS, CAN = "plc", "can"
PLACE_SYNTAX = "holding:0, input:12:int16*0.01, 40001:float32:CDAB, or MESSAGE.SIGNAL of a DBC"
_TABLES = {"0": "coil", "1": "discrete", "3": "input", "4": "holding"}
_MODBUS_PLACE = re.compile(
    r"(?:(?P<table>coil|discrete|input|holding):(?P<address>\d{1,5})|(?P<modicon>[0134]\d{4,5}))"
    r"(?::(?P<type>[a-z]+\d*))?(?::(?P<order>[A-D]{4}))?(?:\*(?P<scale>[0-9.eE+-]+))?"
)
_CAN_PLACE = re.compile(r"(?P<message>[A-Za-z_]\w*)\.(?P<signal>[A-Za-z_]\w*)")


class DescriptionError(ConfigurationError):
    """Error of a description of a rig that cannot be understood; the message is one plain sentence."""


@dataclass(frozen=True, slots=True)
class SignalPlace:
    """Place of a value: `keys` as a rig file has them, on bus `plc` or `can`."""

    bus: str
    keys: dict[str, Any]


@dataclass(frozen=True, slots=True)
class DescribedActuator:
    """Heater, pump or fan: places of set-point and read-back, and the largest set-point, in W or %."""

    kind: Literal["heater", "pump", "fan"]
    written: SignalPlace
    read: SignalPlace | None
    most: float


@dataclass(slots=True)
class Described:
    """Rig as a person described it. `modbus` and `can` are keys of the buses; `trip_C` trips any thermocouple, degC."""

    name: str = "rig"
    period_s: float = 1.0
    modbus: dict[str, Any] | None = None
    can: dict[str, Any] | None = None
    actuators: list[DescribedActuator] = field(default_factory=list)
    thermocouples: dict[str, SignalPlace] = field(default_factory=dict)
    flow: SignalPlace | None = None
    heartbeat: dict[str, SignalPlace] = field(default_factory=dict)
    """`point`, and perhaps `counter`, `arm` and `watchdog`."""
    trip_C: float = 75.0


def place_of(text: str) -> SignalPlace:
    """Return the place of a text like `holding:0*0.1` (zero-based), `40001:float32:CDAB` (Modicon), `MESSAGE.SIGNAL`.

    Raises DescriptionError.
    """
    text = text.strip()
    on_can = _CAN_PLACE.fullmatch(text)
    if on_can is not None:
        return SignalPlace(CAN, {"message": on_can["message"], "signal": on_can["signal"]})
    found = _MODBUS_PLACE.fullmatch(text)
    if found is None:
        raise DescriptionError(f"{text!r} is no place of a value; write it like {PLACE_SYNTAX}")
    if found["modicon"] is None:
        table, address = found["table"], int(found["address"])
    else:
        table, address = _TABLES[found["modicon"][0]], int(found["modicon"][1:]) - 1
    if not 0 <= address <= 65535:
        raise DescriptionError(f"{text!r}: addresses go from 0 to 65535, Modicon's numbers from 40001")
    keys: dict[str, Any] = {"table": table, "address": address}
    for key, known in (("type", get_args(RegisterType)), ("order", get_args(ByteOrder))):
        if found[key] is not None:
            if found[key] not in known:
                raise DescriptionError(f"{text!r}: {key} {found[key]} is not known; use {', '.join(known)}")
            keys[key] = found[key]
    if found["scale"] is not None:
        try:
            keys["scale"] = float(found["scale"])
        except ValueError:
            raise DescriptionError(f"{text!r}: {found['scale']!r} is no number; *0.1 is a tenth a count") from None
    return SignalPlace(MODBUS, keys)


def words_of(text: str, known: tuple[str, ...]) -> dict[str, str]:
    """Return `set=holding:0,read=input:0,max=1000` as a dict; the first key may be left out. Raise DescriptionError."""
    found: dict[str, str] = {}
    for number, part in enumerate(text.split(",")):
        key, sign, value = part.partition("=")
        if not sign:
            key, value = (known[0], part) if number == 0 else (part, "")
        if key.strip() not in known or not value.strip():
            raise DescriptionError(f"{part.strip()!r} in {text!r} is not understood; it takes {'=, '.join(known)}=")
        found[key.strip()] = value.strip()
    return found


def actuator_of(kind: Literal["heater", "pump", "fan"], text: str) -> DescribedActuator:
    """Return the heater, pump or fan of `set=PLACE,read=PLACE,max=NUMBER`; raise DescriptionError."""
    words = words_of(text, ("set", "read", "max"))
    if "set" not in words:
        raise DescriptionError(f"{text!r} does not say where the {kind} is written; add set=PLACE")
    read = place_of(words["read"]) if "read" in words else None
    try:
        most = float(words["max"]) if "max" in words else 1000.0 if kind == "heater" else 100.0
    except ValueError:
        raise DescriptionError(f"max={words['max']} in {text!r} is no number") from None
    if not 0.0 < most < float("inf"):
        raise DescriptionError(f"max={most:g} in {text!r} must be above 0")
    return DescribedActuator(kind, place_of(words["set"]), read, most)


def heartbeat_of(text: str) -> dict[str, SignalPlace]:
    """Return the places of `point=PLACE,counter=PLACE,arm=PLACE,watchdog=PLACE`; raise DescriptionError."""
    words = words_of(text, ("point", "counter", "arm", "watchdog"))
    if "point" not in words:
        raise DescriptionError(f"{text!r} does not say which register the harness changes; add point=PLACE")
    return {key: place_of(value) for key, value in words.items()}


def temperatures_of(dbc: Path, encoding: str | None = None) -> dict[str, SignalPlace]:
    """Return the places of a DBC's signals in degC, by name; raise DescriptionError where there are none."""
    found = {
        signal.name: SignalPlace(CAN, {"message": signal.message, "signal": signal.name})
        for signal in describe_dbc(dbc, encoding)
        if _unit(signal) == "degC"
    }
    if not found:
        raise DescriptionError(f"{dbc} describes no signal in degC; name the thermocouples as NAME=MESSAGE.SIGNAL")
    return found


def _unit(signal: DbcSignal) -> str:
    try:
        return canonical_unit(signal.unit)
    except ValueError:
        return ""


_HEAD = """\
# Rig file of {name}, made by `hil init`. Addresses are zero-based, as they are on the wire.
# `hil check` explains it and names every mistake, `hil check --online` shows the rig's readings. Before the first run,
# check every line that is marked "guessed": limits, rates, safe values, plausible ranges and alarms.
"""
_UNIT = {"heater": "W", "pump": "%", "fan": "%"}
_NAME = {"heater": "heater_power", "pump": "pump_speed", "fan": "fan_speed"}
_SAFE = {
    "heater": (0.0, 0, "off"),
    "pump": (None, 1, "goes on: the water carries the heat away"),
    "fan": (None, 2, "goes on"),
}


def draft_of_description(rig: Described, out: Path) -> Draft:
    """Return the draft of a rig file at `out`, with the DBC's path relative to it; raise DescriptionError."""
    points: dict[str, list[DraftPoint]] = {}
    heaters: list[str] = []
    for kind in ("heater", "pump", "fan"):
        for number, one in enumerate((a for a in rig.actuators if a.kind == kind), 1):
            name = _NAME[kind] if number == 1 else f"{_NAME[kind]}_{number}"
            for bus, point in _driven(one, name, number == 1, rig.period_s):
                points.setdefault(bus, []).append(point)
            if kind == "heater" and one.read is not None:
                heaters.append(name)
    if rig.flow is not None:
        keys: dict[str, Any] = {"unit": "L/min", "role": "flow", "plausible": [-0.1, 100.0]}
        points.setdefault(rig.flow.bus, []).append(_point("flow", rig.flow, keys, {"plausible": "guessed"}))
    stale = _stale_after(rig)
    for name, place in rig.thermocouples.items():
        keys = {
            "unit": "degC",
            **({"role": name} if name in ROLES else {}),
            "plausible": [-10.0, max(95.0, rig.trip_C + 20.0)],
            "alarm": [-5.0, rig.trip_C],
            "stale_after_s": stale.get(str(place.keys.get("message")), 3.0 * rig.period_s),
        }
        said = {
            "plausible": "guessed: a reading beyond it is recorded as out of range",
            "alarm": "guessed: beyond it the run ends",
            "stale_after_s": "guessed: three periods, or cycles of its message",
        }
        points.setdefault(place.bus, []).append(_point(name, place, keys, said))
    sections = _sections(rig, points, heaters)
    buses = [(MODBUS, rig.modbus), (CAN, rig.can)]
    for bus, keys_of in buses:
        if keys_of is None and points.get(bus):
            what = "a DBC (--dbc)" if bus == CAN else "the rig's host (--host)"
            raise DescriptionError(f"{points[bus][0].name} is on {bus.upper()}, which needs {what}")
    drafts = [DraftBus(bus, _relative(keys, out), points[bus]) for bus, keys in buses if keys and points.get(bus)]
    if not drafts:
        raise DescriptionError("there is nothing on this rig yet; name a heater or a thermocouple at least")
    given = {"abort_after_s": (max(5.0, 5.0 * rig.period_s), "guessed: what stays lost this long ends the run")}
    return Draft(out, drafts, head=_HEAD.format(name=rig.name), rig=given, sections=sections)


def _driven(one: DescribedActuator, name: str, first: bool, period_s: float) -> list[tuple[str, DraftPoint]]:
    """Return the set-point of an actuator and its read-back, each with its bus."""
    unit = _UNIT[one.kind]
    safe, order, why = _SAFE[one.kind]
    keys: dict[str, Any] = {
        "unit": unit,
        "access": "rw",
        "limits": [0.0, one.most],
        "max_rate": one.most / (10.0 if unit == "W" else 5.0),
        "safe_value": one.most if safe is None else safe,
        "safe_order": order,
    }
    said = {
        "limits": "guessed: no profile goes beyond",
        "max_rate": f"guessed: {unit} a second",
        "safe_value": f"guessed: {why}",
        "safe_order": "guessed: the lowest is made safe first",
    }
    if one.read is None:  # profiles and twins find it by its own name
        return [(one.written.bus, _point(name, one.written, keys, said))]
    keys |= {"readback": name, "readback_tolerance": 0.02 * one.most, "readback_within_s": 60.0}
    said |= {"readback_tolerance": "guessed", "readback_within_s": "guessed"}
    low = -0.005 * one.most if unit == "W" else 0.0
    back: dict[str, Any] = {"unit": unit, **({"role": name} if first else {}), "plausible": [low, 1.2 * one.most]}
    back["stale_after_s"] = 3.0 * period_s
    return [
        (one.written.bus, _point(f"{name}_set", one.written, keys, said)),
        (
            one.read.bus,
            _point(name, one.read, back, {"plausible": "guessed", "stale_after_s": "guessed: three periods"}),
        ),
    ]


def _point(name: str, place: SignalPlace, keys: dict[str, Any], remarks: dict[str, str]) -> DraftPoint:
    assumed: dict[str, Any] = {}
    if place.keys.get("table") in ("holding", "input"):
        kind = place.keys.get("type", "uint16")
        if "type" not in place.keys:
            assumed["type"] = kind
        if "order" not in place.keys and WIDTH.get(kind, 1) > 1:
            assumed["order"] = "ABCD"
        if "scale" not in place.keys and "int" in kind and keys.get("unit") != "1":
            assumed["scale"] = 1.0
    guessed = dict.fromkeys(assumed, "guessed: the place does not give it")
    return DraftPoint(name, 0, {"bus": place.bus, **place.keys, **assumed, **keys}, remarks=guessed | remarks)


def _stale_after(rig: Described) -> dict[str, float]:
    """Return three cycles of each CAN message, s, by name; messages without a cycle time in the DBC are left out."""
    if rig.can is None:
        return {}
    signals = describe_dbc(Path(rig.can["dbc"]), rig.can.get("dbc_encoding", "utf-8"))
    return {s.message: round(max(3.0 * s.cycle_s, 0.1), 3) for s in signals if s.cycle_s}


def _relative(keys: dict[str, Any], out: Path) -> dict[str, Any]:
    if "dbc" not in keys:
        return keys
    return keys | {"dbc": Path(os.path.relpath(keys["dbc"], out.parent)).as_posix()}


def _sections(rig: Described, points: dict[str, list[DraftPoint]], heaters: list[str]) -> list[str]:
    """Return heartbeat and interlocks as text, or a comment about the missing heartbeat."""
    said: list[str] = []
    if rig.heartbeat:
        names = {"point": "heartbeat", "counter": "rig_counter", "arm": "arm", "watchdog": "watchdog_timeout"}
        for key, place in rig.heartbeat.items():
            keys = {"unit": "s" if key == "watchdog" else "1", "kind": "status"}
            keys |= {} if key == "counter" else {"access": "rw"}
            points.setdefault(place.bus, []).append(_point(names[key], place, keys, {}))
        lines = [f'{key} = "{names[key]}"' for key in rig.heartbeat]
        hint = "# status, trip_mask, watchdog_mask: where the rig says that it has tripped by itself"
        said.append("\n".join(["[heartbeat]              # mutual supervision of rig and harness", *lines, hint]))
    else:
        said.append(
            "# No [heartbeat]: when this computer dies or the link is gone, nothing cuts the heater. Have the rig\n"
            "# watch a register that changes on every tick, and name it here, see profiles/rigs/virtual.toml."
        )
    if rig.flow is not None:
        for name in heaters:
            said.append(
                "[[interlock]]            # no heat without flow\n"
                f'kind = "no_flow"\nlevel = "alarm"\nheater = "{name}"\nabove = 20.0             # guessed: W\n'
                'flow = "flow"\nlow = 0.5                # guessed: L/min\non_delay_s = 2.0         # guessed'
            )
    return said
