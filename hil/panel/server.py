"""Server of the panel: address, TLS, and the uvicorn that serves it until it is interrupted."""

from __future__ import annotations

import asyncio
import importlib.util
import ipaddress
import logging
import os
import re
import socket
import ssl
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.panel.errors import PanelError

MOST_CONNECTIONS = 256
"""Connections at a time: viewers, with some to spare for their other requests."""

SEND_BUFFER = 65_536
"""Bytes that the kernel keeps for a viewer: some ten states. It grows to megabytes by itself, and would hide for many
minutes that a viewer stalls."""

HANDSHAKE_S = 5.0
"""Longest time for a TLS handshake, and for its end, s: two round trips of 0.6 s by satellite, and the first two
repetitions of a lost packet (1 s and 2 s, RFC 6298). asyncio alone would keep a silent connection for 60 s."""


class _Loop(asyncio.SelectorEventLoop):
    """Event loop whose servers end a TLS handshake that is not complete in time: uvicorn has no option for it."""

    async def create_server(self, *arguments: Any, **options: Any) -> asyncio.Server:
        if options.get("ssl") is not None:
            options |= {"ssl_handshake_timeout": HANDSHAKE_S, "ssl_shutdown_timeout": HANDSHAKE_S}
        return await super().create_server(*arguments, **options)


@dataclass(frozen=True, slots=True)
class ServeOptions:
    """Options of a panel: address, port (0 for a free one), certificate and key, further names of the machine."""

    host: str = "127.0.0.1"
    port: int = 8765
    certificate: Path | None = None
    key: Path | None = None
    names: tuple[str, ...] = ()


def serve(folder: Path, options: ServeOptions, announce: Callable[[str], None]) -> None:
    """Serve the panel of the runs in `folder` until Ctrl-C; `announce` gets its address, which has the token.

    Parameters
    ----------
    folder
        A run folder, or a folder of runs.
    options
        Address, TLS, names.
    announce
        Function for the address once the panel listens.

    Raises
    ------
    PanelError
        The folder is none, a package or a certificate is missing, the address is open without TLS, or the port is
        in use.
    """
    for package in ("starlette", "uvicorn"):
        if importlib.util.find_spec(package) is None:
            raise PanelError(
                f"the panel needs the package {package}, which is not installed; pip install 'hil-rig[panel]'"
            )
    _require_folder(folder)
    names = _names(options)
    _require_tls(options)
    import uvicorn

    from hil.panel.access import Access
    from hil.panel.app import Panel
    from hil.panel.connection import Connection

    listener = _listener(options)
    try:
        port = listener.getsockname()[1]
        access = Access(names, port, secure=options.certificate is not None)
        config = uvicorn.Config(
            Panel(folder, access).application(),
            log_level="error",  # defects; a line for each request would repeat the token
            access_log=False,
            http=Connection,
            limit_concurrency=MOST_CONNECTIONS,
            server_header=False,
            proxy_headers=False,
            ws="none",
            lifespan="on",
            timeout_graceful_shutdown=1,
            ssl_certfile=None if options.certificate is None else os.fspath(options.certificate),
            ssl_keyfile=None if options.key is None else os.fspath(options.key),
        )
        logging.getLogger("uvicorn.error").addFilter(_is_a_defect)
        scheme = "http" if options.certificate is None else "https"
        announce(f"{scheme}://{access.names[0]}:{port}/?token={access.token}")
        with asyncio.Runner(loop_factory=_Loop) as runner:
            runner.run(uvicorn.Server(config).serve(sockets=[listener]))
    finally:
        listener.close()


def _is_a_defect(record: logging.LogRecord) -> bool:
    """Return False for the line of uvicorn on a viewer that was dropped because it stalled."""
    return "without completing response" not in record.getMessage()


def _require_folder(folder: Path) -> None:
    if not folder.is_dir():
        raise PanelError(f"{folder} is no folder; give a run folder, or the folder of your runs")


def _names(options: ServeOptions) -> list[str]:
    """Return the names that browsers may use; raises PanelError where there is none."""
    for name in options.names:
        if not re.fullmatch(r"[A-Za-z0-9._-]+|[0-9A-Fa-f:.]+", name):
            raise PanelError(f"{name[:80]!r} is no name of a machine; give it alone, as rig.example.org, with --name")
    try:
        address = ipaddress.ip_address(options.host)
    except ValueError:
        if options.host != "localhost":
            raise PanelError(
                f"{options.host[:80]!r} is no address of this machine; give an IP address with --host and "
                "the names that browsers use with --name"
            ) from None
        return ["localhost", *options.names]
    if address.is_loopback:
        return [options.host, "localhost", *options.names]
    if options.certificate is None or options.key is None:
        raise PanelError(
            f"{options.host} can be reached from other machines, and that needs TLS; add --cert and --key, or "
            "leave out --host"
        )
    if address.is_unspecified and not options.names:
        raise PanelError(f"{options.host} is every address of this machine; add --name with the one that browsers use")
    return [*options.names, *(() if address.is_unspecified else (options.host,))]


def _require_tls(options: ServeOptions) -> None:
    """Check certificate and key before anything listens; raises PanelError."""
    if (options.certificate is None) != (options.key is None):
        raise PanelError("a certificate and its key belong together; give both --cert and --key")
    if options.certificate is None or options.key is None:
        return
    for what, path in (("certificate", options.certificate), ("key", options.key)):
        if not path.is_file():
            raise PanelError(f"there is no {what} {path}; give a file in PEM form")
    try:
        # A key with a passphrase would ask for it in the terminal; an empty one makes it fail instead.
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(options.certificate, options.key, password="")
    except (ssl.SSLError, OSError) as error:
        if not _is_open(options.key):
            raise PanelError(
                f"the key {options.key} has a passphrase; give one without, readable by you alone"
            ) from None
        reason = getattr(error, "reason", None) or getattr(error, "strerror", None) or "unreadable"
        raise PanelError(
            f"{options.certificate} and {options.key} are no certificate and its key in PEM form "
            f"({str(reason).lower().replace('_', ' ')})"
        ) from None


def _is_open(key: Path) -> bool:
    """Return False for a key in PEM form that a passphrase locks."""
    try:
        text = key.read_bytes()
    except OSError:
        return True
    return b"ENCRYPTED PRIVATE KEY" not in text and b"Proc-Type: 4,ENCRYPTED" not in text


def _listener(options: ServeOptions) -> socket.socket:
    """Return the listening socket; raises PanelError where the port cannot be had."""
    family = socket.AF_INET6 if ":" in options.host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        listener.bind((options.host, options.port))
        listener.listen(128)
    except OSError as error:
        listener.close()
        raise PanelError(
            f"port {options.port} of {options.host} cannot be had ({error.strerror}); give another one with --port"
        ) from None
    return listener
