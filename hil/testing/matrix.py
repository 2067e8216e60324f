"""Matrix of requirements against runs: the worst verdict of all limits that verify a requirement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hil.run_folder import RunFolder, RunFolderError, read_verdict
from hil.testing.verdicts import Verdict, overall


@dataclass(frozen=True, slots=True)
class Matrix:
    """Verdicts by requirement, and by run in the order of `runs`; None where a run has no limit for a requirement."""

    runs: tuple[str, ...]
    rows: dict[str, tuple[Verdict | None, ...]]
    limits: dict[str, tuple[str, ...]]

    def document(self) -> dict[str, object]:
        """Return the matrix as plain data."""
        return {
            "runs": list(self.runs),
            "requirements": {
                name: {"limits": list(self.limits[name]), "verdicts": dict(zip(self.runs, row, strict=True))}
                for name, row in self.rows.items()
            },
        }

    @property
    def verdict(self) -> Verdict:
        """The worst verdict of all requirements; one that a run does not judge counts for that run as nothing."""
        return overall(verdict for row in self.rows.values() for verdict in row if verdict is not None)


def requirement_matrix(folders: Sequence[RunFolder]) -> Matrix:
    """Return the matrix of judged runs.

    Raises
    ------
    RunFolderError
        A run was not judged, or two runs have the same name.
    """
    names = [folder.path.resolve().name for folder in folders]
    names = [str(folder.path) if names.count(name) > 1 else name for folder, name in zip(folders, names, strict=True)]
    found: dict[str, dict[str, list[Verdict]]] = {}
    limits: dict[str, dict[str, None]] = {}
    for folder, name in zip(folders, names, strict=True):
        folder.read_manifest()  # refuse a folder of something else
        document = read_verdict(folder)
        if not document["tests"]:
            raise RunFolderError(f"{folder.path} was not judged; judge it with `hil test PLAN --on {folder.path}`")
        for test in document["tests"]:
            for limit in test["limits"]:
                found.setdefault(limit["requirement"], {}).setdefault(name, []).append(limit["verdict"])
                limits.setdefault(limit["requirement"], {})[f"{test['id']}/{limit['id']}"] = None
    rows = {
        requirement: tuple(overall(by_run[name]) if name in by_run else None for name in names)
        for requirement, by_run in sorted(found.items())
    }
    return Matrix(tuple(names), rows, {requirement: tuple(ids) for requirement, ids in limits.items()})
