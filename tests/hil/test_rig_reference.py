"""The page of the rig file names the keys that the reader takes, with the defaults and bounds that it has."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import annotated_types
import pytest
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from drivers.rig_file import bus_sections, interlock_specs
from drivers.rig_file.bus_sections import CanBus, CanMessage, Hole
from drivers.rig_file.model import Heartbeat, Point, Rig
from drivers.rig_file.reader import RigFileError, load_rig
from drivers.signals.roles import ROLES
from drivers.signals.units import SUFFIX_OF_UNIT
from hil.rig.check import as_json
from tests.hil.reference_pages import page

PAGE = page("rig-file")
MODBUS, TCP = "Every Modbus bus", "modbus_tcp"
POINT = ("Every point", "Where it is on Modbus", "Where it is on CAN", "Readings of a point", "Writes to a point")
SECTIONS: dict[type[BaseModel], tuple[str, ...]] = {
    Rig: ("[rig]",),
    Heartbeat: ("[heartbeat]",),
    Point: POINT,
    Hole: ("hole",),
    CanBus: ("CAN",),
    CanMessage: ("message",),
    interlock_specs.AlarmSpec: ("[[alarm]]",),
    bus_sections.ModbusTcpBus: (MODBUS, TCP),
    bus_sections.ModbusTlsBus: (MODBUS, TCP, "modbus_tls"),
    bus_sections.ModbusRtuTcpBus: (MODBUS, "modbus_rtu_tcp"),
    bus_sections.ModbusRtuBus: (MODBUS, "modbus_rtu"),
    **{
        spec: ("Every interlock", get_args(spec.model_fields["kind"].annotation)[0])
        for spec in get_args(get_args(interlock_specs.InterlockSpec)[0])
    },
}
SECTIONS_OF_RIG = {
    "heartbeat": "[heartbeat]",
    "bus": "[bus.NAME]",
    "point": "[[point]]",
    "interlock": "[[interlock]]",
    "alarm": "[[alarm]]",
}
WORDS = {
    int: "whole number",
    float: "number",
    str: "text",
    bool: "true or false",
    Path: "path",
    tuple: ("pair", "list"),
    dict: "table",
}


def fields(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Keys of a section of the file: those of the rig that are sections of their own have headings of their own."""
    refused = {"transaction", "frame_length"} if model is bus_sections.ModbusRtuTcpBus else set()
    others = set(SECTIONS_OF_RIG) if model is Rig else set()
    return {key: field for key, field in model.model_fields.items() if key not in refused | others}


@pytest.mark.parametrize("model", SECTIONS)
def test_every_key_is_named_and_no_other(model):
    assert set(PAGE.keys(*SECTIONS[model])) == set(fields(model))


def test_every_section_is_there():
    assert set(SECTIONS_OF_RIG) <= set(Rig.model_fields) and set(SECTIONS_OF_RIG.values()) <= set(PAGE.rows)
    buses = [model for model in SECTIONS if "transport" in model.model_fields]
    assert {name for bus in buses for name in get_args(bus.model_fields["transport"].annotation)} == set(
        bus_sections.TRANSPORTS
    )
    named = {section for sections in SECTIONS.values() for section in sections}
    assert {section for section, rows in PAGE.rows.items() if rows} == named | {"Roles", "Units"}


@pytest.mark.parametrize("model", SECTIONS)
def test_defaults_types_and_what_is_allowed_are_the_readers(model):
    rows = PAGE.keys(*SECTIONS[model])
    for key, field in fields(model).items():
        row, where = rows[key], f"{model.__name__}.{key}"
        assert row["Default"] == default_of(field), where
        assert any(row["Type, unit"].startswith(word) for word in words_of(field.annotation)), where
        allowed, (values, bounds) = row["Allowed"], facts(field.annotation, field.metadata)
        named = set(re.findall(r"`([^`]+)`", allowed))
        if key in ("transport", "kind") and model is not Point:  # each model has its own; the page has them together
            assert set(values) <= named, where
        elif values:
            assert set(values) == named, where
        numbers = {int(text, 16) if "x" in text else float(text) for text in re.findall(r"0x\w+|[\d.]*\d", allowed)}
        assert bounds <= numbers, where


def default_of(field: FieldInfo) -> str:
    value = field.default
    if value is PydanticUndefined:
        return "must be given"
    if value is None:
        return "none"
    if isinstance(value, str):
        return f'`"{value}"`'
    if isinstance(value, bool):
        return f"`{value}`".lower()
    return "`[]`" if value == () else f"`{value:g}`"


def words_of(annotation: Any) -> set[str]:
    """How the page may begin to say what a value is."""
    origin = get_origin(annotation)
    if annotation in WORDS or origin in (tuple, dict):
        word = WORDS[annotation if annotation in WORDS else origin]
        return {word} if isinstance(word, str) else set(word)
    if origin is Literal:
        return {WORDS[type(value)] for value in get_args(annotation)}
    return {word for part in get_args(annotation) for word in words_of(part)}


def facts(annotation: Any, metadata: list[Any]) -> tuple[list[str], set[float]]:
    """Words that the reader takes and no others, and bounds of numbers."""
    values: list[str] = []
    bounds: set[float] = set()
    for item in metadata:
        for name in ("ge", "gt", "le", "lt"):
            if isinstance(item, getattr(annotated_types, name.title())):
                bounds.add(getattr(item, name))
        if isinstance(item, FieldInfo):
            bounds |= facts(None, item.metadata)[1]
    if annotation is bool:
        values += ["true", "false"]
    elif get_origin(annotation) is Literal:
        values += map(str, get_args(annotation))
    else:
        for part in get_args(annotation):
            more, further = facts(part, list(getattr(part, "__metadata__", ())))
            values, bounds = values + more, bounds | further
    return values, bounds


def test_roles_and_units_are_all_there_and_no_others():
    roles = [name for row in PAGE.rows["Roles"] for name in re.findall(r"`(\w+)`", row["Role"])]
    assert sorted(roles) == sorted(ROLES)
    text = (Path(__file__).resolve().parents[2] / "docs" / "reference" / "rig-file.md").read_text(encoding="utf-8")
    units = text.partition("## Units")[2].partition(" (no unit)")[0]
    assert sorted(re.findall(r"`([^`]+)`", units)) == sorted(SUFFIX_OF_UNIT)


def test_the_example_is_read_without_a_remark(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(PAGE.code["toml"][0], encoding="utf-8")
    assert load_rig(path).setpoints[0].name == "heater_power_set"
    assert json.loads(as_json(path))["notes"] == []


@pytest.mark.parametrize("model", [Rig, Heartbeat, Point])
def test_a_key_that_is_not_on_the_page_is_refused(tmp_path, model):
    text = PAGE.code["toml"][0]
    header = {Rig: "[rig]", Heartbeat: "[heartbeat]", Point: "[[point]]"}[model]
    path = tmp_path / "rig.toml"
    path.write_text(text.replace(header, f"{header}\nsaefty = 1", 1), encoding="utf-8")
    with pytest.raises(RigFileError, match=r"saefty.* is not a key of this section"):
        load_rig(path)
