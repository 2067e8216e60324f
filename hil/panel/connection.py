"""Connections of browsers: a request that is not complete in time ends its connection, and the oldest makes room."""

from __future__ import annotations

import asyncio
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

UNFINISHED_S = 10.0
"""Time for head and body of a request together, s: at most 16 KiB, also over a slow link."""


class Connection(H11Protocol):
    """One connection. Until a request is complete, it counts as waiting, and is closed after `UNFINISHED_S`.

    With all connections taken, a new one closes the one that has waited longest: idle ones lock nobody out.
    """

    _due: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        """Begin, and make room."""
        super().connection_made(transport)
        if self.limit_concurrency is not None and len(self.connections) >= self.limit_concurrency:
            waiting = [one for one in self.connections if isinstance(one, Connection) and one._due is not None]
            if waiting:
                oldest = min(waiting, key=lambda one: one._due.when() if one._due is not None else 0.0)
                self.connections.discard(oldest)
                oldest.transport.abort()
        self._due = self.loop.call_later(UNFINISHED_S, self._too_late)

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        self._stop()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take bytes of a request, and time it until it is complete."""
        super().data_received(data)
        if self.conn.their_state not in (h11.IDLE, h11.SEND_BODY):
            self._stop()
        elif self._due is None and not self.transport.is_closing():
            self._due = self.loop.call_later(UNFINISHED_S, self._too_late)

    def _stop(self) -> None:
        if self._due is not None:
            self._due.cancel()
            self._due = None

    def _too_late(self) -> None:
        self._due = None
        self.connections.discard(self)
        self.transport.abort()
