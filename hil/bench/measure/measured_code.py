"""Code that each result of `hil bench` measures, and digests of it that outlast rewritten commits.

    places = places_of("wire")
    now = code_digests(PROJECT, places)

A digest covers the code of the Python files of a place with their names. Comments, docstrings, layout, imports and
lists of public names do not count: the same code runs. Code that moves to another file counts. The digest is the same
in each version of Python that parses the code (3.10 to 3.13 were compared).
"""

from __future__ import annotations

import ast
import functools
import hashlib
import subprocess
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

PROJECT = Path(__file__).resolve().parents[3]
_TWIN = (
    "twin/*.py",
    "twin/commissioning",
    "twin/elements",
    "twin/kernel",
    "twin/laws",
    "twin/network",
    "twin/revisions",
    "twin/twinfile",
)
_FITS = (*_TWIN, "twin/calibrators/*.py")
_KERNEL = ("hil/bench/kernel", "hil/bench/peers")
_NETWORK = ("twin/calibrators/hiera_unet", "hil/bench/hiera")
_VIRTUAL = ("drivers/virtual/plant", "hil/synthetic")
_EXPERIMENTS = (*_FITS, "hil/bench/experiments")
_DISCOVERY = (*_FITS, "twin/discovery", "hil/bench/discovery", "hil/diagnosis")
_LOOP = ("drivers", "hil/run", "hil/journal")
_BUS = ("drivers/bus", "drivers/modbus", "drivers/signals")
_TOWER = (*_TWIN, "twin/tower", "twin/historian", "hil/tower")
MEASURED: dict[str, dict[str, tuple[str, ...]]] = {
    "twin": {"twin": (*_TWIN, *_KERNEL)},
    "fit": {"fit": (*_FITS, *_KERNEL)},
    "paper": {"paper": (*_EXPERIMENTS, *_VIRTUAL, "hil/tracking")},
    "structure": {"structure": (*_EXPERIMENTS, *_VIRTUAL)},
    "records": {"records": (*_EXPERIMENTS, "hil/record")},
    "hiera": {"hiera": (*_FITS, *_NETWORK, *_VIRTUAL, "hil/tracking")},
    "ablations": {"hiera_ablations": (*_FITS, *_NETWORK, "hil/training")},
    "audit": {
        "audit": (
            *_FITS,
            "twin/calibrators/hiera_unet",
            "twin/tower",
            "twin/historian",
            "drivers/virtual/tower",
            "hil/training/generate.py",
            "hil/training/tower/stations.py",
            "hil/bench/audit",
        ),
    },
    "discovery": {
        "discovery": (*_DISCOVERY, *_VIRTUAL),
        "discovery_records": (*_DISCOVERY, "hil/bench/experiments"),
    },
    "again": {"discovery_again": (*_DISCOVERY, *_VIRTUAL)},
    "zoo": dict.fromkeys(("zoo_dev", "zoo"), (*_DISCOVERY, "hil/bench/zoo", "hil/executor")),
    "effects": {
        "effects": (
            *_FITS,
            "hil/bench/effects",
            "hil/bench/zoo",
            "twin/calibrators/hiera_unet/effects",
            "twin/discovery",
        )
    },
    "fleet": {"fleet": (*_DISCOVERY, "hil/bench/fleet.py", "hil/executor", "hil/fleet")},
    "sinks": {
        "sinks": (
            *_LOOP,
            "hil/alarms",
            "hil/bench/sinks.py",
            "hil/export",
            "hil/panel/*.py",
            "hil/run_folder",
            "hil/stream",
        )
    },
    "posterior": {
        "posterior": (*_FITS, "drivers/virtual/plant", "hil/bench/posterior", "hil/synthetic", "hil/tracking")
    },
    "faults": {
        **dict.fromkeys(("faults", "faults_pairs"), (*_LOOP, "hil/bench/faults", "hil/guardian")),
        "chaos": (*_LOOP, "hil/bench/chaos", "hil/bench/faults", "hil/guardian"),
    },
    "loop": {"loop": (*_LOOP, "hil/bench/loop", "hil/tracking")},
    "bus": {"bus": (*_BUS, "hil/bench/loop", "hil/bench/peers")},
    "wire": {"wire": (*_BUS, "drivers/can", "hil/bench/fuzz")},
    "files": {
        "files": (
            *_TWIN,
            "drivers/can",
            "drivers/importers",
            "drivers/rig_file",
            "hil/bench/fuzz",
            "hil/files",
            "hil/profile",
            "hil/record",
        )
    },
    "tower": {
        "tower": (*_TOWER, "hil/bench/tower.py", "hil/bench/tower_truth.py"),
        "tower_network": (
            "twin/calibrators/hiera_unet",
            "twin/tower",
            "drivers/virtual/tower",
            "hil/training/tower",
            "hil/bench/tower_network.py",
        ),
        "tower_stations": (*_TOWER, "drivers/historian", "drivers/virtual/tower", "hil/bench/tower_stations.py"),
        "tower_steps": (*_TOWER, "hil/bench/tower_steps.py"),
    },
    "tower-governance": {
        "tower_governance": (
            *_TOWER,
            "drivers/historian",
            "drivers/virtual/tower",
            "hil/bench/tower_governance/cases.py",
            "hil/bench/tower_governance/figures.py",
            "hil/bench/tower_governance/known.py",
            "hil/bench/tower_governance/tables.py",
            "hil/bench/tower_governance/trial.py",
            "hil/bench/tower_stations.py",
        ),
    },
    "tower-rivals": {
        "tower_rivals": (
            "twin/calibrators/hiera_unet",
            "twin/tower",
            "twin/historian",
            "drivers/virtual/tower",
            "hil/training/tower/stations.py",
            "hil/bench/rivals",
        ),
    },
    "tower-rows": {
        "tower_rows": (
            *_TOWER,
            "twin/calibrators/hiera_unet",
            "drivers/virtual/tower",
            "hil/training/tower/stations.py",
            "hil/bench/acceptance",
        ),
    },
}
"""Command of `hil bench` -> result that it writes -> places of its code: files, folders, and `*` within one folder."""
_UNSTABLE = {"ctx", "kind", "type_comment", "type_ignores"}
"""Fields of syntax trees without influence on what runs."""


@dataclass(frozen=True, slots=True)
class CodeState:
    """Code of a measurement: its commit with "+ changes" if the tree is not clean, and the digest of each place."""

    commit: str | None
    digests: dict[str, str]


def places_of(result: str, command: str = "") -> tuple[str, ...] | None:
    """Return the places whose code a result measures.

    Parameters
    ----------
    result
        Name of the result. That of a renamed page has its own name behind that of the result: `discovery_wire`.
    command
        Name behind `hil bench`, empty for any.

    Returns
    -------
    tuple of str or None
        Places as in `MEASURED`; None if no such command writes such a result.
    """
    results = MEASURED.get(command, {}) if command else {k: v for named in MEASURED.values() for k, v in named.items()}
    found = [name for name in results if result == name or result.startswith(f"{name}_")]
    return results[max(found, key=len)] if found else None


def code_state(command: str, project: Path = PROJECT) -> CodeState:
    """Return the state of the code that a command of `hil bench` measures, with the places of all of its results."""
    places = {place for measured in MEASURED.get(command, {}).values() for place in measured}
    return CodeState(commit_of(project), code_digests(project, sorted(places)))


def commit_of(project: Path = PROJECT) -> str | None:
    """Return the commit of the work tree, with "+ changes" if a tracked file differs; None without git."""
    head = git(project, "rev-parse", "--short=12", "HEAD")
    changed = git(project, "status", "--porcelain", "--untracked-files=no", ":/")
    return None if head is None or changed is None else head.strip() + (" + changes" if changed.strip() else "")


def code_digests(project: Path, places: Iterable[str], commit: str | None = None) -> dict[str, str]:
    """Return the digest of the code of each place.

    Parameters
    ----------
    project
        Folder that holds the places.
    places
        As in `MEASURED`.
    commit
        Commit of the git repository of `project`; None for the work tree.

    Returns
    -------
    dict of str to str
        Place -> 16 hexadecimal digits of a SHA-256. A place without code has one too.

    Raises
    ------
    ValueError
        The repository does not have the commit.
    """
    wanted = tuple(places)
    if commit is None:
        found = {name: file_digest(project, name) for name in _work_tree(project, wanted)}
    else:
        found = dict(_digests_at(project, wanted, commit))
    return {
        place: _digest(f"{n} {d}" for n, d in sorted(found.items()) if d and is_within(n, place)) for place in wanted
    }


def file_digest(project: Path, name: str, commit: str | None = None) -> str | None:
    """Return the digest of a Python file in the work tree or at a commit; None if it is missing or holds no code."""
    if commit is not None:
        return _source_digest(git(project, "show", f"{commit}:./{name}") or "")
    try:
        return _source_digest((project / name).read_text(encoding="utf-8"))
    except OSError:
        return None


def is_within(name: str, place: str) -> bool:
    """Return True if the file `name` belongs to a place as in `MEASURED`."""
    if "*" in place:
        path, pattern = PurePosixPath(name), PurePosixPath(place)
        return len(path.parts) == len(pattern.parts) and path.match(place)
    return name == place or name.startswith(f"{place}/")


def git(project: Path, *arguments: str) -> str | None:
    """Return the output of a git command in `project`, None where it fails."""
    try:
        done = subprocess.run(["git", *arguments], cwd=project, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError, UnicodeDecodeError):
        return None
    return done.stdout


def _work_tree(project: Path, places: Sequence[str]) -> set[str]:
    files: set[Path] = set()
    for place in places:
        top = project / place
        files.update(project.glob(place) if "*" in place else [top] if top.is_file() else top.rglob("*.py"))
    return {path.relative_to(project).as_posix() for path in files if path.suffix == ".py"}


def _digests_at(project: Path, places: Sequence[str], commit: str) -> Iterator[tuple[str, str | None]]:
    """Yield name and digest of each Python file of the places at a commit, with one process of git for all texts."""
    listed = git(project, "ls-tree", "-r", "-z", "--name-only", commit)
    if listed is None:
        raise ValueError(f"{project}: has no commit {commit} in its repository; fetch it")
    names = [n for n in listed.split("\0") if n.endswith(".py") and any(is_within(n, place) for place in places)]
    asked = "".join(f"{commit}:./{name}\n" for name in names)
    done = subprocess.run(
        ["git", "cat-file", "--batch"], cwd=project, input=asked.encode(), capture_output=True, check=True
    )
    rest = done.stdout
    for name in names:
        head, _, rest = rest.partition(b"\n")
        size = int(head.split()[-1])
        yield name, _source_digest(rest[:size].decode("utf-8"))
        rest = rest[size + 1 :]


@functools.lru_cache(maxsize=4096)
def _source_digest(source: str) -> str | None:
    """Return the digest of the code of a module, or of its text if it is no Python; None if it holds no code."""
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError):
        return _digest([source])
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [item for item in body if not _is_no_code(item)]  # type: ignore[attr-defined]
    return _digest(_shape(tree)) if tree.body else None


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


def _shape(node: object) -> Iterator[str]:
    """Yield the words of a syntax tree without what differs between versions of Python.

    Empty fields are left out, since newer versions add some. Neighbouring texts of an f-string are one, and empty ones
    none, since 3.12.1 cuts them elsewhere. Texts are ASCII, since versions differ in what they can print.
    """
    if isinstance(node, list):
        yield "["
        for item in node:
            yield from _shape(item)
        yield "]"
    elif isinstance(node, ast.Constant):
        yield f"{type(node.value).__name__} {node.value!a}"
    elif isinstance(node, ast.AST):
        yield f"({type(node).__name__}"
        for field in node._fields:
            value = getattr(node, field, None)
            if field not in _UNSTABLE and value is not None and value != []:
                yield field
                yield from _shape(_joined(value) if isinstance(node, ast.JoinedStr) else value)
        yield ")"
    else:
        yield ascii(node)


def _joined(values: Iterable[ast.expr]) -> list[ast.expr]:
    """Return the parts of an f-string with neighbouring texts joined and empty ones left out."""
    parts: list[ast.expr] = []
    for part in values:
        if not isinstance(part, ast.Constant):
            parts.append(part)
        elif parts and isinstance(parts[-1], ast.Constant):
            parts[-1] = ast.Constant(f"{parts[-1].value!s}{part.value!s}")
        elif part.value:
            parts.append(part)
    return parts


def _digest(words: Iterable[str]) -> str:
    return hashlib.sha256("\n".join(words).encode("utf-8", "surrogatepass")).hexdigest()[:16]
