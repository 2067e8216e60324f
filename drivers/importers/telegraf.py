"""Importer of Telegraf's `[[inputs.modbus]]`: all three styles of configuration (register, request, metric).

Facts from the plugin's documentation and source (influxdata/telegraf, plugins/inputs/modbus): addresses are zero-based
and a value is raw x scale. In the register style FIXED and UFIXED are integers of as many registers as there are
addresses, FLOAT32 is an old name of UFIXED, and IEEE numbers are FLOAT32-IEEE; in the other styles FLOAT32 is IEEE.
Only the style that `configuration_type` names is read, and a `slave_id` that is not given is 0.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from drivers.importers.draft import Collector, Draft, ImportFileError, number, placeholder_in, read_text, whole
from drivers.importers.sections import Sections, serial, tcp
from drivers.importers.telegraf_types import byte_order, field_type, register_type
from drivers.rig_file import line_of, parse_toml, shown

_STYLE_TABLES = {
    "coils": "coil",
    "discrete_inputs": "discrete",
    "holding_registers": "holding",
    "input_registers": "input",
}
_STYLES = {"register": tuple(_STYLE_TABLES), "request": ("request",), "metric": ("metric",)}
_REGISTERS = {"coil": "coil", "discrete": "discrete", "holding": "holding", "input": "input"}
_SERIAL = {"baud": "baud_rate", "parity": "parity", "stop_bits": "stop_bits", "data_bits": "data_bits"}

_SECTION = {
    "controller",
    "slave_id",
    "transmission_mode",
    "configuration_type",
    "workarounds",
    "request",
    "metric",
    *_STYLE_TABLES,
    *_SERIAL.values(),
}
_SECTION_HARMLESS = {
    "name",
    "alias",
    "log_level",
    "debug_connection",
    "exclude_register_type_tag",
    "timeout",
    "busy_retries",
    "busy_retries_wait",
    "interval",
    "precision",
    "collection_jitter",
    "collection_offset",
    "name_override",
    "name_prefix",
    "name_suffix",
    "tags",
    "startup_error_behavior",
    "optimization",
    "optimization_max_register_fill",
    "namepass",
    "namedrop",
    "fieldpass",
    "fielddrop",
    "fieldinclude",
    "fieldexclude",
    "tagpass",
    "tagdrop",
    "taginclude",
    "tagexclude",
    "metricpass",
}
"""Keys by which Telegraf names, schedules and filters its metrics; no value and no address depends on them."""
_WORKAROUNDS_HARMLESS = {"close_connection_after_gather", "read_coils_starting_at_zero", "string_register_location"}
_WORKAROUNDS_NOTED = {
    "pause_after_connect": "look at what the device wants after a connection",
    "pause_between_requests": "give the bus gap_s",
    "one_request_per_field": "give the bus max_gap = 0",
    "max_bit_registers_per_request": "give the bus max_read_bits",
    "max_word_registers_per_request": "give the bus max_read",
}
_GROUP = {"slave_id", "byte_order", "register", "fields"}
_GROUP_HARMLESS = {"measurement", "tags", "optimization", "optimization_max_register_fill"}
_FIELD = {"name", "address", "byte_order", "data_type", "type", "scale", "bit", "length", "omit", "register"}
_FIELD_HARMLESS = {"measurement", "output"}
"""`output` is the type in Telegraf's database: the decimals that INT64 would cut are kept here."""
_OTHER_TABLES_NOTED = ("processors", "aggregators")
"""Other plugins may change a value after it was read: `[[processors.scale]]`, for example."""

Place = tuple[str | int, ...]


def import_telegraf(path: Path) -> Draft:
    """Return the draft of a Telegraf configuration; raise ImportFileError with the line and the remedy."""
    text = read_text(path)
    try:
        document = parse_toml(text)
    except tomllib.TOMLDecodeError as error:
        where = next((line for line in text.splitlines() if placeholder_in(line.split("#")[0])), None)
        hint = "" if where is None else f"; write the value of {placeholder_in(where)} in its place"
        raise ImportFileError(path, None, f"is not valid TOML: {error}{hint}") from None
    except ValueError as error:
        raise ImportFileError(path, None, f"is not valid TOML: {error}") from None
    inputs = document.get("inputs")
    sections = inputs.get("modbus") if isinstance(inputs, dict) else None
    if not isinstance(sections, list) or not sections or not all(isinstance(item, dict) for item in sections):
        if "rig" in document or "point" in document:
            raise ImportFileError(path, None, "is a rig file already; hil check shows what it holds")
        if inputs:
            others = ", ".join(f"inputs.{name}" for name in inputs) if isinstance(inputs, dict) else "inputs"
            raise ImportFileError(path, None, f"has {others} and no [[inputs.modbus]]; only Modbus is imported")
        raise ImportFileError(path, None, "has no [[inputs.modbus]]; is this a Telegraf configuration?")
    importing = _TelegrafImport(path, text)
    importing.other_tables(document)
    return importing.draft(sections)


class _TelegrafImport:
    def __init__(self, path: Path, text: str) -> None:
        self.path = path
        self.text = text
        self.collector = Collector(path)
        self.buses = Sections()

    def other_tables(self, document: Mapping[str, Any]) -> None:
        """Note plugins that may change values after they are read."""
        for kind in _OTHER_TABLES_NOTED:
            plugins = document.get(kind)
            for name in plugins if isinstance(plugins, dict) else ():
                self.collector.note(
                    self._line((kind, name)), f"{kind}.{name} is not taken over; see if it changes a value of these"
                )

    def draft(self, sections: list[dict[str, Any]]) -> Draft:
        """Return the draft of all `[[inputs.modbus]]`."""
        for index, section in enumerate(sections):
            place = ("inputs", "modbus", index)
            with self.collector.item(self._line(place), "[[inputs.modbus]]"):
                self._section(section, place)
        buses = self.buses.with_points()
        if not buses:
            raise self.collector.nothing(None, "has [[inputs.modbus]] without a field; there is nothing to import")
        return Draft(self.path, buses, self.collector.notes)

    def _line(self, place: Place) -> int:
        return line_of(self.text, place)

    def _error(self, place: Place, what: str) -> ImportFileError:
        return ImportFileError(self.path, self._line(place), what)

    def _section(self, section: dict[str, Any], place: Place) -> None:
        controller = self._text(section, "controller", place)
        if not controller:
            raise self._error((*place, "controller"), "[[inputs.modbus]] has no controller = 'tcp://host:port'; add it")
        self._unused(section, place, _SECTION | _SECTION_HARMLESS)
        workarounds = section.get("workarounds", {})
        for key in workarounds if isinstance(workarounds, dict) else ():
            if key not in _WORKAROUNDS_HARMLESS:
                remedy = _WORKAROUNDS_NOTED.get(key, "see if it changes a value")
                self.collector.note(
                    self._line((*place, "workarounds", key)), f"workaround {key} is not taken over; {remedy}"
                )
        self._bus(section, section.get("slave_id", 1), place, place)  # a wrong controller is one note, not one a field
        style = self._style(section, place)
        if style == "register":
            for key, table in _STYLE_TABLES.items():
                for item, at in self._list(section, key, place):
                    with self.collector.item(self._line((*at, "name")), _called(item)):
                        self._field(section, section, place, item, at, table, is_register_style=True)
            return
        for group, at in self._list(section, style, place):
            with self.collector.item(self._line(at), f"[[inputs.modbus.{style}]]"):
                self._group(section, group, at, style)

    def _style(self, section: dict[str, Any], place: Place) -> str:
        """Return the style of a section, and note what Telegraf does not read in it."""
        given = self._text(section, "configuration_type", place)
        there = [style for style, keys in _STYLES.items() if any(section.get(key) for key in keys)]
        style = given or "register"
        if style not in _STYLES:
            raise self._error(
                (*place, "configuration_type"), f"configuration_type {style!r} is not known; use {', '.join(_STYLES)}"
            )
        if not given and len(there) == 1 and there[0] != style:
            style = there[0]
            self.collector.note(
                self._line((*place, style)),
                f"configuration_type = '{style}' is missing, without which Telegraf does not read this; taken as that",
            )
        for other in there:
            if other != style:
                key = next(key for key in _STYLES[other] if section.get(key))
                self.collector.note(
                    self._line((*place, key)), f"{key} is left out: Telegraf does not read it in the {style} style"
                )
        return style

    def _group(self, section: dict[str, Any], group: dict[str, Any], place: Place, style: str) -> None:
        self._unused(group, place, _GROUP | _GROUP_HARMLESS)
        for item, at in self._list(group, "fields", place):
            with self.collector.item(self._line((*at, "name")), _called(item)):
                owner, of = (group, place) if style == "request" else (item, at)
                self._field(section, group, place, item, at, self._table(owner, of))

    def _list(self, section: dict[str, Any], key: str, place: Place) -> list[tuple[dict[str, Any], Place]]:
        items = section.get(key, [])
        if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
            raise self._error((*place, key), f"{key} is no list of tables; correct it")
        return [(item, (*place, key, index)) for index, item in enumerate(items)]

    def _text(self, table: Mapping[str, Any], key: str, place: Place) -> str:
        """Return a text, empty where there is none; raise ImportFileError of what is none, and of placeholders."""
        value = table.get(key, "")
        if not isinstance(value, str):
            raise self._error((*place, key), f"{key} {shown(value)} is no text; put it in quotes")
        placeholder = placeholder_in(value)
        if placeholder is not None:
            raise self._error((*place, key), f"{key} is {placeholder}; write what that stands for")
        return value

    def _table(self, table: Mapping[str, Any], place: Place) -> str:
        register = self._text(table, "register", place) or "holding"
        if register not in _REGISTERS:
            raise self._error((*place, "register"), f"register {register!r} is not known; use {', '.join(_REGISTERS)}")
        return _REGISTERS[register]

    def _unused(self, table: Mapping[str, Any], place: Place, known: set[str]) -> None:
        for key in table:
            if key not in known:
                self.collector.note(self._line((*place, key)), f"key {key} was not used; see if it changes a value")

    def _field(
        self,
        section: dict[str, Any],
        group: dict[str, Any],
        group_place: Place,
        item: dict[str, Any],
        place: Place,
        table: str,
        *,
        is_register_style: bool = False,
    ) -> None:
        if item.get("omit") is True:
            return
        self._unused(item, place, _FIELD | _FIELD_HARMLESS)
        name, line = self._text(item, "name", place), self._line((*place, "name"))
        if not name:
            raise ImportFileError(self.path, line, f"a field of {table} has no name; add one")
        numbers = self._addresses(item, place, line)
        keys: dict[str, Any] = {"table": table, "address": numbers[0]}
        if table in ("holding", "input"):
            keys |= self._typed(section, group, group_place, item, place, numbers if is_register_style else None)
        elif len(numbers) > 1:
            raise ImportFileError(self.path, line, f"a {table} has one address and this has {len(numbers)}; correct it")
        if keys.get("type") == "string" or table in ("coil", "discrete"):
            keys["kind"] = "status"
        reached = self._bus(section, self._device(group, group_place), group_place, place)
        bus = self.buses.of(self.path, line, reached)
        bus.points.append(self.collector.point(bus.name, name, line, keys))

    def _addresses(self, item: dict[str, Any], place: Place, line: int) -> list[int]:
        given = item.get("address")
        addresses = given if isinstance(given, list) else [given]
        numbers = [whole(self.path, line, "address", address, 0, 65535) for address in addresses]
        if not numbers:
            raise self._error((*place, "address"), "has no address; add one")
        if numbers != list(range(numbers[0], numbers[0] + len(numbers))):
            raise ImportFileError(self.path, line, f"addresses {numbers} do not follow one another; correct them")
        return numbers

    def _typed(
        self,
        section: dict[str, Any],
        group: dict[str, Any],
        group_place: Place,
        item: dict[str, Any],
        place: Place,
        numbers: list[int] | None,
    ) -> dict[str, Any]:
        """Return type, order, bits, length and scale of a field; `numbers` are its addresses in the register style."""
        line = self._line((*place, "name"))
        if numbers is not None:
            given = self._text(item, "data_type", place)
            keys, remark = register_type(given, len(numbers))
            owner, at = item, place
        else:
            given = self._text(item, "type", place)
            keys, remark = field_type(given)
            owner, at = group, group_place
        if not keys:
            raise ImportFileError(self.path, line, remark)
        if remark:
            self.collector.note(line, f"{item['name']}: {remark}")
        if "bits" in keys and keys.get("kind") == "status":
            bit = whole(self.path, line, "bit", item.get("bit", 0), 0, 15)
            keys["bits"] = [bit, bit]
        is_string = keys["type"] == "string"
        if is_string:
            location = section.get("workarounds")
            location = location.get("string_register_location") if isinstance(location, dict) else None
            if location not in (None, "", "both"):
                raise ImportFileError(
                    self.path, line, f"a text in the {location} bytes of its registers cannot be read; leave it out"
                )
            count = len(numbers) if numbers else item.get("length", 0)
            keys["length"] = whole(self.path, line, "length", count, 1, 125)
        order, wrong = byte_order(self._text(owner, "byte_order", at), keys["type"], numbers)
        if order is None:
            raise ImportFileError(self.path, self._line((*at, "byte_order")), wrong)
        if order != "ABCD":
            keys["order"] = order
        return keys | self._scaled(item, line, is_string, numbers is not None)

    def _scaled(self, item: dict[str, Any], line: int, is_string: bool, is_register_style: bool) -> dict[str, float]:
        if "scale" not in item or is_string:
            return {}
        scale = number(self.path, line, "scale", item["scale"])
        if scale == 0.0 and is_register_style:
            raise ImportFileError(self.path, line, "scale 0 loses the value; give the value of one count")
        return {"scale": scale} if scale not in (0.0, 1.0) else {}  # in the other styles 0 is "not given"

    def _device(self, group: Mapping[str, Any], place: Place) -> Any:
        if "slave_id" not in group:
            line = self._line(place)
            said = f"line {line}: slave_id is not given, which Telegraf takes as 0; add the device's"
            if said not in self.collector.notes:
                self.collector.notes.append(said)
            return 0
        return group["slave_id"]

    def _bus(self, section: dict[str, Any], device_id: Any, place: Place, item: Place) -> dict[str, Any]:
        """Return the keys of the bus of a device; raise ImportFileError."""
        controller, mode = section["controller"], self._text(section, "transmission_mode", place)
        line = self._line((*item[:3], "controller"))
        device = whole(self.path, self._line((*place, "slave_id")), "slave_id", device_id, 0, 255)
        if mode in ("ASCII", "ASCIIoverTCP"):
            raise self._error((*item[:3], "transmission_mode"), f"{mode!r} is not spoken here; set the device to RTU")
        if controller.startswith("file://"):
            given = {ours: section.get(theirs) for ours, theirs in _SERIAL.items()}
            return serial(self.path, line, controller.removeprefix("file://"), device, **given)
        try:
            url = urlsplit(controller)
            host, port = url.hostname, url.port or 502
        except ValueError:
            url, host, port = urlsplit(""), None, 0
        if url.scheme != "tcp" or not host:
            said = f"controller {controller!r} is neither tcp://host:port nor file:///dev/PORT; correct it"
            raise ImportFileError(self.path, line, said)
        return tcp(self.path, line, host, port, device, rtu=mode == "RTUoverTCP")


def _called(item: Mapping[str, Any]) -> str:
    name = item.get("name")
    return name if isinstance(name, str) and name else "a field"
