"""Folder of a course: its answers, the steps that are done, and the shell script of their commands."""

from __future__ import annotations

import hashlib
import json
import tomllib
from pathlib import Path
from typing import Any

from hil.files import replacing
from hil.run_folder import require_output
from hil.start.errors import StartError

ANSWERS, SCRIPT = "start.answers.toml", "start.sh"
_HEADER = "# Answers of `hil start`; `hil start --answers` takes this file."
_SCRIPT_HEADER = """\
#!/usr/bin/env bash
# Commands of `hil start` in this folder, in their order. A file that was edited by hand since is written anew.
set -euo pipefail
"""


class Store:
    """Answers and finished steps of a folder, written at once on each change.

    Attributes
    ----------
    folder
        Folder of the course.
    answers
        Answers by key, in the order in which they were given.
    done
        SHA-256 of the lines of the script of each finished step, by its name.
    """

    def __init__(self, folder: Path, outputs: tuple[str, ...]) -> None:
        """Read an earlier course.

        Raises
        ------
        StartError
            The folder holds files of these names that are not of a course, or answers that cannot be read.
        """
        self.folder = folder
        self.answers: dict[str, str] = {}
        self.done: dict[str, str] = {}
        self._script: dict[str, str] = {}
        for name in (ANSWERS, SCRIPT, *outputs):
            require_output(folder / name, StartError)
        if (folder / ANSWERS).exists():
            document = _tables(folder / ANSWERS)
            self.done = {key: str(value) for key, value in document.pop("done", {}).items()}
            self.answers = flat(document)
            return
        for name in (SCRIPT, *outputs):
            if (folder / name).exists():
                raise StartError(f"{folder / name} is there already; give it with --from, or begin in another folder")

    def keep(self, key: str, answer: str) -> None:
        """Save an answer."""
        self.answers.pop(key, None)
        self.answers[key] = answer
        self._save()

    def is_done(self, step: str, lines: str) -> bool:
        """Return True if a step is done by these commands; otherwise forget it and all later steps, and add them."""
        if lines:
            self._script[step] = lines
        if self.done.get(step) == _hash(lines):
            return True
        names = list(self.done)
        for name in names[names.index(step) if step in self.done else len(names) :]:
            del self.done[name]
        self._save()
        parts = [f"# {name}\n{text}\n" for name, text in self._script.items()]
        _write(self.folder / SCRIPT, "\n".join([_SCRIPT_HEADER, *parts]))
        return False

    def finish(self, step: str, lines: str) -> None:
        """Save that a step is done by these commands."""
        self.done[step] = _hash(lines)
        self._save()

    def _save(self) -> None:
        lines = [_HEADER, *(f"{_quoted(key)} = {_quoted(value)}" for key, value in self.answers.items())]
        lines += ["", "[done]", *(f"{_quoted(key)} = {_quoted(value)}" for key, value in self.done.items())]
        _write(self.folder / ANSWERS, "\n".join(lines) + "\n")


def read_answers(path: Path) -> dict[str, str]:
    """Return the answers of a file that a person or an earlier course wrote; raise StartError."""
    document = _tables(path)
    document.pop("done", None)
    return flat(document)


def flat(table: dict[str, Any], place: str = "") -> dict[str, str]:
    """Return the values of a table and of those in it as texts, with dotted keys."""
    found: dict[str, str] = {}
    for key, value in table.items():
        if isinstance(value, dict):
            found |= flat(value, f"{place}{key}.")
        elif isinstance(value, list):
            found[f"{place}{key}"] = ", ".join(str(item) for item in value)
        else:
            found[f"{place}{key}"] = ("yes" if value else "no") if isinstance(value, bool) else str(value)
    return found


def _hash(lines: str) -> str:
    return hashlib.sha256(lines.encode()).hexdigest()


def _tables(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise StartError(f"{path} cannot be read ({error.strerror or error}); check the path") from None
    except ValueError as error:
        raise StartError(f"{path}: is no TOML file ({error}); write lines like port = 502") from None


def _quoted(text: str) -> str:
    # JSON's strings are TOML's, but for the delete character, which JSON leaves as it is.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _write(path: Path, text: str) -> None:
    try:
        with replacing(path) as unfinished:
            unfinished.write_text(text, encoding="utf-8")
    except OSError as error:
        raise StartError(
            f"{path} cannot be written ({error.strerror or error}); free the disk or choose another folder"
        ) from None
