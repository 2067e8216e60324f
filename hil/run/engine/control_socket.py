"""Control socket: a live run listens on it to `hil ctl`; with the client's half.

A Unix socket in the run folder, mode 0600: who may write to the folder's owner's files may steer the run, nobody else
and nobody from another machine. One JSON object a line, asked and answered: `{"verb": "pause", "reason": "..."}` and
`{"ok": true, "text": "...", "status": {...}}`. `verb` is one of `hil.run.engine.operator.Verb`, or `status`.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import os
import socket
import struct
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hil.files import parse_json, plain
from hil.run.engine.engine import Engine
from hil.run.engine.operator import RefusedError, Verb
from hil.run.engine.status import Status

LONGEST_LINE = 4096
ANSWER_WITHIN_S = 20.0
"""Bytes of a request at most, and longest wait of a client for its answer, s."""
LATE_S = 15.0
"""A request that was not obeyed for so long is answered all the same, s: less than a client waits for its answer."""
MOST_CLIENTS = 16
"""Connections at a time: whoever forgets to close theirs must not use up this process's descriptors."""
IDLE_S = 30.0
LONGEST_REASON = 200
"""Time after which an idle connection is closed, s, and characters of a reason at most."""


class ControlError(Exception):
    """There is no live run to talk to; the message says where one was looked for."""


@contextlib.contextmanager
def _short(path: Path) -> Iterator[str]:
    """Yield the socket's address by way of its open folder: an address may have 107 bytes at most."""
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{folder}/{path.name}"
    finally:
        os.close(folder)


@contextlib.asynccontextmanager
async def serving(path: Path, engine: Engine, announce: Callable[[str], None]) -> AsyncIterator[None]:
    """Listen at `path` for as long as the block lasts; where that cannot be, say so and let the run go on without."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    talks: set[asyncio.Task[None]] = set()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        if len(talks) >= MOST_CLIENTS:
            writer.close()
            return
        talks.add(task)
        try:
            await _talk(engine, reader, writer)
        except asyncio.CancelledError:
            pass  # the run is over; asyncio would print a connection's cancelled task
        finally:
            talks.discard(task)
            writer.close()

    try:
        with _short(path) as address:
            listener.bind(address)
            os.chmod(address, 0o600)  # before it listens: nobody can have connected yet
        server = await asyncio.start_unix_server(serve, sock=listener, limit=LONGEST_LINE)
    except OSError as error:
        listener.close()
        announce(f"`hil ctl` cannot reach this run ({path}: {error}); Ctrl-C ends it all the same")
        yield
        return
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            os.unlink(path)
        server.close()
        # What was asked last is answered still.
        if talks:
            _, late = await asyncio.wait(talks, timeout=0.2)
            for task in late:
                task.cancel()
            await asyncio.gather(*late, return_exceptions=True)


async def _talk(engine: Engine, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Answer line by line until the client goes, or says nothing for `IDLE_S`."""
    with contextlib.suppress(OSError, ValueError, TimeoutError):
        while line := await _next_line(reader):
            writer.write(json.dumps(await _answer(engine, line), allow_nan=False).encode() + b"\n")
            await writer.drain()


async def _next_line(reader: asyncio.StreamReader) -> bytes:
    # Python 3.11's wait_for loses a cancellation that comes together with a line.
    async with asyncio.timeout(IDLE_S):
        return await reader.readline()


async def _answer(engine: Engine, line: bytes) -> dict[str, Any]:
    try:
        asked = parse_json(line)
        verb = asked["verb"]
        reason = plain(str(asked.get("reason") or "by an operator (hil ctl)"), LONGEST_REASON).replace("\n", " ")
        text = str(engine.state) if verb == "status" else await _obeyed(engine, Verb(verb), reason)
    except RefusedError as error:
        return {"ok": False, "text": str(error), "status": document(engine.status())}
    except (ValueError, TypeError, KeyError, AttributeError):
        verbs = ", ".join(["status", *Verb])
        return {"ok": False, "text": f"not understood; send one JSON object a line, with verb one of {verbs}"}
    return {"ok": True, "text": text, "status": document(engine.status())}


async def _obeyed(engine: Engine, verb: Verb, reason: str) -> str:
    """Return what came of a request, or after `LATE_S` that it waits for the next tick of a slow rig."""
    asked = asyncio.ensure_future(engine.ask(verb, reason))
    done, _ = await asyncio.wait({asked}, timeout=LATE_S)
    if done:
        return asked.result()
    asked.add_done_callback(lambda late: late.cancelled() or late.exception())  # nobody waits for it any more
    return f"{verb} was asked for and takes effect on the next tick of this slow rig; `hil ctl status` shows when"


def document(status: Status) -> dict[str, Any]:
    """Return a status as JSON has it: an unknown value is null."""
    plain = asdict(status)
    for key in ("values", "setpoints"):
        plain[key] = {name: value if math.isfinite(value) else None for name, value in plain[key].items()}
    return plain


def ask(path: Path, verb: str, reason: str = "") -> dict[str, Any]:
    """Return the answer of the run that listens at `path`; raises ControlError where none does."""
    if path.is_symlink():
        raise ControlError(f"{path} is a link, and a run listens in its own folder only; take the link away")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
        client.settimeout(ANSWER_WITHIN_S)
        try:
            with _short(path) as address:
                client.connect(address)
            # Four times as much as is kept, since control characters are taken out of it there.
            client.sendall(json.dumps({"verb": verb, "reason": reason[: 4 * LONGEST_REASON]}).encode() + b"\n")
            with client.makefile("rb") as lines:
                line = lines.readline()
        except TimeoutError:
            raise ControlError(
                f"{path.parent}: the run does not answer within {ANSWER_WITHIN_S:g} s; if its process hangs, its "
                f"guardian has made the rig safe (see guardian.log): `kill -9 {_listener(client)}`, then `hil resume` "
                "goes on with it"
            ) from None
        except OSError as error:
            raise ControlError(
                f"{path.parent} is no live run ({error.strerror}); `hil run` starts one, "
                "`hil resume` goes on with one that was cut"
            ) from None
    if not line:
        raise ControlError(f"{path.parent}: the run ended before it answered")
    answer: dict[str, Any] = parse_json(line)
    return answer


def _listener(client: socket.socket) -> int:
    """Return the id of the process that listens at the other end of `client`."""
    return int(struct.unpack("3i", client.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))[0])


def live_runs(runs: Path) -> list[Path]:
    """Return the folders under `runs` whose run listens."""
    found = []
    for path in sorted(runs.glob("*/control.sock")):
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client, contextlib.suppress(OSError):
            with _short(path) as address:
                client.connect(address)
            found.append(path.parent)
    return found
