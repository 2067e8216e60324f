"""Check of published results: digests and commit of the measured code, and changes of that code since.

    python -m hil.bench.measure.results_check [--add-digests] [FOLDER]

It lists each result that should be measured again and always ends with exit code 0 unless FOLDER cannot be used: old
results are no error. The digests in a manifest decide, since a commit is lost when a branch is rewritten. The commit
names the changed files where the repository has it. `--add-digests` first adds the digests to manifests without them,
computed at their commit. `hil.bench.measure.measured_code` states which changes count.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.bench.measure.measured_code import PROJECT, code_digests, file_digest, git, is_within, places_of
from hil.files import replacing

RESULTS = PROJECT / "docs" / "results"
ADD = "--add-digests"


@dataclass(frozen=True, slots=True)
class ResultState:
    """State of the result file `name`; `problem` is a sentence, or None where the result is up to date."""

    name: str
    problem: str | None


class ResultsFolderError(ValueError):
    """Error of a results folder that cannot be checked; one sentence."""


def check_results(folder: Path = RESULTS, project: Path = PROJECT) -> list[ResultState]:
    """Return the state of each result (`*.json` with its manifest) in `folder`, by name.

    Parameters
    ----------
    folder
        Results that `hil bench --out` wrote.
    project
        Work tree of the git repository of the measured code.

    Raises
    ------
    ResultsFolderError
        The folder holds no result, or `project` is in no git repository.
    """
    names = sorted(path.stem for path in folder.glob("*.json") if not path.name.endswith(".manifest.json"))
    if not names:
        raise ResultsFolderError(f"{folder}: holds no result; give a folder that hil bench --out has written")
    if git(project, "rev-parse", "--git-dir") is None:
        raise ResultsFolderError(f"{project}: is in no git repository, so that no commit can be compared")
    return [ResultState(name, _problem(folder / f"{name}.manifest.json", project)) for name in names]


def add_digests(folder: Path = RESULTS, project: Path = PROJECT) -> list[str]:
    """Add the digests of the measured code to each manifest without them whose clean commit is in the repository.

    Returns
    -------
    list of str
        Names of the results whose manifest was written anew.
    """
    added = []
    for path in sorted(folder.glob("*.manifest.json")):
        content = _read(path)
        name = path.name.removesuffix(".manifest.json")
        places = None if content is None else _places(content, name)
        if content is None or places is None or "digests" in content:
            continue
        commit = content.get("commit")
        if not isinstance(commit, str) or " " in commit or not _has(project, commit):
            continue
        content["digests"] = code_digests(project, places, commit)
        with replacing(path) as temporary:
            temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        added.append(name)
    return added


def changed_files(project: Path, commit: str, places: Sequence[str]) -> list[str]:
    """Return the Python files of `places` (as in `MEASURED`) whose code differs between `commit` and the work tree."""
    listed = git(project, "diff", "--name-only", "--no-renames", "--relative", "-z", commit, "--", "*.py") or ""
    names = [name for name in listed.split("\0") if any(is_within(name, place) for place in places)]
    return [name for name in names if file_digest(project, name) != file_digest(project, name, commit)]


def _problem(manifest: Path, project: Path) -> str | None:
    content = _read(manifest)
    if content is None:
        return "has no manifest that can be read"
    commit, _, changes = str(content.get("commit") or "").partition(" ")
    digests = content["digests"] if isinstance(content.get("digests"), dict) else {}
    if not commit and not digests:
        published = content.get("published")
        return "its manifest has no commit of the measured code" + (f"; published in {published}" if published else "")
    name = manifest.name.removesuffix(".manifest.json")
    places = _places(content, name)
    if places is None:
        return f"hil bench has no command {content.get('command')!r} with a result {name}; correct the manifest"
    known = commit if commit and not changes and _has(project, commit) else None
    if known:
        measured = f"was measured at {commit}"
    elif changes:
        measured = f"was measured with uncommitted changes on {commit}"
    else:
        measured = f"was measured at {commit}, which this repository does not have" if commit else "was measured"
    if not known and not digests:
        return measured
    changed = _changes(project, places, digests, known)
    return f"{measured}; since then changed: {', '.join(changed)}" if changed else None


def _changes(project: Path, places: Sequence[str], digests: dict[str, Any], commit: str | None) -> list[str]:
    """Return a phrase for each place whose code is another now, with its files where the repository has the commit.

    The digests decide. A place without one is compared with the commit, and has changed if there is none.
    """
    now = code_digests(project, [place for place in places if place in digests])
    found = []
    for place in places:
        if place in now and now[place] == digests[place]:
            continue
        files = changed_files(project, commit, [place]) if commit else []
        if files:
            found.append(f"{place} ({files[0]}{f' and {len(files) - 1} more' if len(files) > 1 else ''})")
        elif place in now:
            found.append(place)
        elif commit is None:
            found.append(f"{place} (its manifest has no digest of it)")
    return found


def _read(manifest: Path) -> dict[str, Any] | None:
    try:
        content = json.loads(manifest.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None


def _has(project: Path, commit: str) -> bool:
    return git(project, "cat-file", "-e", f"{commit}^{{commit}}") is not None


def _places(manifest: dict[str, Any], name: str) -> tuple[str, ...] | None:
    """Return the places of a result by its command, and by its own name where its manifest does not state it."""
    words = str(manifest.get("command", "")).split()
    command = words[2] if words[:2] == ["hil", "bench"] and len(words) > 2 else None
    return places_of(str(manifest.get("result", name)), command) if command else None


def main(arguments: list[str]) -> int:
    """Print a line for each result that should be measured again, then the count; return the exit code."""
    folders = [Path(argument) for argument in arguments if argument != ADD][:1]
    try:
        if ADD in arguments:
            for name in add_digests(*folders):
                print(f"{name}: digests added")
        states = check_results(*folders)
    except ResultsFolderError as error:
        print(error, file=sys.stderr)
        return 2
    old = [state for state in states if state.problem is not None]
    for state in old:
        print(f"{state.name}: {state.problem}")
    print(f"{len(states) - len(old)} of {len(states)} results are up to date")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
