"""The public names of the twin's packages: each can be imported, and importing a package loads nothing heavy."""

import subprocess
import sys

import pytest

import twin
import twin.calibrators
import twin.calibrators.hiera_unet
import twin.discovery
import twin.elements
from tests.twin.conftest import ROOT

LAZY = (twin, twin.discovery, twin.calibrators.hiera_unet)


def test_public_names_of_the_network_are_those_of_its_modules() -> None:
    pytest.importorskip("torch")
    for name in twin.calibrators.hiera_unet.__all__:
        assert getattr(twin.calibrators.hiera_unet, name).__name__.rpartition(".")[2] == name


@pytest.mark.parametrize("package", LAZY, ids=lambda p: p.__name__)
def test_an_unknown_name_is_an_attribute_error(package: object) -> None:
    with pytest.raises(AttributeError, match="no_such_name"):
        package.no_such_name  # type: ignore[attr-defined]  # noqa: B018
    assert dir(package) == sorted(package.__all__)  # type: ignore[attr-defined]


def test_importing_the_twin_loads_no_library() -> None:
    program = "import sys, twin, twin.discovery; sys.exit(len({'numpy', 'numba', 'scipy', 'torch'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=False).returncode == 0
