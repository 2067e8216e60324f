"""A Modbus/TCP server that misbehaves on request, written on raw sockets so that it shares nothing with the driver."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Callable
from typing import Self

Answer = Callable[["FaultyServer", int, int, bytes], bytes | None]


def correct(server: FaultyServer, tid: int, unit: int, pdu: bytes) -> bytes:
    """What an honest device answers; register n of a table holds `server.registers[n]`."""
    code, address, count = struct.unpack(">BHH", pdu[:5])
    if code in (3, 4):
        values = [server.registers.get(address + i, 0) for i in range(count)]
        return struct.pack(f">BB{count}H", code, 2 * count, *values)
    if code == 6:
        server.registers[address] = count
        server.written.append((address, [count]))
        return pdu[:5]
    values = list(struct.unpack(f">{count}H", pdu[6 : 6 + 2 * count]))
    server.written.append((address, values))
    server.registers.update({address + i: value for i, value in enumerate(values)})
    return pdu[:5]


class FaultyServer:
    """Answers as `behaviour` says; every connection is counted."""

    def __init__(self, behaviour: Answer = correct) -> None:
        self.behaviour = behaviour
        self.registers: dict[int, int] = {}
        self.written: list[tuple[int, list[int]]] = []
        self.connections = 0
        self.delay_s = 0.0
        self.port = 0
        self._server: asyncio.Server | None = None
        self._writers: set[asyncio.StreamWriter] = set()
        self._tasks: set[asyncio.Task[None]] = set()

    async def __aenter__(self) -> Self:
        await self.start()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.stop()

    async def start(self) -> None:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", self.port)
        self.port = self._server.sockets[0].getsockname()[1]

    async def stop(self) -> None:
        """Close the port and every connection, as a gateway that reboots."""
        assert self._server is not None
        self._server.close()
        self.drop()
        await self._server.wait_closed()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def drop(self) -> None:
        """Reset every connection."""
        for writer in list(self._writers):
            writer.transport.abort()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        self._writers.add(writer)
        try:
            while True:
                tid, _, length, unit = struct.unpack(">HHHB", await reader.readexactly(7))
                pdu = await reader.readexactly(length - 1)
                if self.delay_s:
                    await asyncio.sleep(self.delay_s)
                answer = self.behaviour(self, tid, unit, pdu)
                if answer is not None:
                    writer.write(struct.pack(">HHHB", tid, 0, len(answer) + 1, unit) + answer)
        except (asyncio.IncompleteReadError, ConnectionError, asyncio.CancelledError):
            pass
        finally:
            self._writers.discard(writer)
            writer.close()
