"""Revisions that an operator undid: those that a revert, which itself still holds, was made of."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from twin.network import Network, TwinFileError
from twin.revisions.revision_chain import UNDOES, twin_files
from twin.twinfile import load


@dataclass(frozen=True)
class UndoneRevision:
    """A revision that was undone: its file and content, and the file of the revert with what it restored."""

    path: Path
    network: Network
    revert: Path
    restored: Network


def undone_revisions(path: str | Path) -> tuple[UndoneRevision, ...]:
    """Return the revisions of a twin's lineage in its folder that a revert undid, oldest revert first.

    The lineage holds the ancestors of the file and all that was made of any of them. A revert that was undone in turn
    counts no longer.

    Raises
    ------
    TwinFileError
        The file itself cannot be used.
    """
    networks = _lineage(Path(path))
    reverts = [n for n in networks if networks[n][1].revision.notes[:1] and _undoes(networks[n][1])]
    reverts.sort(key=lambda n: networks[n][1].revision.number, reverse=True)
    undone: dict[str, str] = {}
    for name in reverts:
        # A later revert may have undone this one.
        if name not in undone:
            undone[networks[name][1].revision.parent] = name
    return tuple(
        UndoneRevision(*networks[parent], *networks[revert])
        for parent, revert in reversed(undone.items())
        if parent in networks and not _undoes(networks[parent][1])
    )


def revisions_made_of(path: str | Path) -> tuple[tuple[Path, Network], ...]:
    """Return the revisions in the folder that were made of a twin file, by name.

    Raises
    ------
    TwinFileError
        The file itself cannot be used.
    """
    own = load(path).digest
    return tuple(one for one in _lineage(Path(path)).values() if one[1].revision.parent == own)


def _undoes(network: Network) -> bool:
    return bool(network.revision.notes) and network.revision.notes[0].startswith(UNDOES)


def _lineage(path: Path) -> dict[str, tuple[Path, Network]]:
    """Return file and content of the twins that share an ancestor with a file, by the digest of their text."""
    parents = {one.digest: one.parent for one in twin_files(path)}
    own = load(path).digest
    parents.setdefault(own, load(path).revision.parent)

    def root(name: str) -> str:
        seen = {name}
        while (above := parents.get(name, "")) and above not in seen:
            seen.add(above)
            name = above
        return name

    found = {}
    for one in twin_files(path):
        if root(one.digest) == root(own):
            try:
                found[one.digest] = one.path, load(one.path)
            except TwinFileError:
                continue  # a damaged twin beside it is another command's matter
    return found
