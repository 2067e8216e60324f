"""Twin files: TOML text to a validated `Network` and back; every error is one plain sentence."""

from __future__ import annotations

import errno
import math
import os
import re
import time
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from twin.network import Network, TwinFileError, digest
from twin.regular_file import read_regular
from twin.twinfile.bounded_toml import parse_toml
from twin.twinfile.reader import FORMAT, TwinReader


def load(path: str | Path) -> Network:
    """Read a twin file.

    Parameters
    ----------
    path
        Path of a TOML file in the format of docs/reference/twin-file.md.

    Raises
    ------
    TwinFileError
        The file is absent, is not TOML, or describes an impossible network; the message names file, line and remedy.
    """
    return parse(read_text(path), str(path))


def read_text(path: str | Path) -> str:
    """Return the text of a twin file, of which `Network.digest` is the SHA-256.

    Raises
    ------
    TwinFileError
        The file is absent or is not UTF-8.
    """
    try:
        return read_regular(Path(path)).decode("utf-8")
    except OSError as error:
        raise TwinFileError(f"{path}: cannot be read ({error.strerror}); give the path of a twin file") from None
    except UnicodeDecodeError:
        raise TwinFileError(f"{path}: is not UTF-8 text; save the twin file as UTF-8") from None


def parse(text: str, file: str = "twin file") -> Network:
    """Parse the text of a twin file; `file` names it in messages.

    Raises
    ------
    TwinFileError
        As for `load`.
    """
    try:
        data = parse_toml(text)
    except ValueError as error:
        raise TwinFileError(f"{file}: is not valid TOML: {error}") from None
    return TwinReader(text, file).network(data)


def to_tables(network: Network) -> dict[str, Any]:
    """Return a network as the tables of its twin file; the caller may change them and pass them to `from_tables`."""
    return tomllib.loads(dump(network))


def from_tables(data: dict[str, Any], name: str) -> Network:
    """Build a network from tables as `to_tables` returns them; `name` stands in messages. Its digest is "".

    Raises
    ------
    TwinFileError
        As for `parse`: every check of a file that is read holds here too.
    """
    return replace(TwinReader("", name).network(data), digest="")


def save(network: Network, path: str | Path) -> Path:
    """Write a network as a new twin file with its checksum; an existing file is never overwritten.

    Parameters
    ----------
    network
        The network.
    path
        Path of the new file.

    Returns
    -------
    Path
        The new file.

    Raises
    ------
    TwinFileError
        The path exists or cannot be written.
    """
    path = Path(path)
    text = dump(network)
    text += f"checksum = {_toml(digest(text))}\n"
    try:
        _write_new(path, text)
    except FileExistsError:
        raise TwinFileError(f"{path}: exists already; a twin is never overwritten, give a new name") from None
    except OSError as error:
        raise TwinFileError(f"{path}: cannot be written ({error.strerror})") from None
    return path


def _write_new(path: Path, text: str) -> None:
    """Write a file that does not exist yet, whole or not at all; raises FileExistsError, or another OSError.

    The text is written beside it first: a full disk or a killed process leaves no twin that is cut, and so none that
    the next attempt may not overwrite.
    """
    unfinished = path.with_name(f".{os.getpid()}-{time.time_ns()}.part")
    try:
        with unfinished.open("x", encoding="utf-8") as handle:
            handle.write(text)
            handle.flush()
            os.fsync(handle.fileno())
        try:
            os.link(unfinished, path)
        except OSError as error:
            if os.path.lexists(path):
                raise FileExistsError from error
            if error.errno not in _NO_LINKS:
                raise
            unfinished.rename(path)
    finally:
        unfinished.unlink(missing_ok=True)


_NO_LINKS = frozenset({errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK})
"""Errors of a file system without hard links."""


def is_edited(text: str, checksum: str) -> bool:
    """Return True if a file's text differs from the one to which `save` gave this checksum; False without one."""
    return bool(checksum) and digest(re.sub(r"(?m)^checksum = .*\n?", "", text)) != checksum


def dump(network: Network) -> str:
    """Return the text of a twin file that `parse` turns into the same network; it ends with the revision, without
    checksum.
    """
    lines = [f"format = {FORMAT}", f"name = {_toml(network.name)}", f"title = {_toml(network.title)}"]
    lines += ["", "[inputs]"]
    for column, driver in network.inputs.items():
        entry = {"nominal": driver.nominal, "lower": driver.lower, "upper": driver.upper}
        kept: dict[str, Any] = {k: v for k, v in entry.items() if math.isfinite(v)}
        kept |= {k: v for k, v in (("unit", driver.unit), ("source", driver.source)) if v}
        lines.append(f"{_key(column)} = {_toml(kept)}")
    for element in network.elements:
        lines += ["", f"[elements.{element.name}]", f"kind = {_toml(element.kind)}"]
        for key, field in element.places().items():
            value = getattr(element, field.name)
            if value:
                lines.append(f"{key} = {_toml(value)}")
        for spec in element.parameter_specs():
            p = network.parameters[f"{element.name}.{spec.name}"]
            keys = ("same_as",) if p.same_as else ("value", "lower", "upper", "unit", "status", "source")
            lines.append(f"{spec.name} = {_toml({k: getattr(p, k) for k in keys})}")
    rules = network.rules
    lines += ["", "[windows]"]
    lines += [f"{key} = {_toml(getattr(rules, key))}" for key in rules.__dataclass_fields__]
    for chosen in network.sets.values():
        lines += ["", f"[sets.{_key(chosen.name)}]"]
        if chosen.source:
            lines.append(f"source = {_toml(chosen.source)}")
        if chosen.bounds:
            lines.append(f"bounds = {_toml(chosen.bounds)}")
        lines.append("members = [")
        for name, scale, initial in zip(chosen.members, chosen.scale, chosen.initial, strict=True):
            lines.append(f"    {_toml({'parameter': name, 'scale': scale, 'initial': initial})},")
        lines.append("]")
    revision = network.revision
    lines += ["", "[revision]", f"number = {revision.number}"]
    for key in revision.__dataclass_fields__:
        value = getattr(revision, key)
        if value and key not in ("number", "checksum"):
            lines.append(f"{key} = {_toml(value)}")
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return repr(float(value))  # a numpy float is a float too, and its repr is no number
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return '"' + "".join(c if c >= " " and c != "\x7f" else f"\\u{ord(c):04x}" for c in escaped) + '"'
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {_toml(v)}" for k, v in value.items()) + " }"
    return "[" + ", ".join(_toml(v) for v in value) + "]"


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _toml(name)
