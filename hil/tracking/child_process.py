"""A process of its own that talks over a pipe: started, listened to on the event loop, ended whatever it does."""

from __future__ import annotations

import asyncio
import multiprocessing
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any


class Child:
    """Runs ``serve(connection, config)`` in a fresh interpreter; it does not outlive this process."""

    def __init__(self, serve: Callable[[Connection, Any], None], config: object, name: str) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self._process: Any = context.Process(target=serve, args=(theirs, config), name=name, daemon=True)
        self._process.start()
        theirs.close()

    @property
    def pid(self) -> int:
        """Id of the process."""
        return int(self._process.pid)

    def listen(self, receive: Callable[[], None]) -> None:
        """Call `receive` on the running event loop whenever there is something on `connection`."""
        asyncio.get_running_loop().add_reader(self.connection.fileno(), receive)

    def ignore(self) -> None:
        """Listen no longer; harmless when repeated."""
        asyncio.get_running_loop().remove_reader(self.connection.fileno())

    async def end(self, grace_s: float = 0.0) -> None:
        """Close the pipe, wait up to `grace_s` for the process to end by itself, then kill it."""
        self.ignore()
        self.connection.close()
        if grace_s:
            await asyncio.to_thread(self._process.join, grace_s)
        if self._process.is_alive():
            self._process.kill()
        await asyncio.to_thread(self._process.join)
        self._process.close()
