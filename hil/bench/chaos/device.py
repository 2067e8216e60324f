"""Modbus device that disobeys, and a second master on the same rig.

`LyingDevice` relays between the harness and the virtual rig and alters requests and replies. Register addresses are
those of `drivers.virtual.devices.registers`. The relay also notes when a heartbeat passed, which the verdict asks for.
"""

from __future__ import annotations

import asyncio
import contextlib
import struct
import time
from typing import Literal, Self

from drivers.virtual.devices import HEARTBEAT, HEATER_SET

HOST = "127.0.0.1"
DELAY_S = 3.0
"""Delay after which a slow device applies a heater set-point, s: longer than the limit on the time to safe."""
_WRITE_ONE, _WRITE_MANY, _READ_HOLDING = 6, 16, 3

Mode = Literal["honest", "echo", "lie", "delay", "deaf"]
"""Modes: `echo` acknowledges a heater set-point and does not apply it; `lie` also reads it back as written; `delay`
applies it `DELAY_S` later; `deaf` acknowledges heartbeats and does not apply them.
"""


class LyingDevice:
    """Relay on `port` to the Modbus server on `target`, transparent until `mode` is changed."""

    def __init__(self, target: int) -> None:
        self.target = target
        self.port = 0
        self.mode: Mode = "honest"
        self.beats: list[float] = []
        """Wall times of heartbeats that changed, s."""
        self._held: dict[int, int] = {}
        self._asked: int | None = None
        self._beat: int | None = None
        self._server: asyncio.Server | None = None
        self._tasks: set[asyncio.Task[None]] = set()

    async def __aenter__(self) -> Self:
        self._server = await asyncio.start_server(self._serve, HOST, 0)
        self.port = int(self._server.sockets[0].getsockname()[1])
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._server is not None
        self._server.close()
        tasks = list(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        far: asyncio.StreamWriter | None = None
        try:
            far_reader, far = await asyncio.open_connection(HOST, self.target)
            while True:
                head, pdu = await _frame(reader)
                far.write(head + self._altered(head, pdu))
                reply_head, reply = await _frame(far_reader)
                writer.write(reply_head + self._reply(pdu, reply))
                await writer.drain()
        except (asyncio.IncompleteReadError, OSError, asyncio.CancelledError):
            pass
        finally:
            self._tasks.discard(task)
            for end in (writer, far):
                if end is not None:
                    end.transport.abort()

    def _altered(self, head: bytes, body: bytes) -> bytes:
        """Return the altered request; `body` is unit, function code and data."""
        places = _written(body)
        changed = bytearray(body)
        for register, at in places.items():
            (value,) = struct.unpack_from(">H", body, at)
            if register == HEARTBEAT and value != self._beat:
                self._beat = value
                self.beats.append(time.time())
            if self._swallows(register) and register in self._held:
                struct.pack_into(">H", changed, at, self._held[register])
                if register == HEATER_SET:
                    self._asked = value
                    if self.mode == "delay":
                        later = asyncio.create_task(self._apply_later(head[:4], body[0], value))
                        self._tasks.add(later)
                        later.add_done_callback(self._tasks.discard)
            else:
                self._held[register] = value
        return bytes(changed)

    def _swallows(self, register: int) -> bool:
        if register == HEATER_SET:
            return self.mode in ("echo", "lie", "delay")
        return register == HEARTBEAT and self.mode == "deaf"

    def _reply(self, asked: bytes, reply: bytes) -> bytes:
        """Return the altered reply."""
        if reply[1] & 0x80 or self.mode == "honest":
            return reply
        if asked[1] == _WRITE_ONE:
            return asked[:6]
        if self.mode == "lie" and asked[1] == _READ_HOLDING and self._asked is not None:
            first, count = struct.unpack_from(">HH", asked, 2)
            if first <= HEATER_SET < first + count:
                changed = bytearray(reply)
                struct.pack_into(">H", changed, 3 + 2 * (HEATER_SET - first), self._asked)
                return bytes(changed)
        return reply

    async def _apply_later(self, transaction: bytes, unit: int, value: int) -> None:
        await asyncio.sleep(DELAY_S)
        self._held[HEATER_SET] = value
        with contextlib.suppress(OSError, asyncio.IncompleteReadError):
            await write_register(self.target, HEATER_SET, value, unit=unit)


async def _frame(reader: asyncio.StreamReader) -> tuple[bytes, bytes]:
    head = await reader.readexactly(6)
    return head, await reader.readexactly(struct.unpack(">H", head[4:])[0])


def _written(body: bytes) -> dict[int, int]:
    """Return the registers that a request writes, each with the place of its value in `body`."""
    if body[1] == _WRITE_ONE:
        return {struct.unpack_from(">H", body, 2)[0]: 4}
    if body[1] == _WRITE_MANY:
        first, count = struct.unpack_from(">HH", body, 2)
        return {first + k: 7 + 2 * k for k in range(count)}
    return {}


async def write_register(port: int, register: int, value: int, *, unit: int = 1) -> None:
    """Write one holding register over its own connection, as another master does; raise OSError."""
    reader, writer = await asyncio.open_connection(HOST, port)
    try:
        writer.write(struct.pack(">HHHBBHH", 1, 0, 6, unit, _WRITE_ONE, register, value))
        await reader.readexactly(12)
    finally:
        writer.close()
