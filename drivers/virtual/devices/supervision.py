"""Supervision of the rig's processes: listening, readiness lines on stdout, and ending with the parent."""

import asyncio
import contextlib
import errno
import json
import os
import signal
import ssl
import sys
from collections.abc import Callable
from typing import Any

EXIT_PORT_IN_USE = 3
PARENT_CHECK_S = 1.0


def say(**fields: Any) -> None:
    """Send one JSON line to the parent."""
    # A parent that closed its end is noticed by the stdin watch.
    with contextlib.suppress(OSError):
        print(json.dumps(fields), flush=True)


async def listen(
    factory: Callable[[], asyncio.BaseProtocol], host: str, port: int, what: str, tls: ssl.SSLContext | None = None
) -> asyncio.Server:
    """Return a server.

    Parameters
    ----------
    factory
        Makes the protocol of a connection.
    host, port
        Address to listen on; port 0 is any free one.
    what
        Name of the port in the message.
    tls
        Context for connections over TLS.

    Raises
    ------
    SystemExit
        The port cannot be opened; the parent gets a sentence about it.
    """
    try:
        return await asyncio.get_running_loop().create_server(factory, host, port, ssl=tls, reuse_address=True)
    except OSError as error:
        reason = "is in use" if error.errno == errno.EADDRINUSE else f"cannot be opened ({error.strerror or error})"
        raise port_refused(what, host, port, reason, error.errno) from error


def port_refused(what: str, host: str, port: int, reason: str, number: int | None) -> SystemExit:
    """Report a port that cannot be opened to the parent; return the exit of this process. `number` is of `errno`."""
    say(event="error", errno=number, port=port, message=f"{what} port {host}:{port} {reason}; choose another.")
    return SystemExit(EXIT_PORT_IN_USE)


def port_of(server: asyncio.Server) -> int:
    """Return the port of a server."""
    return int(server.sockets[0].getsockname()[1])


def end_with_parent(stop: asyncio.Event) -> None:
    """Set `stop` on SIGTERM or SIGINT, when stdin reaches its end, or when the parent process changed.

    Both signs are needed: stdin is a pipe that a dying parent closes, but its other children may hold it open.
    """
    loop = asyncio.get_running_loop()
    parent = os.getppid()

    def on_stdin() -> None:
        if not os.read(sys.stdin.fileno(), 4096):
            loop.remove_reader(sys.stdin.fileno())
            stop.set()

    def check() -> None:
        if os.getppid() != parent:
            stop.set()
        elif not stop.is_set():
            loop.call_later(PARENT_CHECK_S, check)

    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    # A file or /dev/null as stdin cannot be watched, and never ends.
    with contextlib.suppress(PermissionError):
        loop.add_reader(sys.stdin.fileno(), on_stdin)
    loop.call_later(PARENT_CHECK_S, check)
