"""Public names of the drivers' packages: each can be imported, hil uses no others, and importing loads little."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]
PACKAGES = tuple(
    sorted(".".join(init.parent.relative_to(PROJECT).parts) for init in (PROJECT / "drivers").rglob("__init__.py"))
)
LAZY = tuple(name for name in PACKAGES if hasattr(import_module(name), "__getattr__"))
BY_MODULE = ("hil/run/engine/", "hil/run/outputs/", "hil/journal/writer.py", "hil/journal/store.py")
"""Files that still import from modules of the drivers. This list may only become shorter."""
FAULTY_REPLIES = "drivers.virtual.faults.faulty_replies"
"""Used as a module: its functions are looked up by the name of a fault."""


@pytest.mark.parametrize("name", PACKAGES)
def test_every_public_name_can_be_imported(name: str) -> None:
    package = import_module(name)
    assert package.__all__
    for public in package.__all__:
        assert getattr(package, public) is not None


@pytest.mark.parametrize("name", LAZY)
def test_an_unknown_name_is_an_attribute_error(name: str) -> None:
    package = import_module(name)
    with pytest.raises(AttributeError, match="no_such_name"):
        package.no_such_name  # noqa: B018
    assert dir(package) == sorted(package.__all__)


def _imports(path: Path) -> Iterator[tuple[int, str, str]]:
    """Yield line, module and name of each import from the drivers."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "drivers":
            yield from ((node.lineno, str(node.module), alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from ((node.lineno, a.name, "") for a in node.names if a.name.partition(".")[0] == "drivers")


def test_hil_imports_public_names_of_packages_alone() -> None:
    private = []
    for path in sorted((PROJECT / "hil").rglob("*.py")):
        relative = path.relative_to(PROJECT).as_posix()
        for line, module, name in _imports(path):
            is_public = module in PACKAGES and name in import_module(module).__all__
            if not is_public and f"{module}.{name}" != FAULTY_REPLIES and not relative.startswith(BY_MODULE):
                private.append(f"{relative}:{line}: {module}.{name}")
    assert not private


def _heavy_modules(statement: str) -> set[str]:
    heavy = {"cantools", "can", "pymodbus", "serial", "numba", "yaml"}
    program = f"import sys\n{statement}\nprint(*{heavy} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", program], cwd=PROJECT, check=True, capture_output=True, text=True)
    return set(done.stdout.split())


def test_importing_the_packages_loads_no_library_of_a_wire() -> None:
    lazy = ", ".join(name for name in PACKAGES if name != "drivers.rig")
    assert _heavy_modules(f"import {lazy}") == set()


def test_a_public_name_loads_only_what_it_needs() -> None:
    assert (
        _heavy_modules("from drivers.modbus import polling, plan_reads; from drivers.rig_file import load_rig") == set()
    )
    assert _heavy_modules("from drivers.virtual.plant import load_effects") == set()


@pytest.mark.parametrize("name", PACKAGES[1:])
def test_the_readme_of_a_package_lists_each_of_its_modules(name: str) -> None:
    folder = PROJECT.joinpath(*name.split("."))
    listed = re.findall(r"(?m)^\| `(\w+)` \|", (folder / "README.md").read_text(encoding="utf-8"))
    assert sorted(listed) == sorted({path.stem for path in folder.glob("*.py")} - {"__init__"})


def test_the_readme_of_the_drivers_lists_each_package() -> None:
    listed = re.findall(r"(?m)^\| \[`(\w+)`\]", (PROJECT / "drivers" / "README.md").read_text(encoding="utf-8"))
    assert sorted(listed) == sorted(name.split(".")[1] for name in PACKAGES if name.count(".") == 1)
