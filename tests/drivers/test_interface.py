"""Packages of the drivers: importing them loads little, and their READMEs list each module."""

import json
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from drivers.can.imports import without

PROJECT = Path(__file__).resolve().parents[2]
PACKAGES = tuple(
    sorted(".".join(init.parent.relative_to(PROJECT).parts) for init in (PROJECT / "drivers").rglob("__init__.py"))
)
LAZY = tuple(name for name in PACKAGES if hasattr(import_module(name), "__getattr__"))


@pytest.mark.parametrize("name", LAZY)
def test_an_unknown_name_is_an_attribute_error(name: str) -> None:
    package = import_module(name)
    with pytest.raises(AttributeError, match="no_such_name"):
        package.no_such_name  # noqa: B018
    assert dir(package) == sorted(package.__all__)


def _heavy_modules(statement: str) -> set[str]:
    heavy = {"cantools", "can", "asammdf", "pandas", "sympy", "pymodbus", "serial", "numba", "yaml"}
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


@pytest.mark.parametrize("module", ["wire", "dbc"])
def test_receiving_frames_loads_no_reader_of_log_files(module: str) -> None:
    assert {"can"} <= _heavy_modules(f"import drivers.can.{module}") <= {"can", "cantools"}


def test_a_library_is_hidden_from_imports_of_a_block_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "this", raising=False)
    with pytest.raises(ModuleNotFoundError), without("this"):
        import_module("this")
    assert "this" not in sys.modules
    with without("json"):
        assert import_module("json") is json


@pytest.mark.parametrize("name", PACKAGES[1:])
def test_the_readme_of_a_package_lists_each_of_its_modules(name: str) -> None:
    folder = PROJECT.joinpath(*name.split("."))
    listed = re.findall(r"(?m)^\| `(\w+)` \|", (folder / "README.md").read_text(encoding="utf-8"))
    assert sorted(listed) == sorted({path.stem for path in folder.glob("*.py")} - {"__init__"})


def test_the_readme_of_the_drivers_lists_each_package() -> None:
    listed = re.findall(r"(?m)^\| \[`(\w+)`\]", (PROJECT / "drivers" / "README.md").read_text(encoding="utf-8"))
    assert sorted(listed) == sorted(name.split(".")[1] for name in PACKAGES if name.count(".") == 1)
