"""Attacks of the chaos campaign on the control socket of a run."""

from __future__ import annotations

import asyncio
import contextlib
import json
import resource
import socket
import time
from pathlib import Path

from hil.bench.chaos.acts import Act, link_blip
from hil.bench.chaos.stage import ChaosStage
from hil.bench.measure import processes

LEAKED = 300
SPARE_DESCRIPTORS = 40
"""Free descriptors of a run whose connections leak: fewer than leak, more than a run needs."""
FLOOD_S = 2.0
REASONS = (
    "K\udcfchlung",
    "\udc80",
    "\ud83d",
    "a\x00b",
    "one\ntwo\rthree",
    "\ud800\udfff",
    "ä" * 4000,
    "\x1b[2J\x07",
    "{}[]\"'%s%n",
)
"""Odd reasons: lone surrogates of a Latin-1 terminal, NUL, line ends, a long text, terminal escapes."""
GARBAGE = (
    b"[" * 4000 + b"\n",
    b"\xff\xfe\n",
    b"{}\n",
    b"null\n",
    b'{"verb": 1e999}\n',
    b'{"verb": {"a": 1}}\n',
    b"x" * 100_000 + b"\n",
    b'{"verb": "abort", "reason": "' + b"y" * 1_000_000 + b'"}\n',
    b'{"verb":"status"',
    b"\n" * 5000,
    b'{"verb": "\\ud800"}\n',
    b'{"verb": "status", "reason": [[[]]]}\n',
    b"\x00" * 300,
)


def _connected(path: Path) -> socket.socket:
    client = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    client.settimeout(3.0)
    try:
        client.connect(str(path))
    except OSError:
        client.close()
        raise
    return client


def _say(path: Path, line: bytes) -> bytes:
    """Send a line and return the answer, "" if there is none."""
    with contextlib.suppress(OSError), _connected(path) as client:
        client.sendall(line)
        return client.recv(65536)
    return b""


def asked(verb: str) -> Act:
    """Return the act that requests `verb` with an odd reason."""

    async def act(stage: ChaosStage) -> None:
        line = json.dumps({"verb": verb, "reason": stage.generator.choice(REASONS)[:600]}).encode() + b"\n"
        await asyncio.to_thread(_say, stage.folder() / "control.sock", line)

    return act


async def garbage(stage: ChaosStage) -> None:
    """Send requests that no client sends."""
    lines = stage.generator.sample(GARBAGE, 6)

    def send() -> None:
        for line in lines:
            with contextlib.suppress(OSError), _connected(stage.folder() / "control.sock") as client:
                client.settimeout(0.3)
                client.sendall(line)
                client.recv(100)

    await asyncio.to_thread(send)


async def flood(stage: ChaosStage) -> None:
    """Request the status at the highest rate, and read no answer."""

    def send() -> None:
        with contextlib.suppress(OSError), _connected(stage.folder() / "control.sock") as client:
            client.settimeout(0.5)
            until = time.monotonic() + FLOOD_S
            while time.monotonic() < until:
                client.sendall(b'{"verb": "status"}\n' * 50)
                time.sleep(0.01)  # Leave processor time to the other processes.

    await asyncio.to_thread(send)


async def leaked(stage: ChaosStage) -> None:
    """Open connections and leave them open."""

    def connect() -> None:
        with contextlib.suppress(OSError):
            for _ in range(LEAKED):
                stage.leaks.append(_connected(stage.folder() / "control.sock"))

    await asyncio.to_thread(connect)


async def leaked_all(stage: ChaosStage) -> None:
    """Leak connections until the run has no descriptor left, then drop its link briefly."""
    opened = max(processes.descriptors(stage.pid))
    hard = resource.prlimit(stage.pid, resource.RLIMIT_NOFILE)[1]
    resource.prlimit(stage.pid, resource.RLIMIT_NOFILE, (opened + SPARE_DESCRIPTORS, hard))
    await leaked(stage)
    await link_blip(stage)
