"""Rig that points to served devices, in memory and as a file."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, TypeAdapter

from drivers.rig_file import AnyBus, Rig, read_regular, tables_of
from hil.files import replacing

HEADER = "# Served copy of a rig file, written by `hil rig`: it points to simulated devices."
_GONE = ("ca", "certificate", "key", "bitrate")
"""Keys of a bus that a served one has not: there is neither TLS nor an adapter."""
_FILES = ("dbc",)
_BUS: TypeAdapter[AnyBus] = TypeAdapter(Annotated[AnyBus, Field(discriminator="transport")])
Sections = Mapping[str, Mapping[str, Any]]


def moved_rig(rig: Rig, sections: Sections) -> Rig:
    """Return the same rig with its buses at the served addresses.

    Parameters
    ----------
    rig
        The rig of the file.
    sections
        Keys of each bus that differ, by its name.
    """
    buses = {
        name: _BUS.validate_python(_moved(bus.model_dump(exclude_unset=True), sections[name]))
        for name, bus in rig.bus.items()
    }
    return rig.model_copy(update={"bus": buses})


def _moved(section: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in section.items() if key not in _GONE} | dict(changes)


def is_served_copy(path: Path) -> bool:
    """Return True for a file that `write_served_file` wrote; raise OSError."""
    return read_regular(path).startswith(HEADER.encode("ascii"))


def write_served_file(source: Path, sections: Sections, out: Path, time_scale: float = 1.0) -> None:
    """Write the rig file `source` with its buses at the served addresses to `out`.

    Parameters
    ----------
    source
        Rig file.
    sections
        Keys of each bus that differ, by its name.
    out
        File to write; paths in it are as seen from its folder.
    time_scale
        Factor of the served rig's clock to real time.

    Raises
    ------
    OSError
        A file cannot be read or written.
    """
    _, document = tables_of(read_regular(source))
    top = document.setdefault("rig", {})
    for key in [key for key, value in document.items() if not isinstance(value, dict | list)]:
        top[key] = document.pop(key)
    top["name"] = f"{top.get('name', source.stem)} (served)"
    top["description"] = f"Simulated devices of {source.name}, no hardware"
    if time_scale != 1.0:
        top["time_scale"] = time_scale
    if isinstance(top.get("twin"), str):
        top["twin"] = _from(out, source.parent / top["twin"])
    for name, section in document["bus"].items():
        for key in _FILES:
            if isinstance(section.get(key), str):
                section[key] = _from(out, source.parent / section[key])
        document["bus"][name] = _moved(section, sections[name])
    text = f"{HEADER}\n# Source: {source.name}\n\n" + "\n".join(_table((), document)).lstrip("\n") + "\n"
    with replacing(out) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


def _from(out: Path, target: Path) -> str:
    """Return the path of `target` as seen from the folder of `out`."""
    return os.path.relpath(target, out.parent)


def _table(place: tuple[str, ...], table: Mapping[str, Any]) -> list[str]:
    """Return the lines of a TOML table: its own keys, then the tables and lists of tables in it."""
    lines: list[str] = []
    for key, value in table.items():
        if not _has_tables(value) and not (len(place) < 2 and isinstance(value, dict)):
            lines.append(f"{_key(key)} = {_value(value)}")
    for key, value in table.items():
        inner = (*place, key)
        heading = ".".join(map(_key, inner))
        if _has_tables(value):
            for item in value:
                lines += ["", f"[[{heading}]]", *_inline(item)]
        elif len(place) < 2 and isinstance(value, dict):
            own = any(not isinstance(item, dict) for item in value.values())
            lines += ["", f"[{heading}]"] if own else []
            lines += _table(inner, value)
    return lines


def _has_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(item, dict) for item in value)


def _inline(table: Mapping[str, Any]) -> list[str]:
    return [f"{_key(key)} = {_value(value)}" for key, value in table.items()]


def _key(key: str) -> str:
    bare = key.isascii() and key.replace("-", "_").isidentifier()
    return key if bare or (key.isascii() and key.isdigit()) else _text(key)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "{ " + ", ".join(_inline(value)) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_value, value)) + "]"
    return _text(value) if isinstance(value, str) else repr(value)


def _text(text: str) -> str:
    # JSON's strings are TOML's, but for the one control character that JSON leaves as it is.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
