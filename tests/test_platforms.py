"""Calls that only POSIX or Linux has: each is in a module that the page on platforms names."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil.cli import verbs
from tests.docs.fences import PROJECT

PAGE = PROJECT / "docs/reference/platforms.md"
MODULES = {"fcntl", "grp", "pty", "pwd", "resource", "syslog", "termios", "tty"}
"""Modules of Python that Windows lacks."""
NAMES = {
    "os": {"fchmod", "fork", "forkpty", "getpgid", "getuid", "geteuid", "kill", "killpg", "mkfifo", "nice", "openpty"}
    | {"sched_setaffinity", "setsid", "O_CLOEXEC", "O_DIRECTORY", "O_NOCTTY", "O_NOFOLLOW", "O_NONBLOCK", "WNOHANG"},
    "socket": {"AF_UNIX"},
    "asyncio": {"open_unix_connection", "start_unix_server"},
}
METHODS = {"add_signal_handler"}
KEYWORDS = {"start_new_session", "preexec_fn"}
ON_WINDOWS = {"SIGABRT", "SIGFPE", "SIGILL", "SIGINT", "SIGSEGV", "SIGTERM", "SIG_DFL", "SIG_IGN"}
_SIGNAL = re.compile(r"SIG[A-Z0-9_]+|pthread_\w+|setitimer|sigwait\w*")
_PLACE = re.compile(r"/(proc|dev)/")
TEXTS = {
    "drivers/importers/homeassistant.py": "a remedy names a serial port",
    "drivers/importers/telegraf.py": "a message names the form of a port",
    "hil/start/actions.py": "a line of a script for bash",
}
"""Modules with such a path in a text for the reader alone."""


def posix_calls(source: str) -> Iterator[str]:
    """Yield what a module imports or calls that only POSIX or Linux has."""
    tree = ast.parse(source)
    docs = {
        id(node.value)
        for body in ast.walk(tree)
        if isinstance(body, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
        for node in body.body
        if isinstance(node, ast.Expr)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in MODULES)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            if node.module in MODULES:
                yield str(node.module)
            yield from (a.name for a in node.names if a.name in NAMES.get(str(node.module), ()))
            if node.module == "signal":
                yield from (a.name for a in node.names if _SIGNAL.fullmatch(a.name) and a.name not in ON_WINDOWS)
        elif isinstance(node, ast.Attribute):
            of = node.value.id if isinstance(node.value, ast.Name) else ""
            is_signal = of == "signal" and _SIGNAL.fullmatch(node.attr) and node.attr not in ON_WINDOWS
            if node.attr in NAMES.get(of, ()) or node.attr in METHODS or is_signal:
                yield f"{of}.{node.attr}"
        elif isinstance(node, ast.keyword) and node.arg in KEYWORDS:
            yield str(node.arg)
        elif (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and id(node) not in docs
            and _PLACE.search(node.value)
        ):
            yield node.value


def found() -> dict[str, list[str]]:
    """Return the calls of each module that has some, by its path."""
    calls = {}
    for top in ("hil", "drivers", "twin"):
        for path in (PROJECT / top).rglob("*.py"):
            name = path.relative_to(PROJECT).as_posix()
            if name not in TEXTS and (these := list(posix_calls(path.read_text(encoding="utf-8")))):
                calls[name] = these
    return calls


def named() -> list[str]:
    return re.findall(r"^\| `((?:hil|drivers|twin)/[\w./]+)` \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)


def test_the_page_names_every_module_that_needs_posix_and_no_other():
    calls, rows = found(), named()
    covered = {name: row for name in calls for row in rows if name == row or name.startswith(f"{row}/")}
    assert {name: calls[name] for name in calls if name not in covered} == {}
    assert sorted(set(rows) - set(covered.values())) == []


@pytest.mark.parametrize(
    "source",
    [
        "import fcntl",
        "from pwd import getpwuid",
        "import os\nos.fork()",
        "from os import O_NOFOLLOW",
        "import signal\nsignal.SIGKILL",
        "from signal import SIGHUP",
        "open('/proc/self/stat')",
        "f'/dev/{name}'",
        "loop.add_signal_handler(2, stop)",
        "Popen([], start_new_session=True)",
    ],
)
def test_the_scan_finds_each_kind_of_call(source):
    assert list(posix_calls(source))


@pytest.mark.parametrize(
    "source", ["import signal\nsignal.SIGINT", "import os\nos.getpid()", "'''Reads /proc/self.'''", "x = 'a/b'"]
)
def test_the_scan_leaves_portable_calls_alone(source):
    assert not list(posix_calls(source))


@pytest.mark.parametrize(
    ("platform", "words", "sentence"),
    [
        ("win32", ("check", "x.toml"), "WSL 2"),
        ("darwin", ("run", "x.csv"), "hil run needs Linux"),
        ("darwin", ("rig",), "hil rig needs Linux"),
    ],
)
def test_a_command_that_needs_linux_says_so_elsewhere(monkeypatch, capsys, platform, words, sentence):
    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.setattr(sys, "argv", ["hil", *words])
    with pytest.raises(SystemExit) as ended:
        verbs.main()
    said = capsys.readouterr().err
    assert ended.value.code == 2 and sentence in said and said.count("\n") == 1


WITHOUT = """
import os, runpy, signal, sys
for name in ("SIGPWR", "SIGSTKFLT", "SIGPOLL"):
    if hasattr(signal, name): delattr(signal, name)
for name in ("sched_setaffinity", "sched_getaffinity", "O_PATH"):
    if hasattr(os, name): delattr(os, name)
def hook(event, args):
    if event == "open" and str(args[0]).startswith("/proc/"): raise FileNotFoundError(args[0])
sys.addaudithook(hook)
sys.argv = ["hil", *sys.argv[1:]]
runpy.run_module("hil", run_name="__main__")
"""
"""Program that runs `hil` without what macOS lacks; libraries are those of Linux."""


@pytest.mark.parametrize(
    "words",
    [
        ("check", "profiles/rigs/virtual.toml"),
        ("check", "profiles/twins/loop.toml"),
        ("check", "profiles/loads/battle_10h.csv"),
        ("init", "--heater", "holding:0", "--out", "rig.toml"),
    ],
)
def test_commands_that_read_files_need_nothing_that_macos_lacks(tmp_path, words):
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT, *words],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
        env={"PATH": "/usr/bin:/bin", "PYTHONPATH": str(PROJECT), "HOME": str(tmp_path)},
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_texts_that_only_name_a_path_are_still_there():
    for name in TEXTS:
        assert list(posix_calls(Path(PROJECT / name).read_text(encoding="utf-8")))
