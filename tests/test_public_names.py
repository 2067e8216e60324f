"""Public names: every package declares its own, and code outside of a package imports no others."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]
NEEDS_TORCH = "twin.calibrators.hiera_unet"
UNDECLARED = ("hil.run", "twin.discovery.")
"""A package of packages alone, and the private packages of the diagnosis."""
EXCEPTIONS = {
    ("twin", "twin"): "the packages of the twin share one kernel; they are private to one another only by layers",
    ("hil.bench.faults", "drivers.virtual.faults"): "functions of a module are looked up by the name of a fault",
    ("hil.bench", "twin"): "benches measure parts of the twin that nobody else may use",
}
"""Importer and imported package that are not held to the rule. This list may only become shorter."""


def _dotted(path: Path) -> str:
    parts = path.relative_to(PROJECT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def syntax_trees() -> dict[str, ast.Module]:
    """Return the syntax tree of each module and package, by its dotted name."""
    files = [path for top in ("hil", "drivers", "twin") for path in sorted((PROJECT / top).rglob("*.py"))]
    return {_dotted(path): ast.parse(path.read_text(encoding="utf-8")) for path in files}


PACKAGES = sorted(_dotted(path) for top in ("hil", "drivers", "twin") for path in (PROJECT / top).rglob("__init__.py"))
DECLARED = [name for name in PACKAGES if not (name == UNDECLARED[0] or name.startswith(UNDECLARED[1]))]


@cache
def public_names(package: str) -> frozenset[str]:
    """Return the names in ``__all__`` as they are written in the source."""
    for statement in syntax_trees()[package].body:
        target = statement.targets[0] if isinstance(statement, ast.Assign) else getattr(statement, "target", None)
        if isinstance(target, ast.Name) and target.id == "__all__":
            return frozenset(ast.literal_eval(statement.value))  # type: ignore[attr-defined]
    return frozenset()


def _belongs(name: str, package: str) -> bool:
    return not package or name == package or name.startswith(f"{package}.")


def _imports(importer: str) -> Iterator[tuple[int, str, str]]:
    """Yield line, package and name of each import; a module stands for itself, with its package and its last name."""
    for node in ast.walk(syntax_trees()[importer]):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, *alias.name.rpartition(".")[::2]) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            if node.module in PACKAGES:
                yield from ((node.lineno, node.module, alias.name) for alias in node.names)
            else:  # a module: it must be public itself
                yield (node.lineno, *node.module.rpartition(".")[::2])


def _private_imports(importer: str) -> Iterator[tuple[str, str]]:
    """Yield the imported package and a message for each private import across a package's border."""
    inside = importer if importer in PACKAGES else importer.rpartition(".")[0]
    for line, package, name in _imports(importer):
        if package not in PACKAGES or _belongs(inside, package) or name in public_names(package):
            continue
        if f"{package}.{name}" not in PACKAGES:
            yield package, f"{importer.replace('.', '/')}.py:{line}: {package}.{name}"


def test_every_package_declares_its_public_names() -> None:
    undeclared = [name for name in DECLARED if not any("__all__" in ast.dump(s) for s in syntax_trees()[name].body)]
    assert not undeclared


@pytest.mark.parametrize("package", DECLARED)
def test_every_public_name_can_be_imported(package: str) -> None:
    if package == NEEDS_TORCH:
        pytest.importorskip("torch")
    loaded = import_module(package)
    for name in public_names(package):
        try:
            assert getattr(loaded, name) is not None
        except ImportError as error:  # the tool of a peer that is not installed
            assert not str(error.name).startswith(("hil", "drivers", "twin"))
    assert set(dir(loaded)) >= public_names(package) - {"__version__", "Absent"}
    with pytest.raises(AttributeError, match="no_such_name"):
        loaded.no_such_name  # noqa: B018


@pytest.mark.parametrize("package", DECLARED)
def test_names_for_the_type_checker_are_those_that_are_declared(package: str) -> None:
    blocks = [s for s in syntax_trees()[package].body if isinstance(s, ast.If) and "TYPE_CHECKING" in ast.dump(s.test)]
    typed = {a.asname or a.name for b in blocks for s in b.body if isinstance(s, ast.ImportFrom) for a in s.names}
    submodules = {name.rpartition(".")[2] for name in syntax_trees() if name.rpartition(".")[0] == package}
    if blocks:
        assert typed == public_names(package) - submodules


def test_packages_import_public_names_of_others_alone() -> None:
    private, used = [], set()
    for importer in syntax_trees():
        for package, message in _private_imports(importer):
            excepted = [e for e in EXCEPTIONS if _belongs(importer, e[0]) and _belongs(package, e[1])]
            used.update(excepted)
            if not excepted:
                private.append(message)
    assert not private
    assert used == set(EXCEPTIONS), "take the exceptions that are not needed out of the list"


def test_every_name_that_is_imported_from_a_package_is_there() -> None:
    """A type checker does not see this: `__getattr__` of a package may return anything."""
    missing = []
    for importer in syntax_trees():
        for line, package, name in _imports(importer):
            names = public_names(package) if package in PACKAGES else None
            if names is None or name in names or f"{package}.{name}" in syntax_trees():
                continue
            if not hasattr(import_module(package), name):
                missing.append(f"{importer}:{line}: {package}.{name}")
    assert not missing


def test_importing_every_package_of_the_harness_loads_no_heavy_library() -> None:
    names = [name for name in DECLARED if name.startswith("hil") and name != "hil.bench.peers"]
    heavy = {"numpy", "scipy", "numba", "pyarrow", "rerun", "torch", "matplotlib", "pymodbus", "can", "cantools"}
    program = f"import sys\nimport {', '.join(names)}\nprint(*{heavy} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", program], cwd=PROJECT, check=True, capture_output=True, text=True)
    assert not done.stdout.split()
