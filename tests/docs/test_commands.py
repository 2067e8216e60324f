"""Commands and Python of README, tutorials and how-to guides, run as a reader would, one folder a page.

The pages use the project's own load profiles of 10 and 40 hours. Here these profiles end after `SHORTENED_S`, so that
all pages together take about a minute of processor time.
"""

from __future__ import annotations

import contextlib
import glob
import io
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from hil.cli import group
from hil.errors import explained
from tests.docs.fences import PROJECT, REASONS, Fence, fences, pages

SHORTENED_S = 1200.0
"""Two windows of ten minutes, the shortest record that `hil diagnose` takes."""
FINDS = {"diagnose", "twin"}
"""Commands whose exit code 1 reports a finding, not a failure."""
START_S = 60.0
"""Within this a run in the background must begin, and after its abort end."""
LANGUAGES = {"sh", "python", "toml", "csv", "text", "json", ""}

PAGES = {str(page.relative_to(PROJECT)): page for page in pages()}
ALL = [fence for page in PAGES.values() for fence in fences(page)]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> Path:
    """A folder that looks like a checkout: links to the project's data, and load profiles cut short.

    Profiles keep their length where a page steers a run in the background, since its commands end that run.
    """
    is_steered = any("background" in fence.words for fence in fences(PAGES[name]))
    for source in (PROJECT / "profiles").rglob("*"):
        target = tmp_path / "profiles" / source.relative_to(PROJECT / "profiles")
        if source.is_dir():
            target.mkdir(parents=True, exist_ok=True)
        elif source.parent.name == "loads" and source.suffix == ".csv" and not is_steered:
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(_shortened(source.read_text(encoding="utf-8")), encoding="utf-8")
        else:
            target.parent.mkdir(parents=True, exist_ok=True)
            target.symlink_to(source)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def _shortened(text: str) -> str:
    """Return a load profile that ends at `SHORTENED_S`, with the values that it has there."""
    comments = [line for line in text.splitlines() if line.startswith("#")]
    head, *rows = [line for line in text.splitlines() if not line.startswith("#")]
    kept = [row for row in rows if float(row.split(",")[0]) < SHORTENED_S]
    last = ",".join([f"{SHORTENED_S:g}", *kept[-1].split(",")[1:]])
    return "\n".join([*comments, head, *kept, last]) + "\n"


class Background:
    """The command of a page that goes on while the next ones run."""

    def __init__(self) -> None:
        self.process: subprocess.Popen[bytes] | None = None
        self.served: subprocess.Popen[str] | None = None

    def start(self, arguments: list[str]) -> None:
        """Start `hil` with `arguments`, and wait until its profile runs."""
        self.process = subprocess.Popen([sys.executable, "-m", "hil", *arguments], stdout=subprocess.DEVNULL)
        end = time.monotonic() + START_S
        while _state() != "running":
            assert self.process.poll() is None, f"hil {shlex.join(arguments)} ended before it could be asked"
            assert time.monotonic() < end, f"hil {shlex.join(arguments)} does not run"
            time.sleep(0.5)

    def serve(self, arguments: list[str]) -> None:
        """Start `hil rig`, and wait until it serves; `background` ends it."""
        words = [sys.executable, "-u", "-m", "hil", *arguments]
        self.served = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        assert self.served.stdout is not None
        assert any("Ctrl-C" in line for line in self.served.stdout), f"hil {shlex.join(arguments)} does not serve"


@pytest.fixture
def background() -> Iterator[Background]:
    """The background command, which a page must have ended by its last fence."""
    running = Background()
    yield running
    if running.served is not None:
        running.served.send_signal(signal.SIGINT)
        running.served.communicate(timeout=START_S)
        assert running.served.returncode == 0
    if running.process is not None:
        try:
            assert running.process.wait(timeout=START_S) in (0, 1)
        finally:
            if running.process.poll() is None:  # ends by itself, with its virtual rig
                running.process.terminate()
                running.process.wait(timeout=START_S)


def _hil(arguments: list[str]) -> int:
    """Run `hil` in this process, which goes on after it; return its exit code."""
    try:
        with explained():
            group.main(arguments, "hil", standalone_mode=True)
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0


def _state() -> str | None:
    """Return the state of the one live run, or None where none answers yet."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(io.StringIO()):
        code = _hil(["ctl", "status", "--json"])
    return str(json.loads(printed.getvalue())["status"]["state"]) if code == 0 else None


def _arguments(command: str) -> list[str]:
    """Return the words of a command, with its globs expanded as a shell does."""
    words: list[str] = []
    for word in shlex.split(command, comments=True):
        words += sorted(glob.glob(word)) if any(mark in word for mark in "*?[") and glob.glob(word) else [word]
    return words


RAN: dict[tuple[str, ...], Path] = {}
"""Commands of a page from its first one on -> the folder in which they were run."""


def _run(history: tuple[str, ...], place: str) -> None:
    """Run the last command of a page's `history`; where another page had the same ones, take over its runs."""
    command = history[-1]
    if history in RAN and (RAN[history] / "runs").is_dir():
        shutil.copytree(RAN[history] / "runs", "runs", dirs_exist_ok=True)
        return
    words = _arguments(command)
    if words[0] == "hil":
        code = _hil(words[1:])
        allowed = (0, 1) if words[1] in FINDS else (0,)
        assert code in allowed, f"{place}: {command!r} ends with {code}"
    else:
        done = subprocess.run(["bash", "-euc", command], capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, f"{place}: {command!r}: {done.stderr}"
    RAN[history] = Path.cwd()


def _python(fence: Fence, folder: Path) -> None:
    """Run a fence of Python in a process of its own, so that what it registers stays there."""
    script = folder / f"line_{fence.line}.py"
    script.write_text(fence.text, encoding="utf-8")
    paths = os.pathsep.join([str(PROJECT), str(folder)])
    done = subprocess.run(
        [sys.executable, "-W", "error", str(script)],
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, "PYTHONPATH": paths},
    )
    assert done.returncode == 0, f"{fence.place}: {done.stderr}"


@pytest.mark.parametrize("name", PAGES)
def test_every_fence_of_a_page_runs(name: str, folder: Path, background: Background) -> None:
    for fence in fences(PAGES[name]):
        if fence.file is not None:
            Path(fence.file).write_text(fence.text, encoding="utf-8")
    history: tuple[str, ...] = ()
    for fence in fences(PAGES[name]):
        if fence.reason is not None or fence.file is not None:
            continue
        if fence.language == "python":
            _python(fence, folder)
        elif fence.language == "sh" and "background" in fence.words:
            (command,) = fence.commands()
            background.start(_arguments(command)[1:])
        elif fence.language == "sh" and "serving" in fence.words:
            (command,) = fence.commands()
            background.serve(_arguments(command)[1:])
        elif fence.language == "sh":
            for command in fence.commands():
                history += (command,)
                _run(history, fence.place)


@pytest.mark.parametrize("fence", ALL, ids=lambda fence: fence.place)
def test_info_strings_are_known(fence: Fence) -> None:
    assert fence.language in LANGUAGES, f"{fence.place}: language {fence.language!r}"
    known = {*REASONS, "background", "serving"}
    assert all(word in known or word.startswith("file=") for word in fence.words), f"{fence.place}: {fence.words}"


def _target(words: list[str]) -> tuple[click.Command, list[str]]:
    """Return the command that the words of a `hil` command name, and the words that are left for it."""
    command: click.Command = group
    rest = words[1:]
    while isinstance(command, click.Group):
        found = command.get_command(click.Context(command), rest[0])
        assert found is not None, f"hil has no command {rest[0]!r}"
        command, rest = found, rest[1:]
    return command, rest


NOT_RUN = [(fence, command) for fence in ALL if fence.reason for command in fence.commands()]


@pytest.mark.parametrize(("fence", "command"), NOT_RUN, ids=[f"{f.place}-{f.reason}" for f, _ in NOT_RUN])
def test_commands_that_cannot_run_have_options_that_exist(fence: Fence, command: str) -> None:
    words = shlex.split(command, comments=True)
    if words[0] == "hil":
        target, rest = _target(words)
        options = {name for parameter in target.params for name in (*parameter.opts, *parameter.secondary_opts)}
        options |= {"--help", "-h"}
        given = {word.split("=")[0] for word in rest if re.match(r"--?[a-z]", word)}
        assert given <= options, f"{fence.place}: {given - options} of {command!r}"
    elif words[0] == "make" and len(words) > 1:
        makefile = (PROJECT / "Makefile").read_text(encoding="utf-8")
        assert re.search(rf"^{re.escape(words[1])}:", makefile, re.MULTILINE), f"{fence.place}: make {words[1]}"


def test_the_pages_list_is_not_empty_and_names_the_readme() -> None:
    assert "README.md" in PAGES
    assert any(fence.language == "sh" and fence.reason is None for fence in ALL)
    assert os.path.isdir(PROJECT / "docs" / "how-to")
