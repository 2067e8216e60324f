"""Revisions of a twin: new elements and values in a new network, and the chain of files in which they are saved.

A revision of ``my_twin.toml`` is saved beside it as ``my_twin.r2.toml``, the next as ``my_twin.r3.toml``. The number is
the revision's own and unique among those files, also where two were made from one parent. The SHA-256 in a revision
identifies its parent; names never do. No file is ever overwritten.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from twin.network import Network, Revision, TwinFileError, did_you_mean, digest
from twin.revisions.differences import ElementDiff, KeyDiff, ParameterDiff, TwinDiff, diff
from twin.twinfile import from_tables, is_edited, load, read_text, save, to_tables
from twin.twinfile.bounded_toml import parse_toml

__all__ = [
    "ChainEntry",
    "ElementDiff",
    "KeyDiff",
    "ParameterDiff",
    "TwinDiff",
    "chain",
    "diff",
    "next_path",
    "parent_of",
    "revert",
    "save_revision",
    "with_elements",
]

UNDOES = "undoes "
"""First word of the first note of a revert."""
NOTHING: Mapping[str, Any] = MappingProxyType({})
"""Empty mapping, the default of optional arguments."""


def with_elements(
    network: Network,
    tables: Mapping[str, Mapping[str, object]],
    values: Mapping[str, float] = NOTHING,
    revision: Revision | None = None,
    *,
    replace: Mapping[str, Mapping[str, object]] = NOTHING,
    inputs: Mapping[str, Mapping[str, object]] = NOTHING,
) -> Network:
    """Return a network with more elements, other values and altered elements; the old one stays unchanged.

    Parameters
    ----------
    network
        The present network.
    tables
        Name of a new element -> its table as in the twin file: kind, places, parameters.
    values
        Id of a parameter of the network -> value in the parameter's unit.
    revision
        Origin of the new network; None keeps the present revision.
    replace
        Name of an element of the network -> keys of its table to set. For a parameter, a number sets its value and a
        table sets its entries (status, bounds ...) and leaves the others; None removes a key.
    inputs
        New input column -> its table. A column that the network has must be given unchanged.

    Raises
    ------
    TwinFileError
        One plain sentence; every check of a twin file holds.
    """
    title = f"twin {network.name!r}"
    network.index(values)
    data = to_tables(dataclasses.replace(network, revision=revision or network.revision))
    elements = data["elements"]
    for column, table in inputs.items():
        plain = _plain(table)
        if column in data["inputs"] and data["inputs"][column] != plain:
            raise TwinFileError(f"{title} has another input {column!r} already; name the new one otherwise")
        data["inputs"][column] = plain
    for name, value in values.items():
        p = network.parameters[name]
        if p.same_as:
            raise TwinFileError(f"{name} of {title} is the same as {p.same_as}; change that one")
        elements[p.element][p.name]["value"] = _plain(value)
    for name, table in replace.items():
        if name not in elements:
            raise TwinFileError(f"{title} has no element {name!r}{did_you_mean(name, elements)}")
        for key, entry in table.items():
            _set(elements[name], key, _plain(entry), f"{title}: {name}")
    for name, table in tables.items():
        if name in elements:
            raise TwinFileError(f"{title} has an element {name!r} already; name the new one otherwise")
        elements[name] = _plain(table)
    return from_tables(data, title)


def _set(element: dict[str, Any], key: str, entry: Any, title: str) -> None:
    old = element.get(key)
    if entry is None:
        element.pop(key, None)
    elif not isinstance(old, dict):
        element[key] = entry
    else:
        new = entry if isinstance(entry, dict) else {"value": entry}
        if "same_as" in old and not new.keys() & {"value", "same_as"}:
            raise TwinFileError(f"{title}.{key} is the same as {old['same_as']}; change that one")
        shared = "same_as" in old or "same_as" in new  # a value of its own and a shared one exclude each other
        element[key] = new if shared else old | new


def _plain(value: Any) -> Any:
    """Return mappings as dicts and sequences as lists, as the reader of twin files expects them."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value


@dataclass(frozen=True)
class ChainEntry:
    """A file of a chain.

    Attributes
    ----------
    network
        The network of the file; `network.revision` names its origin.
    remarks
        Plain sentences on the end of the chain and on other files made from the same parent.
    faults
        Plain sentences on files that were edited after they were saved.
    """

    path: Path
    network: Network
    remarks: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()


@dataclass(frozen=True)
class TwinFile:
    """A twin file of the folder: SHA-256 of its text, and that of its parent."""

    path: Path
    digest: str
    parent: str


def chain(path: str | Path) -> tuple[ChainEntry, ...]:
    """Return a twin file and its ancestors, newest first, as far as the files are in its folder.

    A parent that is missing, edited or unreadable ends the chain; the last entry reports it.

    Raises
    ------
    TwinFileError
        The file itself cannot be used.
    """
    path = Path(path)
    files = twin_files(path)
    entries: list[ChainEntry] = []
    network = load(path)
    while True:
        parent, end, faulty = _parent(path, network.revision, files)
        remarks = [f"{c.path.name} was made of it" for c in _children(network, files)] if not entries else []
        if network.revision.parent:
            twins = (o for o in files if o.parent == network.revision.parent and o.digest != network.digest)
            remarks += [f"{other.path.name} was made of the same parent" for other in twins]
        faults = [end] if faulty else []
        if is_edited(read_text(path), network.revision.checksum):
            faults.append(
                f"{path.name} was edited after it was saved (its checksum no longer matches); its errors and "
                "evidence belong to the text as it was saved"
            )
        below: Network | None = None
        if parent is not None:
            try:
                below = load(parent)
            except TwinFileError as error:
                end = f"its parent cannot be used: {error}"
        if end and not faulty:
            remarks.append(end)
        entries.append(ChainEntry(path, network, tuple(remarks), tuple(faults)))
        if parent is None or below is None:
            return tuple(entries)
        path, network = parent, below


def next_path(path: str | Path) -> Path:
    """Return the path of the next revision of a twin file: beside it, under a number that is free.

    Raises
    ------
    TwinFileError
        The file cannot be used.
    """
    path = Path(path)
    return _numbered(path, _next_number(path, load(path).revision.number))


def save_revision(network: Network, parent_path: str | Path) -> Path:
    """Save a network as the next revision of the twin file from which it was made, and return the new file.

    Number, parent and the parent's name are filled in. Evidence that the network only inherited from the parent
    (`Network.with_values` keeps it) is left out: it does not hold for the new values.

    Raises
    ------
    TwinFileError
        The parent cannot be used, the network is inconsistent, or the folder cannot be written.
    """
    parent_path = Path(parent_path)
    parent = load(parent_path)
    revision = Revision() if network.revision == parent.revision else network.revision
    number = _next_number(parent_path, parent.revision.number)
    while True:
        path = _numbered(parent_path, number)
        stamped = dataclasses.replace(revision, number=number, parent=parent.digest, parent_file=parent_path.name)
        new = dataclasses.replace(network, revision=stamped)
        from_tables(to_tables(new), f"twin {network.name!r}")
        try:
            return save(new, path)
        except TwinFileError:
            if not path.exists():
                raise
            number += 1  # somebody else saved under this number just now


def parent_of(path: str | Path) -> Path:
    """Return the twin file of the same folder from which this one was made.

    Raises
    ------
    TwinFileError
        It has no parent, or its parent is missing or was edited.
    """
    path = Path(path)
    revision = load(path).revision
    if not revision.parent:
        raise TwinFileError(f"{path}: was made of no other twin file; it has no parent")
    parent, end, _ = _parent(path, revision, twin_files(path))
    if parent is None:
        raise TwinFileError(f"{path}: {end}")
    return parent


def revert(path: str | Path, made_by: str = "revert") -> Path:
    """Undo a revision: write a new one, made from it, with the content of its parent. Both files stay.

    Raises
    ------
    TwinFileError
        There is no parent, nothing differs from it, or the folder cannot be written.
    """
    path = Path(path)
    parent = parent_of(path)
    network, before = load(path), load(parent)
    if diff(before, network).empty:
        raise TwinFileError(f"{path}: is the same twin as its parent {parent.name}; there is nothing to undo")
    notes = [
        f"{UNDOES}{path.name} (revision {network.revision.number}): "
        f"restores {parent.name} (revision {before.revision.number})"
    ]
    notes += [f"{c.path.name} was made of it too and stays as it is" for c in _children(network, twin_files(path))]
    revision = Revision(made_by=made_by, notes=tuple(notes))
    return save_revision(dataclasses.replace(before, revision=revision), path)


def _parent(path: Path, revision: Revision, files: tuple[TwinFile, ...]) -> tuple[Path | None, str, bool]:
    """Return the parent's file; without one None, a sentence with the reason, and True if somebody edited it."""
    if not revision.parent:
        return None, "", False
    found = [other.path for other in files if other.digest == revision.parent]
    if found:
        # Of several copies, the one under the name that it was made of, else the one of the same family.
        best = min(found, key=lambda f: (f.name != revision.parent_file, _family(f)[0] != _family(path)[0], f.name))
        return best, "", False
    name, sha = revision.parent_file, revision.parent[:12]
    if name and (path.parent / name).exists():
        sentence = f"{name} was edited after {path.name} was made of it (its SHA-256 is no longer {sha}...)"
        return None, f"{sentence}; put the old text back", True
    called = f"its parent {name} (SHA-256 {sha}...) is" if name else f"its parent (SHA-256 {sha}...) was edited or is"
    return None, f"{called} not in this folder; put it beside {path.name}", False


def _children(network: Network, files: tuple[TwinFile, ...]) -> list[TwinFile]:
    return [other for other in files if other.parent == network.digest]


def twin_files(path: Path) -> tuple[TwinFile, ...]:
    """Return the twin files beside a file, by name; other files are skipped."""

    def found() -> Iterator[TwinFile]:
        for file in sorted(path.parent.glob("*.toml")):
            try:
                text = read_text(file)
                data = parse_toml(text)
            except ValueError:
                continue
            revision = data.get("revision", {})
            if "elements" in data and isinstance(revision, dict):
                yield TwinFile(file, digest(text), str(revision.get("parent", "")))

    return tuple(found())


def _family(path: Path) -> tuple[str, int]:
    """Return the name that all revisions of a twin share, and the number in this file's name (0: it has none)."""
    match = re.fullmatch(r"(.+)\.r(\d+)", path.stem)
    return (match[1], int(match[2])) if match else (path.stem, 0)


def _numbered(path: Path, number: int) -> Path:
    return path.with_name(f"{_family(path)[0]}.r{number}.toml")


def _next_number(path: Path, own: int) -> int:
    base = _family(path)[0]
    return 1 + max(own, *(number for name, number in map(_family, path.parent.glob("*.toml")) if name == base), 0)
