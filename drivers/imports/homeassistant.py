"""Home Assistant's `modbus:` section: sensors, binary sensors and switches of its hubs.

Facts from the integration's documentation: addresses are zero-based, a value is raw x scale + offset, `swap` is none,
byte, word or word_byte. PyYAML reads the file; it is no dependency of ours, and asked for where it is missing.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.imports.draft import Collector, Draft, DraftBus, ImportFileError, number, read_text, whole
from drivers.imports.sections import Sections, serial, tcp

_TABLES = {
    "holding": "holding",
    "input": "input",
    "coil": "coil",
    "discrete_input": "discrete",
    "holdings": "holding",
    "coils": "coil",
}
_TYPES = ("int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64", "string")
_ORDERS = {"none": "ABCD", "byte": "BADC", "word": "CDAB", "word_byte": "DCBA"}
_SERIAL = {"baud": "baudrate", "parity": "parity", "stop_bits": "stopbits", "data_bits": "bytesize"}
_DEEPEST = 50
_MOST = 100_000


@dataclass(slots=True)
class Placed:
    """A value of the YAML file and its line; `value` holds `Placed` again inside of lists and tables."""

    value: Any
    line: int

    def get(self, key: str) -> Placed | None:
        """The entry of a table, or None."""
        return self.value.get(key) if isinstance(self.value, dict) else None

    def plain(self, key: str, default: Any = None) -> Any:
        """The text, number or bool of an entry, or `default`."""
        found = self.get(key)
        return default if found is None or found.value is None else found.value


def import_homeassistant(path: Path) -> Draft:
    """The draft of a Home Assistant configuration; raises ImportFileError with the line and what to do."""
    return draft_of(path, _loaded(path, read_text(path)))


def draft_of(path: Path, document: Placed) -> Draft:
    """The draft of a configuration that has been read: the whole file, or the list below its `modbus:`."""
    hubs = document.get("modbus") or document
    if isinstance(hubs.value, dict):
        hubs = Placed([hubs], hubs.line)
    if not isinstance(hubs.value, list) or not any(hub.get("type") for hub in hubs.value):
        raise ImportFileError(path, hubs.line, "has no modbus: section with hubs; give the file that holds it")
    importing = _Import(path)
    for hub in hubs.value:
        importing.hub(hub)
    buses = importing.buses.with_points()
    if not buses:
        raise ImportFileError(path, hubs.line, "has hubs without sensors or switches; there is nothing to import")
    return Draft(path, buses, importing.collector.notes)


class _Import:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.collector = Collector(path)
        self.buses = Sections()

    def hub(self, hub: Placed) -> None:
        kind = hub.plain("type")
        if kind not in ("tcp", "rtuovertcp", "serial") or hub.plain("method", "rtu") != "rtu":
            spoken = kind if kind != "serial" else f"serial, method {hub.plain('method')}"
            said = f"hub of type {spoken}: rig files know tcp, rtuovertcp and serial with method rtu; change the hub"
            raise ImportFileError(self.path, hub.line, said)
        for section, default in (("sensors", "holding"), ("binary_sensors", "coil"), ("switches", "holding")):
            items = hub.get(section)
            if items is None or items.value is None:
                continue
            if not isinstance(items.value, list):
                raise ImportFileError(self.path, items.line, f"{section} is no list; begin each entry with a dash")
            for item in items.value:
                self._item(hub, item, section, default)
        for section in ("climates", "covers", "fans", "lights"):
            if hub.get(section) is not None:
                self.collector.notes.append(f"{section} were left out: a rig has points only")

    def _item(self, hub: Placed, item: Placed, section: str, default: str) -> None:
        line, name = item.line, item.plain("name")
        if not isinstance(name, str) or not name:
            raise ImportFileError(self.path, line, f"an entry of {section} has no name; add one")
        wanted = item.plain("write_type" if section == "switches" else "input_type", default)
        table = _TABLES.get(wanted) if isinstance(wanted, str) else None
        if table is None:
            raise ImportFileError(self.path, line, f"table {wanted!r} of {name} is not known; use {', '.join(_TABLES)}")
        keys: dict[str, Any] = {
            "table": table,
            "address": whole(self.path, line, f"address of {name}", item.plain("address"), 0, 65535),
            "unit": str(item.plain("unit_of_measurement", "")),
        }
        if section == "switches":
            keys |= {"access": "rw", "kind": "status"}
        elif section == "binary_sensors":
            keys["kind"] = "status"
            if table in ("holding", "input"):
                keys |= {"bits": [0, 0]}
        else:
            keys |= self._typed(name, line, item)
        bus = self._bus(hub, item)
        bus.points.append(self.collector.point(bus.name, name, line, keys))

    def _typed(self, name: str, line: int, item: Placed) -> dict[str, Any]:
        kind = item.plain("data_type", "int16")
        if kind not in _TYPES:
            raise ImportFileError(
                self.path, line, f"data_type {kind!r} of {name} is not known; use {', '.join(_TYPES)}"
            )
        swap = item.plain("swap", "none")
        order = _ORDERS.get(swap) if isinstance(swap, str) else None
        if order is None:
            raise ImportFileError(self.path, line, f"swap {swap!r} of {name} is not known; use {', '.join(_ORDERS)}")
        keys: dict[str, Any] = {"type": kind}
        if kind == "string":
            keys["length"] = whole(self.path, line, f"count of {name}", item.plain("count", 0), 1, 125)
            return keys | {"kind": "status"} | ({"order": order} if order != "ABCD" else {})
        if order != "ABCD":
            keys["order"] = order
        for key, neutral in (("scale", 1.0), ("offset", 0.0)):
            value = number(self.path, line, f"{key} of {name}", item.plain(key, neutral))
            if value != neutral:
                keys[key] = value
        sentinel = item.plain("nan_value")
        if sentinel is not None:
            text = str(sentinel)
            given = int(text, 16) if text.lower().startswith("0x") and _is_hex(text[2:]) else sentinel
            keys["invalid"] = [number(self.path, line, f"nan_value of {name}", given)]
        low, high = item.plain("min_value"), item.plain("max_value")
        if low is not None and high is not None:
            keys["plausible"] = [
                number(self.path, line, f"min_value of {name}", low),
                number(self.path, line, f"max_value of {name}", high),
            ]
        return keys

    def _bus(self, hub: Placed, item: Placed) -> DraftBus:
        device = item.plain("device_address", item.plain("slave", 1))
        device = whole(self.path, item.line, "slave", device, 0, 255)
        if hub.plain("type") == "serial":
            given = {ours: hub.plain(theirs) for ours, theirs in _SERIAL.items()}
            port = hub.plain("port")
            if not isinstance(port, str) or not port:
                raise ImportFileError(self.path, hub.line, "a serial hub has no port; add it, /dev/ttyUSB0 for example")
            return self.buses.of(serial(self.path, hub.line, port, device, **given))
        host = hub.plain("host")
        if not isinstance(host, str) or not host:
            raise ImportFileError(self.path, hub.line, "a hub has no host; add it")
        number_of = whole(self.path, hub.line, "port", hub.plain("port", 502), 1, 65535)
        return self.buses.of(tcp(host, number_of, device, rtu=hub.plain("type") == "rtuovertcp"))


def _is_hex(text: str) -> bool:
    return 0 < len(text) <= 16 and all(letter in "0123456789abcdefABCDEF" for letter in text)


def _loaded(path: Path, text: str) -> Placed:
    try:
        import yaml
    except ImportError:
        raise ImportFileError(
            path, None, "is YAML, which takes PyYAML to read; install it (pip install pyyaml) and try again"
        ) from None
    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
        return Placed({}, 1) if node is None else _placed(path, node, yaml, 0, [0])
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark is not None else None
        raise ImportFileError(path, line, f"is not valid YAML: {error.problem}; correct the line") from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise ImportFileError(path, None, f"is not valid YAML: {' '.join(str(error).split())}; correct it") from None


def _placed(path: Path, node: Any, yaml: Any, depth: int, count: list[int]) -> Placed:
    """A YAML node with its line. Tags of Home Assistant's own (!secret, !include) are taken as the text behind them."""
    line = node.start_mark.line + 1
    count[0] += 1  # an alias stands for all that its anchor holds, and aliases of aliases for no end of it
    if depth > _DEEPEST or count[0] > _MOST:
        raise ImportFileError(
            path, line, f"is deeper than {_DEEPEST} levels or holds too much; is this a configuration?"
        )
    if isinstance(node, yaml.MappingNode):
        return Placed({str(k.value): _placed(path, v, yaml, depth + 1, count) for k, v in node.value}, line)
    if isinstance(node, yaml.SequenceNode):
        return Placed([_placed(path, item, yaml, depth + 1, count) for item in node.value], line)
    standard = node.tag in {f"tag:yaml.org,2002:{kind}" for kind in ("int", "float", "bool", "null")}
    return Placed(yaml.SafeLoader("").construct_object(node) if standard else node.value, line)
