"""A process of its own that talks over a pipe: started, listened to on the event loop, ended whatever it does."""

from __future__ import annotations

import asyncio
import contextlib
import math
import multiprocessing
import os
import queue
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any


class Sender:
    """Thread that sends objects over a pipe in their order: a process that does not read keeps nobody else waiting.

    `failed` is called in that thread with the reason where the pipe is gone.
    """

    def __init__(self, connection: Connection, failed: Callable[[str], object]) -> None:
        self._queue: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._connection = connection
        self._failed = failed
        threading.Thread(target=self._work, name="blocks for the calibrators", daemon=True).start()

    def put(self, item: Any) -> None:
        """Have `item` sent; returns at once."""
        self._queue.put((item,))

    def end(self) -> None:
        """Let the thread end when all is sent."""
        self._queue.put(())

    def _work(self) -> None:
        while packed := self._queue.get():
            try:
                self._connection.send(*packed)
            except Exception as error:  # a pipe that was closed meanwhile raises errors of several types
                with contextlib.suppress(RuntimeError):  # the loop is gone with the run
                    self._failed(str(error) or type(error).__name__)
                return


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

    def work_s(self) -> float:
        """Return the processor time that the process has had, s; NaN where the system does not say."""
        try:
            with open(f"/proc/{self.pid}/stat", encoding="ascii", errors="replace") as file:
                fields = file.read().rpartition(")")[2].split()
        except OSError:
            return math.nan
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def kill(self) -> None:
        """Kill the process; a stopped one, too."""
        if self._process.is_alive():
            self._process.kill()

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
