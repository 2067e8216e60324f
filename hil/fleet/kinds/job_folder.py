"""Folder of a job on a worker, and the data that a job gets and returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True, slots=True)
class GivenJob:
    """Job as a worker gets it: kind, seed, options, and the inputs by their place.

    `names` are the paths of the inputs on the machine of the client, for results.
    """

    kind: str
    seed: int | None
    options: Mapping[str, Any]
    content: Mapping[str, bytes]
    roles: Mapping[str, str]
    names: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class MadeJob:
    """Result of a job: its row in the table, its answer in a few words, and its files by name."""

    row: dict[str, Any]
    answer: str
    files: dict[str, bytes] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class JobFolder:
    """Folder of a job on a worker, with its inputs."""

    path: Path
    given: GivenJob

    @property
    def out(self) -> Path:
        """Return the folder for results."""
        return self.path / "out"

    def find(self, role: str) -> Path | None:
        """Return the input of a role, None without one."""
        return next((self.path / place for place, found in self.given.roles.items() if found == role), None)

    def one(self, role: str) -> Path:
        """Return the input of a role that every job of its kind has."""
        found = self.find(role)
        assert found is not None, role
        return found

    def named(self, path: Path) -> str:
        """Return the path of an input on the machine of the client, and the name alone of another file."""
        if path.is_relative_to(self.path):
            return self.given.names.get(path.relative_to(self.path).as_posix(), path.name)
        return path.name

    def results(self) -> dict[str, bytes]:
        """Return the files in the folder for results."""
        if not self.out.is_dir():
            return {}
        found = sorted(path for path in self.out.rglob("*") if path.is_file() and not path.is_symlink())
        return {path.relative_to(self.out).as_posix(): path.read_bytes() for path in found}
