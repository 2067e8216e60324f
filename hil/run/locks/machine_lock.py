"""Names that only one process of a machine can have: abstract Unix sockets (Linux, `man 7 unix`).

Such a name is in no file system, so it does not depend on user, home, TMPDIR or mount namespace. The kernel frees it
with the process. Any user sees it, and another user who takes it first can only keep a run from starting. It does not
reach beyond its network namespace: containers with a network of their own do not see each other's names.
"""

from __future__ import annotations

import contextlib
import errno
import socket
import struct
import sys
from dataclasses import dataclass

_TRIES = 3
"""A name may be freed between the refusal and the question who has it; then it is tried again."""
_BACKLOG = 128
"""Connections that nobody accepts: each refused run leaves one, and a full queue only hides who holds the name."""


@dataclass(frozen=True, slots=True)
class Peer:
    """Process that has a name. `pid` is 0 where it is in another process namespace; None where it is not known."""

    pid: int | None = None
    uid: int | None = None


def take_name(name: str) -> socket.socket | Peer | None:
    """Return a socket that holds `name` until it is closed, or the process that has it; None where there are no such
    names on this system. Raises OSError.
    """
    if sys.platform != "linux":
        return None
    peer = None
    for _ in range(_TRIES):
        holder = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            holder.bind(f"\0{name}")
            holder.listen(_BACKLOG)
        except OSError as error:
            holder.close()
            if error.errno != errno.EADDRINUSE:
                raise
        else:
            return holder
        peer = _peer(name)
        if peer is not None:
            break
    return Peer() if peer is None else peer


def _peer(name: str) -> Peer | None:
    """Return the process that listens on `name`; None where there is none any more, or its queue is full."""
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.setblocking(False)
        asking.connect(f"\0{name}")
        credentials = struct.Struct("3i")  # struct ucred: pid, uid, gid
        pid, uid, _ = credentials.unpack(asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, credentials.size))
        return Peer(pid, uid)
    return None
