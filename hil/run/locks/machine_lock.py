"""Machine-wide locks by name: abstract Unix sockets, which only one process can bind (Linux, `man 7 unix`).

Such a name is in no file system and therefore independent of user, home, TMPDIR and mount namespace. The kernel frees
it with the process. All users see it, and another user who takes it first can only prevent the start of a run. A name
is not visible beyond its network namespace: containers with a network of their own do not share names.
"""

from __future__ import annotations

import contextlib
import errno
import socket
import struct
import sys
from dataclasses import dataclass

_TRIES = 3
"""Attempts to take a name: it may be freed between the refusal and the query of its holder."""
_BACKLOG = 128
"""Length of the queue of connections, which nobody accepts: each refused run adds one. A full queue hides the
holder."""


@dataclass(frozen=True, slots=True)
class NameHolder:
    """Process that holds a name. `pid` is 0 where it is in another process namespace; None where it is not known."""

    pid: int | None = None
    uid: int | None = None


def take_name(name: str) -> socket.socket | NameHolder | None:
    """Return a socket that holds `name` until it is closed, or the process that holds it already.

    Systems without such names give None.

    Raises
    ------
    OSError
        The socket cannot be made or bound.
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
    return NameHolder() if peer is None else peer


def _peer(name: str) -> NameHolder | None:
    """Return the process that listens on `name`; None where there is none, or its queue is full."""
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.setblocking(False)
        asking.connect(f"\0{name}")
        credentials = struct.Struct("3i")  # struct ucred: pid, uid, gid
        pid, uid, _ = credentials.unpack(asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, credentials.size))
        return NameHolder(pid, uid)
    return None
