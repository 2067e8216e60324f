"""Native Rerun viewer as a process of its own, on the loopback interface only."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

HOST = "127.0.0.1"
_START_TIMEOUT_S = 30.0
_CUT = (b"Missing RRD footer", b"couldn't decode")
"""Words of Rerun's check on a file with a hole or without an end."""


class ViewerError(RuntimeError):
    """Error of a viewer that did not start or gave no screenshot; the message states the reason and the remedy."""


@dataclass(slots=True)
class Viewer:
    """Running viewer: `url` takes a recording, `port` is its listener on 127.0.0.1."""

    process: subprocess.Popen[bytes]
    port: int
    _log: IO[bytes]

    @property
    def url(self) -> str:
        """Return the URL for a recording."""
        return f"rerun+http://{HOST}:{self.port}/proxy"

    @property
    def alive(self) -> bool:
        """Return True while its window (or its headless process) exists."""
        return self.process.poll() is None

    def wait(self) -> None:
        """Wait until the window is closed."""
        self.process.wait()
        self._log.close()

    def close(self) -> None:
        """End the viewer; harmless when it has ended by itself."""
        if self.alive:
            self.process.terminate()
        try:
            self.process.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._log.close()

    def last_words(self) -> str:
        """Return the line of its log with the reason of its end, or ""."""
        self._log.seek(0)
        lines = self._log.read().decode(errors="replace").splitlines()
        telling = [line.strip() for line in lines if "panicked" in line or "rror" in line or "adapter" in line]
        return telling[-1] if telling else ""


def has_display() -> bool:
    """Return True if a window can be opened on this machine."""
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def binary() -> Path:
    """Return the path of the viewer's own executable.

    Not the `rerun` command of the environment, a Python wrapper: ending that one leaves the viewer behind.
    """
    spec = importlib.util.find_spec("rerun_cli")
    if spec is None or spec.origin is None:
        raise ViewerError("the Rerun viewer is not installed; install rerun-sdk")
    return Path(spec.origin).with_name("rerun.exe" if sys.platform == "win32" else "rerun")


def require_complete(rrd: Path) -> None:
    """Raise OSError if a Rerun file lacks some of what was sent to it: Rerun reports no failed write, as on a full
    disk."""
    command = [str(binary()), "rrd", "verify", str(rrd)]
    done = subprocess.run(
        command, env=os.environ | {"CI": "true"}, stdin=subprocess.DEVNULL, capture_output=True, check=False
    )
    # It also finds fault with the states of a lane that end, which its viewer shows.
    if done.returncode != 0 and any(words in done.stderr for words in _CUT):
        raise OSError("Rerun could not write all of it: make room on the disk")


def open_viewer(
    *,
    headless: bool = False,
    port: int | None = None,
    files: Sequence[Path] = (),
    size: tuple[int, int] = (1600, 1000),
) -> Viewer:
    """Start a viewer on a free port (or `port`) and wait until it listens; raises ViewerError.

    The viewer outlives this process unless it is closed.
    """
    chosen = _free_port() if port is None else port
    command = [str(binary()), "--bind", HOST, "--port", str(chosen), "--hide-welcome-screen"]
    command += ["--window-size", f"{size[0]}x{size[1]}", *(["--headless"] if headless else []), *map(str, files)]
    # Owned by Viewer, which closes it. CI=true disables the viewer's usage reports.
    log = tempfile.TemporaryFile()  # noqa: SIM115
    process = subprocess.Popen(
        command,
        env={**os.environ, "CI": "true"},
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=log,
        start_new_session=True,
    )
    viewer = Viewer(process, chosen, log)
    deadline = time.monotonic() + _START_TIMEOUT_S
    while not listens(chosen):
        if not viewer.alive or time.monotonic() > deadline:
            why = viewer.last_words()
            viewer.close()
            raise ViewerError(f"the Rerun viewer did not start ({why or 'no reason given'})")
        time.sleep(0.05)
    return viewer


def listens(port: int) -> bool:
    """Return True if a server accepts connections on `port` of the loopback interface."""
    with contextlib.suppress(OSError), socket.create_connection((HOST, port), timeout=1.0):
        return True
    return False


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])
