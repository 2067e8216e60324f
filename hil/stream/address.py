"""Address of a store or server: its kind, host and port, the prefix of topics, and its form without the password."""

from __future__ import annotations

import hashlib
import os
import socket
from dataclasses import dataclass, field
from urllib.parse import SplitResult, unquote, urlsplit

from drivers.historian import without_password
from hil.files import safe_file_name
from hil.stream.errors import StoreDownError, StreamError

PORTS = {"mqtt": 1883, "mqtts": 8883}
"""Ports that IANA has for MQTT, plain and over TLS."""
SCHEMES = (*PORTS, "postgresql", "postgres", "opc.tcp")
SERVER = "opc.tcp"
SERVER_PORT = 4840
"""Port that IANA has for OPC UA."""
PASSWORD_VARIABLE = "HIL_MQTT_PASSWORD"
SERVER_PASSWORD_VARIABLE = "HIL_OPCUA_PASSWORD"
LONGEST_PREFIX = 65_535 - 1_024
"""Most bytes of a prefix: a topic has 65,535 (MQTT 5.0, 1.5.4), of which the names of run and signal need the rest."""
_LONGEST_NAME = 100
"""Bytes of an address that a file name repeats: room for the digest and the endings."""


@dataclass(frozen=True)
class Address:
    """Address of a store. `shown` is the address without a password, for messages and files.

    `url` is the address as given and `password` that of a broker; no message or file may repeat them. `host`, `port`,
    `prefix` and `user` are those of a broker and empty for a database, whose library reads them from the URL. An OPC UA
    server listens on `host` and `port`; `prefix` is the path of its endpoint.
    """

    scheme: str
    shown: str
    url: str = field(repr=False)
    host: str = ""
    port: int = 0
    prefix: str = ""
    user: str | None = None
    password: str | None = field(default=None, repr=False)

    @property
    def is_broker(self) -> bool:
        """Return True for MQTT."""
        return self.scheme in PORTS

    @property
    def is_server(self) -> bool:
        """Return True for OPC UA, where the stream itself is the server."""
        return self.scheme == SERVER

    @property
    def file_name(self) -> str:
        """Return a file name that belongs to this address alone, without an ending."""
        digest = hashlib.sha256(self.shown.encode("utf-8", "replace")).hexdigest()[:8]
        readable = "-".join(part for part in (self.scheme, self.host, str(self.port or ""), self.prefix) if part)
        return f"{safe_file_name(readable.replace('/', '_'), _LONGEST_NAME)}-{digest}"


def parse_address(text: str) -> Address:
    """Return the address that `text` states: `mqtt://[user@]host[:port]/PREFIX`, `mqtts://...`, `postgresql://...` or
    `opc.tcp://[user@]host[:port]/`.

    The password of a broker may be in the environment, in `HIL_MQTT_PASSWORD`, that of an OPC UA server in
    `HIL_OPCUA_PASSWORD`.

    Raises
    ------
    StreamError
        It is no such address.
    """
    scheme, found, _ = text.partition("://")
    if not found or scheme not in SCHEMES:
        named = f"{scheme}:// is no store that is known" if found else "an address begins with the kind of its store"
        raise StreamError(
            f"{named}; use mqtt://HOST/PREFIX, mqtts://HOST/PREFIX, postgresql://USER@HOST/DATABASE or "
            "opc.tcp://127.0.0.1:4840/"
        )
    if scheme == SERVER:
        return _server(text)
    if scheme not in PORTS:
        return Address(scheme, without_password(text), text)
    parts, port = _parts(text)
    prefix = unquote(parts.path).strip("/") or "hil"
    if len(prefix.encode("utf-8", "replace")) > LONGEST_PREFIX:
        raise StreamError(f"the prefix of topics has more than {LONGEST_PREFIX} bytes; shorten it")
    if prefix.startswith("$") or any(c in "+#" or not c.isprintable() for c in prefix):
        raise StreamError("the prefix of topics may not begin with $ nor hold +, # or control characters; rename it")
    host, user = parts.hostname or "", unquote(parts.username) if parts.username else None
    password = unquote(parts.password) if parts.password else os.environ.get(PASSWORD_VARIABLE)
    before = f"{user}@" if user else ""
    bracketed = f"[{host}]" if ":" in host else host
    shown = f"{scheme}://{before}{bracketed}:{port}/{prefix}"
    return Address(scheme, shown, text, host, port, prefix, user, password)


def _server(text: str) -> Address:
    """Return the address on which an OPC UA server listens; raises StreamError without repeating a password."""
    wrong = "the address of the server cannot be read: use opc.tcp://ADDRESS:PORT/ with an address of this machine"
    try:
        parts = urlsplit(text)
        port = SERVER_PORT if parts.port is None else parts.port
    except ValueError:
        raise StreamError(wrong) from None
    host, path = parts.hostname or "", unquote(parts.path).strip("/")
    if not host or any(c in text for c in "?#") or not path.isprintable():
        raise StreamError(wrong)
    user = unquote(parts.username) if parts.username else None
    password = unquote(parts.password) if parts.password else os.environ.get(SERVER_PASSWORD_VARIABLE)
    bracketed = f"[{host}]" if ":" in host else host
    return Address(SERVER, f"{SERVER}://{bracketed}:{port}/{path}", text, host, port, path, user, password)


def _parts(text: str) -> tuple[SplitResult, int]:
    """Return the parts of a broker's address and its port; raises StreamError without repeating a password."""
    wrong = (
        "the address of the broker cannot be read: use mqtt://HOST:PORT/PREFIX without ? and #; %40 is @ in a password"
    )
    try:
        parts = urlsplit(text)
        port = PORTS[parts.scheme] if parts.port is None else parts.port
    except ValueError:
        raise StreamError(wrong) from None
    if not parts.hostname or port == 0 or any(c in text for c in "?#"):
        raise StreamError(wrong)
    return parts, port


def require_known_host(host: str) -> None:
    """Check that the name of a host has an address.

    Raises
    ------
    StreamError
        There is no such host.
    StoreDownError
        The name service does not answer at present.
    """
    try:
        socket.getaddrinfo(host, None)
    except socket.gaierror as error:
        if error.errno == socket.EAI_AGAIN:
            raise StoreDownError(f"the name service does not answer for host {host!r}") from None
        raise StreamError(f"there is no host {host!r}; check the address") from None
    except UnicodeError:
        raise StreamError(f"{host!r} is no name of a host; check the address") from None
