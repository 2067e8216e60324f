"""Telegraf's `[[inputs.modbus]]`: all three styles of its configuration (register, request, metric).

Facts from the plugin's README: addresses are zero-based, `byte_order` is one of ABCD, CDAB, BADC, DCBA (doubled for
64 bits), a value is raw x scale.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from drivers.imports.draft import Collector, Draft, DraftBus, ImportFileError, number, read_text, whole
from drivers.imports.sections import Sections, serial, tcp

_STYLE_TABLES = {
    "coils": "coil",
    "discrete_inputs": "discrete",
    "holding_registers": "holding",
    "input_registers": "input",
}
_REGISTERS = {"coil": "coil", "discrete": "discrete", "holding": "holding", "input": "input"}
_TYPES = {
    kind.upper(): kind
    for kind in ("int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64", "string")
} | {"FLOAT32-IEEE": "float32", "FLOAT64-IEEE": "float64", "BOOL": "bool"}
_ORDERS = {
    "": "ABCD",
    "AB": "ABCD",
    "BA": "BADC",
    "ABCD": "ABCD",
    "CDAB": "CDAB",
    "BADC": "BADC",
    "DCBA": "DCBA",
    "ABCDEFGH": "ABCD",
    "GHEFCDAB": "CDAB",
    "BADCFEHG": "BADC",
    "HGFEDCBA": "DCBA",
}
_SERIAL = {"baud": "baud_rate", "parity": "parity", "stop_bits": "stop_bits", "data_bits": "data_bits"}


def import_telegraf(path: Path) -> Draft:
    """The draft of a Telegraf configuration; raises ImportFileError with the line and what to do."""
    text = read_text(path)
    try:
        document = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ImportFileError(path, None, f"is not valid TOML: {error}") from None
    inputs = document.get("inputs")
    sections = inputs.get("modbus") if isinstance(inputs, dict) else None
    if not isinstance(sections, list) or not sections or not all(isinstance(item, dict) for item in sections):
        raise ImportFileError(path, None, "has no [[inputs.modbus]]; is this a Telegraf configuration?")
    return _Import(path, text).draft(sections)


class _Import:
    def __init__(self, path: Path, text: str) -> None:
        self.path = path
        self.lines = text.splitlines()
        self.collector = Collector(path)
        self.buses = Sections()
        self._controller_line = 1
        self._seen: dict[str, int] = {}

    def draft(self, sections: list[dict[str, Any]]) -> Draft:
        for section in sections:
            self._section(section)
        buses = self.buses.with_points()
        if not buses:
            raise ImportFileError(self.path, None, "has [[inputs.modbus]] without a field; there is nothing to import")
        return Draft(self.path, buses, self.collector.notes)

    def _line(self, key: str, value: Any) -> int:
        """Line of the next `key = value`, counted from 1: tomllib keeps no lines. 1 where it is not found."""
        wanted = re.compile(rf"\b{re.escape(key)}\s*=\s*[\"']?{re.escape(str(value))}(?![\w.])")
        start = self._seen.get(f"{key}={value}", 0)
        for index in range(start, len(self.lines)):
            if wanted.search(self.lines[index].split("#")[0] if key != "name" else self.lines[index]):
                self._seen[f"{key}={value}"] = index + 1
                return index + 1
        return start or 1

    def _section(self, section: dict[str, Any]) -> None:
        controller = section.get("controller")
        line = self._line("controller", controller) if controller is not None else 1
        if not isinstance(controller, str):
            raise ImportFileError(self.path, line, "[[inputs.modbus]] has no controller = 'tcp://host:port'; add it")
        self._controller_line = line
        for style, table in _STYLE_TABLES.items():
            for item in self._list(section, style):
                self._field(controller, section, item, table, item.get("byte_order", ""), register_style=True)
        for request in self._list(section, "request"):
            table = self._table(request.get("register", "holding"))
            for item in self._list(request, "fields"):
                self._field(controller, section | request, item, table, request.get("byte_order", "ABCD"))
        for metric in self._list(section, "metric"):
            for item in self._list(metric, "fields"):
                table = self._table(item.get("register", "holding"))
                self._field(controller, section | metric, item, table, metric.get("byte_order", "ABCD"))

    def _list(self, section: dict[str, Any], key: str) -> list[dict[str, Any]]:
        items = section.get(key, [])
        if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
            raise ImportFileError(self.path, self._line(key, ""), f"{key} is no list of tables; correct it")
        return items

    def _table(self, register: Any) -> str:
        table = _REGISTERS.get(register) if isinstance(register, str) else None
        if table is None:
            line = self._line("register", register)
            raise ImportFileError(self.path, line, f"register {register!r} is not known; use {', '.join(_REGISTERS)}")
        return table

    def _field(
        self,
        controller: str,
        section: dict[str, Any],
        item: dict[str, Any],
        table: str,
        byte_order: Any,
        *,
        register_style: bool = False,
    ) -> None:
        if item.get("omit") is True:
            return
        name = item.get("name")
        line = self._line("name", name)
        if not isinstance(name, str) or not name:
            raise ImportFileError(self.path, line, f"a field of {table} has no name; add one")
        bus = self._bus(controller, section, line)
        addresses = item.get("address")
        if not isinstance(addresses, list):
            addresses = [addresses]
        numbers = [whole(self.path, line, f"address of {name}", a, 0, 65535) for a in addresses]
        if not numbers:
            raise ImportFileError(self.path, line, f"{name} has no address; add one")
        if numbers != list(range(numbers[0], numbers[0] + len(numbers))):
            raise ImportFileError(
                self.path, line, f"addresses {numbers} of {name} do not follow one another; correct them"
            )
        keys: dict[str, Any] = {"table": table, "address": numbers[0]}
        if table in ("holding", "input"):
            keys |= self._typed(name, line, item, byte_order, numbers if register_style else None)
        if keys.get("type") == "string" or table in ("coil", "discrete"):
            keys["kind"] = "status"
        bus.points.append(self.collector.point(bus.name, name, line, keys))

    def _typed(
        self, name: str, line: int, item: dict[str, Any], byte_order: Any, numbers: list[int] | None
    ) -> dict[str, Any]:
        given = item.get("data_type") if numbers is not None else item.get("type")
        if given == "BIT" or (numbers is None and given == "bit"):
            bit = whole(self.path, line, f"bit of {name}", item.get("bit", 0), 0, 15)
            return {"type": "uint16", "bits": [bit, bit], "kind": "status"}
        kind = _TYPES.get(given) if isinstance(given, str) else None
        if kind is None:
            raise ImportFileError(
                self.path, line, f"type {given!r} of {name} has no counterpart here; use one of {', '.join(_TYPES)}"
            )
        order = _ORDERS.get(byte_order) if isinstance(byte_order, str) else None
        if order is None:
            raise ImportFileError(
                self.path, line, f"byte_order {byte_order!r} of {name} is not known; use ABCD or CDAB"
            )
        keys: dict[str, Any] = {"type": kind}
        if kind == "string":
            keys["length"] = (
                len(numbers) if numbers else whole(self.path, line, "length", item.get("length", 0), 1, 125)
            )
            if order in ("CDAB", "DCBA"):
                order = "ABCD" if order == "CDAB" else "BADC"
        width = {"32": 2, "64": 4}.get(kind[-2:], 1)
        if numbers is not None and kind != "string" and len(numbers) != width:
            raise ImportFileError(
                self.path, line, f"{name} is {kind}, which takes {width} addresses, and has {len(numbers)}; correct one"
            )
        if order != "ABCD":
            keys["order"] = order
        scale = number(self.path, line, f"scale of {name}", item.get("scale") or 1.0)
        if scale != 1.0 and kind != "string":
            keys["scale"] = scale
        return keys

    def _bus(self, controller: str, section: dict[str, Any], line: int) -> DraftBus:
        device = whole(self.path, line, "slave_id", section.get("slave_id", 1), 0, 255)
        mode, at = section.get("transmission_mode"), self._controller_line
        if mode in ("ASCII", "ASCIIoverTCP"):
            raise ImportFileError(
                self.path, at, f"transmission_mode {mode!r} is not spoken here; set the device to RTU"
            )
        if controller.startswith("file://"):
            given = {ours: section.get(theirs) for ours, theirs in _SERIAL.items()}
            port = controller.removeprefix("file://")
            return self.buses.of(serial(self.path, at, port, device, **given))
        try:
            url = urlsplit(controller)
            host, port_number = url.hostname, url.port or 502
        except ValueError:
            url, host, port_number = urlsplit(""), None, 0
        if url.scheme != "tcp" or not host:
            said = f"controller {controller!r} is neither tcp://host:port nor file:///dev/PORT; correct it"
            raise ImportFileError(self.path, at, said)
        return self.buses.of(tcp(host, port_number, device, rtu=mode == "RTUoverTCP"))
