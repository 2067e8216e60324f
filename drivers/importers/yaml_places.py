"""YAML document with the line and the tag of every value, read by PyYAML; an error asks for it where it is missing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.importers.draft import ImportFileError

_DEEPEST = 50
_MOST = 100_000
_MERGE = "tag:yaml.org,2002:merge"
_NUMBERS = frozenset(f"tag:yaml.org,2002:{kind}" for kind in ("int", "float", "bool", "null"))


@dataclass(slots=True)
class Placed:
    """Value of a YAML file and its line; `value` holds `Placed` again inside of lists and tables.

    `tag` is a tag that is not YAML's own, `!secret` or `!include`: the text behind it is no value.
    """

    value: Any
    line: int
    tag: str = ""

    def get(self, key: str) -> Placed | None:
        """Return the entry of a table, or None."""
        return self.value.get(key) if isinstance(self.value, dict) else None

    def plain(self, key: str, default: Any = None) -> Any:
        """Return the text, number or bool of an entry, or `default`."""
        found = self.get(key)
        return default if found is None or found.value is None else found.value


def load_placed(path: Path, text: str) -> Placed:
    """Return the document of a YAML text; raise ImportFileError with the line and the remedy."""
    try:
        import yaml
    except ImportError:
        raise ImportFileError(
            path, None, "is YAML, which takes PyYAML to read; install it (pip install pyyaml) and try again"
        ) from None
    try:
        node = yaml.compose(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        return Placed({}, 1) if node is None else _Reader(path, yaml).placed(node, 0)
    except ImportFileError:
        raise
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark is not None else None
        said = text.splitlines()[line - 1] if line is not None and line <= len(text.splitlines()) else ""
        remedy = "replace its tabs by blanks" if "\t" in said else "correct the line"
        raise ImportFileError(path, line, f"is not valid YAML: {error.problem}; {remedy}") from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise ImportFileError(path, None, f"is not valid YAML: {' '.join(str(error).split())}; correct it") from None


class _Reader:
    def __init__(self, path: Path, yaml: Any) -> None:
        self.path = path
        self.yaml = yaml
        self._count = 0
        self._constructor = yaml.SafeLoader("")

    def placed(self, node: Any, depth: int) -> Placed:
        """Return a node with its line; raise ImportFileError where aliases of aliases make it endless."""
        line = node.start_mark.line + 1
        self._count += 1
        if depth > _DEEPEST or self._count > _MOST:
            raise ImportFileError(
                self.path, line, f"is deeper than {_DEEPEST} levels or holds too much; is this a configuration?"
            )
        tag = node.tag if node.tag.startswith("!") else ""
        if isinstance(node, self.yaml.MappingNode):
            return Placed(self._table(node, depth), line, tag)
        if isinstance(node, self.yaml.SequenceNode):
            return Placed([self.placed(item, depth + 1) for item in node.value], line, tag)
        return Placed(self._scalar(node, line), line, tag)

    def _scalar(self, node: Any, line: int) -> Any:
        if node.tag not in _NUMBERS:
            return node.value
        try:
            return self._constructor.construct_object(node)
        except (ValueError, KeyError, IndexError, OverflowError):
            raise ImportFileError(
                self.path, line, f"{node.value[:40]!r} is no {node.tag.rpartition(':')[2]}; correct it"
            ) from None

    def _table(self, node: Any, depth: int) -> dict[str, Placed]:
        """Return the entries of a table, those merged with `<<` below its own; a key that is there twice is refused."""
        own: dict[str, Placed] = {}
        merged: dict[str, Placed] = {}
        for key, value in node.value:
            found = self.placed(value, depth + 1)
            if key.tag == _MERGE:
                for item in found.value if isinstance(found.value, list) else [found]:
                    if isinstance(item.value, dict):
                        merged = item.value | merged
                continue
            name = str(key.value) if isinstance(key.value, str) else f"key of line {key.start_mark.line + 1}"
            if name in own:
                line = key.start_mark.line + 1
                raise ImportFileError(
                    self.path, line, f"{name} is there twice (line {own[name].line}); take one of them out"
                )
            own[name] = found
        return merged | own
