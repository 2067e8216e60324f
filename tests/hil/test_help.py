"""Help of the commands: examples, and no heavy library for it."""

from __future__ import annotations

import subprocess
import sys

import pytest
from click.testing import CliRunner, Result

from hil.cli import group
from tests.hil.input_files import PROJECT


@pytest.mark.parametrize("verb", ["check", "commission", "profile", "review", "rig", "run", "track", "twin"])
def test_every_verb_has_help_with_an_example(verb):
    result: Result = CliRunner().invoke(group, [verb, "--help"])
    assert result.exit_code == 0
    assert "Example" in result.output
    assert f"hil {verb}" in result.output


def test_help_says_which_steady_states_are_held_out():
    printed = " ".join(CliRunner().invoke(group, ["diagnose", "--help"]).output.split())
    assert "every fourth is held out of every fit" in printed


def test_help_loads_no_heavy_library():
    heavy = "{'torch', 'rerun', 'scipy', 'numba', 'pymodbus', 'can', 'cantools', 'pyarrow', 'matplotlib', 'numpy'}"
    program = (
        "import sys\nfrom click.testing import CliRunner\nfrom hil.cli import group\n"
        "assert CliRunner().invoke(group, ['--help']).exit_code == 0\n"
        f"found = {heavy} & set(sys.modules)\nassert not found, found"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=PROJECT, timeout=60)
    assert done.returncode == 0, done.stderr
