"""Terminal of a run in the chaos campaign: two files, a pipe to a reader, or a pseudo-terminal.

All that a reader gets is kept in `err.txt`, as with files. The reader can stop reading, go away, or press Ctrl-S.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import os
import pty
import termios
import tty
from pathlib import Path
from typing import Literal

SMALL_PIPE_BYTES = 4096
"""Smallest pipe of Linux: a reader that stops takes effect after some 30 lines instead of 500."""
_SET_PIPE_SIZE = 1031

TerminalType = Literal["files", "pipe", "pty"]


class Terminal:
    """Standard output and error of a run; `out` and `err` are descriptors for the process."""

    def __init__(self, place: Path, shape: TerminalType) -> None:
        self.shape = shape
        self._log = os.open(place / "err.txt", os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        self._near: int | None = None
        self._far: int | None = None
        self._reading = False
        if shape == "files":
            self.err = self._log
            self.out = os.open(place / "out.txt", os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
            return
        if shape == "pipe":
            self._near, self._far = os.pipe()
            fcntl.fcntl(self._far, _SET_PIPE_SIZE, SMALL_PIPE_BYTES)
        else:
            self._near, self._far = pty.openpty()
            tty.setraw(self._far)
        self.out = self.err = self._far
        os.set_blocking(self._near, False)
        self._read_on()

    def started(self) -> None:
        """Close the descriptors of the process after its start; the end of a pty is kept for Ctrl-S."""
        if self.shape == "files":
            os.close(self.out)
        elif self.shape == "pipe" and self._far is not None:
            os.close(self._far)
            self._far = None

    def stop_reading(self) -> None:
        """Stop reading: the output fills the pipe and then blocks."""
        if self._reading and self._near is not None:
            asyncio.get_running_loop().remove_reader(self._near)
            self._reading = False

    def press_ctrl_s(self) -> None:
        """Stop the output of the pty as Ctrl-S does."""
        assert self._far is not None
        termios.tcflow(self._far, termios.TCOOFF)

    def let_go(self) -> None:
        """Continue reading, and start the output again as Ctrl-Q does; do nothing if the reader has gone."""
        if self.shape == "pty" and self._far is not None and self._near is not None:
            termios.tcflow(self._far, termios.TCOON)
        if self._near is not None and not self._reading:
            self._read_on()

    def hang_up(self) -> None:
        """Close the reader's end: the next write finds a broken pipe, or a terminal that is gone."""
        self.stop_reading()
        for name in ("_near", "_far"):
            handle = getattr(self, name)
            if handle is not None:
                os.close(handle)
                setattr(self, name, None)

    def close(self) -> None:
        """Close everything."""
        self.hang_up()
        with contextlib.suppress(OSError):
            os.close(self._log)

    def _read_on(self) -> None:
        assert self._near is not None
        asyncio.get_running_loop().add_reader(self._near, self._keep)
        self._reading = True

    def _keep(self) -> None:
        assert self._near is not None
        try:
            data = os.read(self._near, 65536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            os.write(self._log, data)
        else:
            self.stop_reading()
