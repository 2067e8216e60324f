"""Addresses behind the name of a host, so that two spellings of one host are recognised as one.

A rig file may call a host `localhost`, `127.0.0.1`, `127.1`, `::1` or `::ffff:127.0.0.1`, by its DNS name in any case,
or by an address of one of its interfaces.
"""

from __future__ import annotations

import ipaddress
import socket

_DISCARD = 9
"""Port that `is_own` connects a datagram socket to (discard, RFC 863). Connecting it sends nothing."""


def addresses(host: str) -> tuple[str, ...]:
    """Return every IP address of `host` in canonical text, sorted; its folded name where nothing resolves it.

    IPv4 addresses mapped into IPv6 are returned as IPv4. A link-local IPv6 address keeps its zone as a number, since
    the same address on two interfaces is two hosts. May wait for a name server; never raises.
    """
    name = host.strip().strip("[]").rstrip(".").lower()
    try:
        found = socket.getaddrinfo(name, None, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):
        return (name,)
    return tuple(sorted({_canonical(info[4]) for info in found}))


def _canonical(endpoint: tuple[object, ...]) -> str:
    """Return the text of a socket's address, without its port."""
    text = str(endpoint[0]).partition("%")[0]
    address = ipaddress.ip_address(text)
    if isinstance(address, ipaddress.IPv6Address):
        if address.ipv4_mapped is not None:
            return str(address.ipv4_mapped)
        if len(endpoint) > 3 and endpoint[3]:
            return f"{address}%{endpoint[3]}"
    return str(address)


def is_own(address: str) -> bool:
    """Return True where `address` (one that `addresses` returns) reaches this machine itself.

    Loopback and unspecified addresses are this machine's by definition. For any other the kernel is asked: a datagram
    socket that is connected to an own address gets the same address as its source. Nothing is sent. Binding to the
    address would be no proof, since `net.ipv4.ip_nonlocal_bind` allows it for foreign addresses.
    """
    text, _, zone = address.partition("%")
    try:
        found = ipaddress.ip_address(text)
    except ValueError:
        return False
    if found.is_loopback or found.is_unspecified:
        return True
    family = socket.AF_INET if found.version == 4 else socket.AF_INET6
    target = (text, _DISCARD) if found.version == 4 else (text, _DISCARD, 0, int(zone or 0))
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.connect(target)
            return str(probe.getsockname()[0]).partition("%")[0] == text
    except OSError:
        return False
