"""Check of published results: commit of the measured code, and changes of that code since.

    python -m hil.bench.measure.results_check [FOLDER]

It lists each result that should be measured again and always ends with exit code 0 unless FOLDER cannot be used: old
results are no error. Changes of comments, docstrings, layout, imports and lists of public names do not count: the same
code runs, and code that moves to another file counts there.
"""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

PROJECT = Path(__file__).resolve().parents[3]
RESULTS = PROJECT / "docs" / "results"
_TWIN = ("twin/*.py", "twin/elements")
_FITS = (*_TWIN, "twin/calibrators/*.py")
_NETWORK = ("twin/calibrators/hiera_unet", "hil/bench/hiera")
_DIAGNOSIS = (*_FITS, "twin/discovery", "drivers/virtual/plant", "hil/bench/discovery", "hil/diagnosis")
_LOOP = ("drivers", "hil/run", "hil/journal")
MEASURED: dict[str, tuple[str, ...]] = {
    "twin": (*_TWIN, "hil/bench/kernel", "hil/bench/peers"),
    "fit": (*_FITS, "hil/bench/kernel", "hil/bench/peers"),
    "paper": (*_FITS, "drivers/virtual/plant", "hil/bench/experiments", "hil/tracking"),
    "structure": (*_FITS, "drivers/virtual/plant", "hil/bench/experiments"),
    "records": (*_FITS, "hil/bench/experiments", "hil/record"),
    "hiera": (*_FITS, *_NETWORK, "hil/tracking"),
    "ablations": (*_FITS, *_NETWORK, "hil/training"),
    "discovery": _DIAGNOSIS,
    "again": _DIAGNOSIS,
    "zoo": (*_FITS, "twin/discovery", "hil/bench/discovery", "hil/bench/zoo", "hil/diagnosis", "hil/executor"),
    "fleet": (*_FITS, "twin/discovery", "hil/bench/fleet.py", "hil/diagnosis", "hil/executor", "hil/fleet"),
    "faults": (*_LOOP, "hil/bench/chaos", "hil/bench/faults", "hil/guardian"),
    "loop": (*_LOOP, "hil/bench/loop", "hil/tracking"),
    "bus": ("drivers/bus", "drivers/modbus", "drivers/signals", "hil/bench/loop", "hil/bench/peers"),
    "wire": ("drivers/bus", "drivers/can", "drivers/modbus", "drivers/signals", "hil/bench/fuzz"),
    "tower": ("twin/tower", "twin/historian", "hil/tower"),
    "files": (
        *_TWIN,
        "drivers/can",
        "drivers/importers",
        "drivers/rig_file",
        "hil/bench/fuzz",
        "hil/files",
        "hil/profile",
        "hil/record",
    ),
}
"""Code that each command of `hil bench` measures: folders with all that is below them, and `*` within one folder."""


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
    if _git(project, "rev-parse", "--git-dir") is None:
        raise ResultsFolderError(f"{project}: is in no git repository, so that no commit can be compared")
    return [ResultState(name, _problem(folder / f"{name}.manifest.json", project)) for name in names]


def _problem(manifest: Path, project: Path) -> str | None:
    try:
        content = json.loads(manifest.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return "has no manifest that can be read"
    if not isinstance(content, dict) or not isinstance(content.get("commit"), str):
        published = content.get("published") if isinstance(content, dict) else None
        return "its manifest has no commit of the measured code" + (f"; published in {published}" if published else "")
    commit, _, changes = content["commit"].partition(" ")
    if changes:
        return f"was measured with uncommitted changes on {commit}"
    if _git(project, "cat-file", "-e", f"{commit}^{{commit}}") is None:
        return f"was measured at {commit}, which this repository does not have"
    measured = MEASURED.get(_benchmark(content))
    if measured is None:
        return f"its command {content.get('command')!r} is not one of hil bench; correct the manifest"
    changed = changed_files(project, commit, measured)
    if not changed:
        return None
    first = f"{changed[0]} and {len(changed) - 1} more" if len(changed) > 1 else changed[0]
    return f"was measured at {commit}; since then changed: {first}"


def changed_files(project: Path, commit: str, measured: tuple[str, ...]) -> list[str]:
    """Return the files of `measured` (as in `MEASURED`) whose code differs between `commit` and the work tree."""
    patterns = [f":(glob){place}" if "*" in place else place for place in measured]
    listed = _git(project, "diff", "--name-only", "--no-renames", "--relative", commit, "--", *patterns) or ""
    return [name for name in listed.splitlines() if not _is_same_code(project, commit, name)]


def _is_same_code(project: Path, commit: str, name: str) -> bool:
    """Return True for a Markdown page, and for a Python file whose code is the same (see `_is_no_code`)."""
    if name.endswith(".md"):
        return True
    before = _git(project, "show", f"{commit}:./{name}")
    path = project / name
    if not name.endswith(".py") or before is None or not path.is_file():
        return False
    try:
        return _code(before) == _code(path.read_text(encoding="utf-8"))
    except (SyntaxError, ValueError):
        return False


def _code(source: str) -> str:
    tree = ast.parse(source)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [item for item in body if not _is_no_code(item)]  # type: ignore[attr-defined]
    return ast.dump(tree)


def _is_no_code(item: ast.stmt) -> bool:
    """Return True for a docstring, an import, imports for type checkers, and a list of public names."""
    if isinstance(item, ast.Import | ast.ImportFrom):
        return True
    if isinstance(item, ast.If):
        return isinstance(item.test, ast.Name) and item.test.id == "TYPE_CHECKING"
    if isinstance(item, ast.FunctionDef):
        return item.name in ("__getattr__", "__dir__")
    if isinstance(item, ast.Assign | ast.AnnAssign):
        targets = item.targets if isinstance(item, ast.Assign) else [item.target]
        names = {node.id for target in targets for node in ast.walk(target) if isinstance(node, ast.Name)}
        return names <= {"__all__", "__getattr__", "__dir__", "_HOME", "_MODULES"} and bool(names)
    return isinstance(item, ast.Expr) and isinstance(item.value, ast.Constant) and isinstance(item.value.value, str)


def _benchmark(manifest: dict[str, Any]) -> str:
    """Return the name behind `hil bench` in a manifest's command; empty where there is none."""
    words = str(manifest.get("command", "")).split()
    return words[2] if words[:2] == ["hil", "bench"] and len(words) > 2 else ""


def _git(project: Path, *arguments: str) -> str | None:
    """Return the output of a git command in `project`, None where it fails."""
    try:
        done = subprocess.run(["git", *arguments], cwd=project, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError, UnicodeDecodeError):
        return None
    return done.stdout


def main(arguments: list[str]) -> int:
    """Print a line for each result that should be measured again, then the count; return the exit code."""
    try:
        states = check_results(*(Path(argument) for argument in arguments[:1]))
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
