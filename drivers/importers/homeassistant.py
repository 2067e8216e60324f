"""Importer of Home Assistant's `modbus:` section: sensors, binary sensors and switches of its hubs.

Facts from the integration's documentation and source (home-assistant/core, components/modbus): addresses are
zero-based, a value is raw x scale + offset, `swap` is none, byte, word or word_byte. `virtual_count` (once
`slave_count`) is the number of further entities that follow the first. `min_value` and `max_value` are limits that
Home Assistant clips to, `nan_value` is a raw number, `precision` rounds what is shown.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from drivers.importers.draft import Collector, Draft, DraftBus, ImportFileError, placeholder_in, read_text, whole
from drivers.importers.homeassistant_types import typed
from drivers.importers.sections import Sections, serial, tcp
from drivers.importers.yaml_places import Placed, load_placed
from drivers.rig_file import shown
from drivers.signals import WIDTH

_TABLES = {
    "holding": "holding",
    "input": "input",
    "coil": "coil",
    "discrete_input": "discrete",
    "holdings": "holding",
    "coils": "coil",
}
_SERIAL = {"baud": "baudrate", "parity": "parity", "stop_bits": "stopbits", "data_bits": "bytesize"}
_SECTIONS = (("sensors", "holding"), ("binary_sensors", "coil"), ("switches", "holding"))
_LEFT_OUT = ("climates", "covers", "fans", "lights")
_HUB_HARMLESS = {"name", "timeout", "close_comm_on_error", "retries", "retry_on_empty"}
_HUB_NOTED = {
    "delay": "look at what the device wants after a connection",
    "message_wait_milliseconds": "give the bus gap_s, in s",
}
_ITEM_HARMLESS = {
    "unique_id",
    "scan_interval",
    "device_class",
    "state_class",
    "lazy_error_count",
    "icon",
    "entity_category",
    "precision",
    "friendly_name",
}
"""Keys by which Home Assistant shows, names and schedules an entity; no value and no address depends on them."""
_ITEM_NOTED = {"zero_suppress": "small values are kept as they are read"}
_MOST_VIRTUAL = 2000
"""Coils that one request may read (Modbus application protocol V1.1b3, 6.1): no device has more in one entry."""


def import_homeassistant(path: Path) -> Draft:
    """Return the draft of a Home Assistant configuration; raise ImportFileError with the line and the remedy."""
    return draft_of(path, load_placed(path, read_text(path)))


def draft_of(path: Path, document: Placed) -> Draft:
    """Return the draft of a configuration that has been read: the whole file, or the list below its `modbus:`."""
    hubs = document.get("modbus") or _of_packages(document) or document
    if hubs.tag:
        raise ImportFileError(path, hubs.line, f"modbus is {hubs.tag} {hubs.value}; give that file")
    if isinstance(hubs.value, dict):
        hubs = Placed([hubs], hubs.line)
    if not isinstance(hubs.value, list) or not any(hub.get("type") for hub in hubs.value):
        raise ImportFileError(path, hubs.line, "has no modbus: section with hubs; give the file that holds it")
    importing = _HomeAssistantImport(path)
    for hub in hubs.value:
        with importing.collector.item(hub.line, f"hub {hub.plain('name', '')}".strip()):
            importing.hub(_YamlTable(path, hub))
    for key in ("sensor", "binary_sensor", "switch", "climate", "cover"):
        importing.old_style(document.get(key), key)
    buses = importing.buses.with_points()
    if not buses:
        said = "has hubs without sensors or switches; there is nothing to import"
        raise importing.collector.nothing(hubs.line, said)
    return Draft(path, buses, importing.collector.notes)


def _of_packages(document: Placed) -> Placed | None:
    """Return the hubs of the packages of a configuration as one list, None where it has none."""
    core = document.get("homeassistant")
    packages = None if core is None or not isinstance(core.value, dict) else core.get("packages")
    if packages is None or packages.tag or not isinstance(packages.value, dict):
        return None
    found = [package.get("modbus") for package in packages.value.values() if isinstance(package.value, dict)]
    lists = [hubs for hubs in found if hubs is not None and isinstance(hubs.value, list)]
    return Placed([hub for hubs in lists for hub in hubs.value], lists[0].line) if lists else None


class _YamlTable:
    """Table of the YAML file that remembers its used keys."""

    def __init__(self, path: Path, placed: Placed) -> None:
        self.path = path
        self.placed = placed
        self.line = placed.line
        self.used: set[str] = set()
        if placed.tag or not isinstance(placed.value, dict):
            value = placed.value if isinstance(placed.value, str) else ""
            said = f"is {placed.tag} {value}".rstrip() if placed.tag else "is no table of keys"
            raise ImportFileError(path, placed.line, f"{said}; write its keys in its place")

    def get(self, key: str) -> Placed | None:
        """Return the entry of a key, tags and all."""
        self.used.add(key)
        return self.placed.get(key)

    def plain(self, key: str, default: Any = None) -> Any:
        """Return the value of a key, or `default`; raise ImportFileError of what only stands for a value."""
        found = self.get(key)
        if found is None or (found.value is None and not found.tag):
            return default
        if found.tag:
            value = found.value if isinstance(found.value, str) else ""
            raise ImportFileError(
                self.path, found.line, f"{key} is {found.tag} {value}; write what that stands for in its place"
            )
        placeholder = placeholder_in(found.value) if isinstance(found.value, str) else None
        if placeholder is not None:
            raise ImportFileError(self.path, found.line, f"{key} is {placeholder}; write what that stands for")
        return found.value

    def line_of(self, key: str) -> int:
        """Return the line of a key, or the table's."""
        found = self.placed.get(key)
        return self.line if found is None else found.line


class _HomeAssistantImport:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.collector = Collector(path)
        self.buses = Sections()

    def hub(self, hub: _YamlTable) -> None:
        """Take in the points of one hub; raise ImportFileError where none of them can be reached."""
        kind, method = hub.plain("type"), hub.plain("method", "rtu")
        if kind not in ("tcp", "rtuovertcp", "serial") or method != "rtu":
            spoken = kind if kind != "serial" else f"serial, method {method}"
            said = f"hub of type {spoken}: rig files know tcp, rtuovertcp and serial with method rtu; change the hub"
            raise ImportFileError(self.path, hub.line, said)
        self._bus_keys(hub, 1)  # a wrong host is one note, not one for every entry
        for section, default in _SECTIONS:
            for item in self._items(hub, section):
                name = item.plain("name")
                with self.collector.item(item.line, name if isinstance(name, str) else f"an entry of {section}"):
                    self._item(hub, _YamlTable(self.path, item), section, default)
        for section in _LEFT_OUT:
            for item in self._items(hub, section):
                said = f"{section[:-1]} {item.plain('name', '')} was left out: a rig has points only; declare its "
                self.collector.note(item.line, f"{said}registers as points, with limits where they are written")
        self._unused(hub, _HUB_HARMLESS, _HUB_NOTED, "the hub")

    def old_style(self, entries: Placed | None, key: str) -> None:
        """Note platforms of the style that Home Assistant had before `modbus:` held its sensors."""
        for item in entries.value if entries is not None and isinstance(entries.value, list) else ():
            if item.plain("platform") == "modbus":
                self.collector.note(
                    item.line, f"{key} of platform modbus is left out; write its entries as {key}s of a hub"
                )

    def _items(self, hub: _YamlTable, section: str) -> list[Placed]:
        found = hub.get(section)
        if found is None or (found.value is None and not found.tag):
            return []
        with self.collector.item(found.line, section):
            if found.tag:
                raise ImportFileError(
                    self.path, found.line, f"{section} are in {found.value}; put its entries here, or give that file"
                )
            if not isinstance(found.value, list):
                raise ImportFileError(self.path, found.line, f"{section} is no list; begin each entry with a dash")
            return found.value
        return []

    def _unused(self, entry: _YamlTable, harmless: set[str], noted: dict[str, str], who: str) -> None:
        for key, value in entry.placed.value.items():
            if key not in entry.used and key not in harmless:
                remedy = noted.get(key, "see if it changes a value")
                self.collector.note(value.line, f"key {key} of {who} was not used; {remedy}")

    def _item(self, hub: _YamlTable, item: _YamlTable, section: str, default: str) -> None:
        line, name = item.line, item.plain("name")
        if not isinstance(name, str) or not name:
            raise ImportFileError(self.path, line, f"an entry of {section} has no name; add one")
        table = self._table(item, "write_type" if section == "switches" else "input_type", default)
        keys: dict[str, Any] = {
            "table": table,
            "address": whole(self.path, item.line_of("address"), "address", item.plain("address"), 0, 65535),
            "unit": str(item.plain("unit_of_measurement", "")),
        }
        bus = self._bus(hub, item)
        more: dict[str, Any] | None = None
        if section == "switches":
            keys |= {"access": "rw", "kind": "status"}
            more = self._switch(item, keys)
            writes = item.plain("write_type", default)
            codes = (15, 16) if writes in ("holdings", "coils") else (5, 6)
            bus.written_with(item.line_of("write_type"), codes, self.collector)
        elif section == "binary_sensors":
            keys |= {"kind": "status"} | ({"bits": [0, 0]} if table in ("holding", "input") else {})
        elif table in ("coil", "discrete"):
            raise ImportFileError(self.path, line, f"a sensor is in registers, and this in a {table}; correct one")
        else:
            keys |= typed(self.path, self.collector, name, item.line, item.plain)
        count = self._count(item, section, table)
        step = keys.get("length") or WIDTH[keys.get("type", "uint16")]
        for number in range(count):
            one = keys | {"address": keys["address"] + number * step}
            called = f"{name} {number}" if number else name
            with self.collector.item(line, called):
                if one["address"] > 65535:
                    raise ImportFileError(self.path, line, "is beyond the last address, 65535; correct the count")
                bus.points.append(self.collector.point(bus.name, called, line, one))
        if more is not None:
            with self.collector.item(line, f"{name} state"):
                bus.points.append(self.collector.point(bus.name, f"{name} state", line, more))
        self._unused(item, _ITEM_HARMLESS, _ITEM_NOTED, name)

    def _table(self, item: _YamlTable, key: str, default: str) -> str:
        wanted = item.plain(key, default)
        table = _TABLES.get(wanted) if isinstance(wanted, str) else None
        if table is None:
            said = f"table {shown(wanted)} is not known; use {', '.join(_TABLES)}"
            raise ImportFileError(self.path, item.line_of(key), said)
        return table

    def _count(self, item: _YamlTable, section: str, table: str) -> int:
        """Return the number of entities of an entry: those that `virtual_count` adds follow the first."""
        given = [(key, item.plain(key)) for key in ("virtual_count", "slave_count")]
        counts = [whole(self.path, item.line_of(k), k, v, 0, _MOST_VIRTUAL) for k, v in given if v is not None]
        if len(set(counts)) > 1:
            raise ImportFileError(
                self.path, item.line_of("slave_count"), "virtual_count and slave_count differ; take one out"
            )
        more = counts[0] if counts else 0
        if more and section == "switches":
            raise ImportFileError(self.path, item.line, "a switch has no virtual_count; take it out")
        if more and section == "binary_sensors" and table in ("holding", "input"):
            said = "whose bits virtual_count counts in registers is not certain; write an entry for each"
            raise ImportFileError(self.path, item.line, said)
        return more + 1

    def _switch(self, item: _YamlTable, keys: dict[str, Any]) -> dict[str, Any] | None:
        """Add to `keys` what a switch is written with; return keys of the place that says whether it is on, if any."""
        on, off = (
            whole(self.path, item.line_of(key), key, item.plain(key, default), 0, 65535)
            for key, default in (("command_on", 1), ("command_off", 0))
        )
        if keys["table"] == "coil":
            self._require_upright(item.line_of("command_on"), "command_on", on, off)
        if keys["table"] == "holding":
            keys["doc"] = f"{on} switches on, {off} switches off"
        found = item.get("verify")
        if found is None or (found.value is None and not found.tag):
            return None
        verify = _YamlTable(self.path, found)
        address = whole(
            self.path,
            verify.line_of("address"),
            "address of verify",
            verify.plain("address", keys["address"]),
            0,
            65535,
        )
        default = next(key for key, table in _TABLES.items() if table == keys["table"])
        table = self._table(verify, "input_type", default)
        labels = {}
        for key, text, command in (("state_on", "on", on), ("state_off", "off", off)):
            for state in self._states(verify, key, command):
                if table in ("coil", "discrete"):
                    self._require_upright(verify.line_of(key), key, int(text == "on") == int(state != 0), False)
                labels[str(state)] = text
        self._unused(verify, {"delay"}, {}, "verify")
        if (table, address) == (keys["table"], keys["address"]):
            return None
        more: dict[str, Any] = {"table": table, "address": address, "kind": "status"}
        return more if table in ("coil", "discrete") else more | {"labels": labels}

    def _require_upright(self, line: int, key: str, on: float, off: float) -> None:
        """Raise ImportFileError for a bit that is 0 when on: a rig file has nothing for that."""
        if not on or off:
            raise ImportFileError(
                self.path,
                line,
                f"its {key} makes 0 of a bit mean on, or no difference; an inverted bit is not read here: take the "
                "switch out, and drive the bit by a point of its own",
            )

    def _states(self, verify: _YamlTable, key: str, default: int) -> list[int]:
        given = verify.get(key)
        if given is not None and isinstance(given.value, list) and not given.tag:
            items = [item.value for item in given.value]
        else:
            items = [verify.plain(key, default)]
        return [whole(self.path, verify.line_of(key), key, item, 0, 65535) for item in items]

    def _bus(self, hub: _YamlTable, item: _YamlTable) -> DraftBus:
        given = {key: item.plain(key) for key in ("slave", "device_address")}
        said = {key: value for key, value in given.items() if value is not None}
        devices = {key: whole(self.path, item.line_of(key), key, value, 0, 255) for key, value in said.items()}
        if len(set(devices.values())) > 1:
            raise ImportFileError(self.path, item.line, "slave and device_address differ; take one of them out")
        return self.buses.of(self.path, item.line, self._bus_keys(hub, next(iter(devices.values()), 1)))

    def _bus_keys(self, hub: _YamlTable, device: int) -> dict[str, Any]:
        kind = hub.plain("type")
        if kind == "serial":
            given = {ours: hub.plain(theirs) for ours, theirs in _SERIAL.items()}
            port = hub.plain("port")
            if not isinstance(port, str) or not port:
                raise ImportFileError(self.path, hub.line, "a serial hub has no port; add it, /dev/ttyUSB0 for example")
            return serial(self.path, hub.line, port, device, **given)
        host = hub.plain("host")
        if not isinstance(host, str) or not host:
            raise ImportFileError(self.path, hub.line_of("host"), "a hub has no host; add it")
        port_number = whole(self.path, hub.line_of("port"), "port", hub.plain("port", 502), 1, 65535)
        return tcp(self.path, hub.line_of("host"), host, port_number, device, rtu=kind == "rtuovertcp")
