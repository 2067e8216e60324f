"""Matrix of requirements against runs: the worst verdict of all limits that verify a requirement.

Limits are grouped by reference: `REQ-7: the tank stays cool` and `REQ-7` are one requirement, and a limit of
`REQ-7, REQ-8: cooling` counts for both.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from hil.run_folder import RunFolder, RunFolderError, read_verdict
from hil.testing.judgement import Verdict, overall

_REFERENCE = re.compile(r"(?=[^\s,;]*\d)[^\s,;]*[^\s,;:]")
"""Reference of a requirement: one word with a digit."""


@dataclass(frozen=True, slots=True)
class Matrix:
    """Verdicts by reference, and by run in the order of `runs`; None where a run has no limit for a requirement.

    `limits` names the limits of each reference, `texts` has what plans state about it.
    """

    runs: tuple[str, ...]
    rows: dict[str, tuple[Verdict | None, ...]]
    limits: dict[str, tuple[str, ...]]
    texts: dict[str, tuple[str, ...]]

    def document(self) -> dict[str, object]:
        """Return the matrix as plain data."""
        return {
            "runs": list(self.runs),
            "requirements": {
                name: {
                    "texts": list(self.texts[name]),
                    "limits": list(self.limits[name]),
                    "verdicts": dict(zip(self.runs, row, strict=True)),
                }
                for name, row in self.rows.items()
            },
        }

    def heading(self, reference: str) -> str:
        """Return a reference with the texts of the plans."""
        texts = "; ".join(self.texts[reference])
        return f"{reference}: {texts}" if texts else reference

    @property
    def verdict(self) -> Verdict:
        """The worst verdict of all requirements; one that a run does not judge counts for that run as nothing."""
        return overall(verdict for row in self.rows.values() for verdict in row if verdict is not None)


def references(requirement: str) -> tuple[tuple[str, ...], str]:
    """Return the references of a limit's requirement, and its text.

    References are words with a digit before a colon or alone, several of them with commas or semicolons between. A
    requirement without one is its own reference.
    """
    whole = " ".join(requirement.split())
    head, _, text = whole.partition(": ")
    found = [part.strip() for part in re.split(r"[,;]", head.removesuffix(":")) if part.strip()]
    if not found or not all(_REFERENCE.fullmatch(part) for part in found):
        return (whole or requirement,), ""
    return tuple(dict.fromkeys(found)), text.strip()


def requirement_matrix(folders: Sequence[RunFolder]) -> Matrix:
    """Return the matrix of judged runs, its references in the order in which people number them.

    Raises
    ------
    RunFolderError
        A run was not judged, or two runs have the same name.
    """
    names = [folder.path.resolve().name for folder in folders]
    names = [str(folder.path) if names.count(name) > 1 else name for folder, name in zip(folders, names, strict=True)]
    found: dict[str, dict[str, list[Verdict]]] = {}
    limits: dict[str, dict[str, None]] = {}
    texts: dict[str, dict[str, None]] = {}
    for folder, name in zip(folders, names, strict=True):
        folder.read_manifest()  # refuse a folder of something else
        document = read_verdict(folder)
        if not document["tests"]:
            raise RunFolderError(f"{folder.path} was not judged; judge it with `hil test PLAN --on {folder.path}`")
        for test in document["tests"]:
            for limit in test["limits"]:
                named, text = references(limit["requirement"])
                for reference in named:
                    found.setdefault(reference, {}).setdefault(name, []).append(limit["verdict"])
                    limits.setdefault(reference, {})[f"{test['id']}/{limit['id']}"] = None
                    texts.setdefault(reference, {}).update({text: None} if text else {})
    rows = {
        reference: tuple(overall(by_run[name]) if name in by_run else None for name in names)
        for reference, by_run in sorted(found.items(), key=lambda item: _order(item[0]))
    }
    return Matrix(
        tuple(names),
        rows,
        {reference: tuple(ids) for reference, ids in limits.items()},
        {reference: tuple(said) for reference, said in texts.items()},
    )


def _order(reference: str) -> list[tuple[int, str]]:
    """Return the key of a reference, by which REQ-2 is before REQ-10."""
    parts = re.split(r"(\d+)", reference)
    return [(int(part), "") if part.isdecimal() and len(part) < 20 else (-1, part) for part in parts]
