"""The command line in this process: what the console script does, without the seconds that its imports take.

For tests of what a verb answers. A test of processes, signals or terminals starts `python -m hil`.
"""

from __future__ import annotations

import contextlib
import io
from subprocess import CompletedProcess

import pytest

from hil.cli import group
from hil.errors import explained


def typed(*arguments: object) -> CompletedProcess[str]:
    """Return exit code and output of `hil` with these arguments; relative paths are those of this process."""
    words, out, err = [str(item) for item in arguments], io.StringIO(), io.StringIO()
    with (
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        pytest.raises(SystemExit) as ended,
        explained(),
    ):
        group.main(words, prog_name="hil", standalone_mode=True)
    code = ended.value.code
    return CompletedProcess(
        words, code if isinstance(code, int) else int(code is not None), out.getvalue(), err.getvalue()
    )


def hil(*arguments: object) -> tuple[int, str]:
    """Return the exit code of `hil` with `arguments`, and everything printed."""
    done = typed(*arguments)
    return done.returncode, done.stdout + done.stderr
