"""Actions of a step: commands of `hil` and files, as a process of this program and as lines of a shell script."""

from __future__ import annotations

import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from hil.files import replacing
from hil.start.errors import StopRequest

_FORWARDED = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name)
)
_POLL_S = 0.1
_SERVES_WITHIN_S = 60.0
"""Time in which `hil rig` must serve; it compiles its twin the first time."""


@dataclass(frozen=True, slots=True)
class Newest:
    """Newest run in a folder: names of runs begin with their time."""

    folder: str

    def path(self, base: Path) -> str:
        """Return its path; raise StopRequest if there is none."""
        runs = sorted(path.name for path in (base / self.folder).glob("*") if path.is_dir())
        if not runs:
            raise StopRequest(f"{self.folder} holds no run; remove start.answers.toml and begin again")
        return f"{self.folder}/{runs[-1]}"

    def in_shell(self) -> str:
        """Return the words of a shell that find it."""
        return f'"{self.folder}/$(ls {shlex.quote(self.folder)} | LC_ALL=C sort | tail -n 1)"'


Word = str | Newest


@dataclass(frozen=True, slots=True)
class Command:
    """Command of `hil`.

    Attributes
    ----------
    words
        Its arguments.
    accepted
        Exit codes after which the course goes on.
    writes
        Text of what it writes to a real rig; None if it writes to none.
    beside
        Command that serves devices while this one runs, and the file that shows that it serves.
    """

    words: tuple[Word, ...]
    accepted: tuple[int, ...] = (0,)
    writes: str | None = None
    beside: tuple[tuple[str, ...], str] | None = None

    def in_shell(self) -> str:
        """Return lines of a shell script that does the same."""
        line = _line(self.words)
        if self.accepted != (0,):
            line += f" || [ $? -le {max(self.accepted)} ]"
        if self.writes is not None:
            ask = shlex.quote(f"The next command writes to the rig: {self.writes}. Type yes: ")
            line = f'read -r -p {ask} agreed && [ "$agreed" = yes ]\n{line}'
        if self.beside is not None:
            served, ready = self.beside
            line = (
                f"rm -f {ready}\n{_line(served)} &\nserved=$!\ntrap 'kill $served 2>/dev/null || true' EXIT\n"
                f"while [ ! -e {ready} ]; do kill -0 $served; sleep 0.2; done\n{line}\n"
                "kill $served\nwait $served || true\ntrap - EXIT"
            )
        return line

    def run(self, base: Path, say: Callable[[str], None]) -> int:
        """Run it in the folder `base`; return its exit code.

        Raises
        ------
        StopRequest
            A signal asked for the end; the command has got it, too, and has ended.
        """
        if self.beside is None:
            return _run(self.words, base, say)
        served, ready = self.beside
        (base / ready).unlink(missing_ok=True)
        say(f"$ {_line(served)} &")
        child = subprocess.Popen(_arguments(served, base), cwd=base, stdin=subprocess.DEVNULL)
        try:
            end = time.monotonic() + _SERVES_WITHIN_S
            while not (base / ready).exists():
                if child.poll() is not None or time.monotonic() > end:
                    return child.returncode or 2
                time.sleep(_POLL_S)
            return _run(self.words, base, say)
        finally:
            child.terminate()
            child.wait()


@dataclass(frozen=True, slots=True)
class FileAction:
    """File that the course writes."""

    name: str
    text: str

    def in_shell(self) -> str:
        """Return lines of a shell script that write it."""
        return f"cat > {self.name} <<'END_OF_FILE'\n{self.text}END_OF_FILE"

    def run(self, base: Path, say: Callable[[str], None]) -> int:
        """Write it; return 0."""
        with replacing(base / self.name) as unfinished:
            unfinished.write_text(self.text, encoding="utf-8")
        say(f"{self.name}: written")
        return 0


@dataclass(frozen=True, slots=True)
class Removal:
    """Files of this course that a command refuses to overwrite."""

    names: tuple[str, ...]

    def in_shell(self) -> str:
        """Return a line of a shell script that removes them."""
        return f"rm -f {' '.join(self.names)}"

    def run(self, base: Path, _say: Callable[[str], None]) -> int:
        """Remove them; return 0."""
        for name in self.names:
            (base / name).unlink(missing_ok=True)
        return 0


Action = Command | FileAction | Removal


def _line(words: tuple[Word, ...]) -> str:
    return " ".join(["hil", *(word.in_shell() if isinstance(word, Newest) else shlex.quote(word) for word in words)])


def _arguments(words: tuple[Word, ...], base: Path) -> list[str]:
    return [sys.executable, "-m", "hil", *(word.path(base) if isinstance(word, Newest) else word for word in words)]


def _run(words: tuple[Word, ...], base: Path, say: Callable[[str], None]) -> int:
    """Run a command of `hil` to its end, with the signals of this process handed on; return its exit code.

    A command gets Ctrl-C from the terminal as well; a run takes two that close for one. It makes the rig safe itself.
    """
    arguments = _arguments(words, base)
    say(f"$ {_line(words)}")
    asked: list[int] = []
    child: subprocess.Popen[bytes] | None = None

    def hand_on(number: int, _frame: FrameType | None) -> None:
        asked.append(number)
        if child is not None and child.poll() is None:
            child.send_signal(number)

    taken = [number for number in _FORWARDED if signal.getsignal(number) is not signal.SIG_IGN]  # nohup ignores some
    before: dict[int, Any] = {number: signal.signal(number, hand_on) for number in taken}
    try:
        child = subprocess.Popen(arguments, cwd=base, stdin=subprocess.DEVNULL)
        if asked:
            child.send_signal(asked[-1])
        code = child.wait()
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
    if asked:
        raise StopRequest(f"stopped by {signal.Signals(asked[0]).name} in this step", 1)
    return code
