"""Link with faults on request: a TCP relay between a harness and a rig, on the loopback interface.

    async with FaultyLink(rig.modbus_port, modbus_frames) as link:
        ...                      # the harness talks to link.port
        link.change = ...        # replies are changed, delayed or swallowed
        link.drop()              # connections are reset and refused until restore()
        link.mute()              # half-open: connections stay, nothing passes, new ones are taken and not served

Only the rig's bytes are cut into frames and may be changed; the harness's bytes pass as they are.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Callable, Sequence
from typing import Self

Split = Callable[[bytes], tuple[list[bytes], bytes]]
"""Function that cuts a stream into whole frames and the rest."""
Change = Callable[[bytes], Sequence[tuple[float, bytes]]]
"""Function of a frame that returns pieces, each with a delay in s after the piece before it; none drops the frame."""
HOST = "127.0.0.1"


def modbus_frames(data: bytes) -> tuple[list[bytes], bytes]:
    """Return the Modbus/TCP frames (MBAP header and PDU) of a stream, and the rest."""
    frames = []
    while len(data) >= 6:
        size = 6 + int.from_bytes(data[4:6], "big")
        if len(data) < size:
            break
        frames.append(data[:size])
        data = data[size:]
    return frames, data


def rtu_frames(data: bytes) -> tuple[list[bytes], bytes]:
    """Return the RTU replies of a stream, and the rest; bytes of other functions than 1 to 6, 15, 16, 23 pass uncut."""
    frames = []
    while len(data) >= 3:
        if data[1] & 0x80:
            size = 5
        elif data[1] in (1, 2, 3, 4, 23):
            size = 5 + data[2]
        else:
            size = 8 if data[1] in (5, 6, 15, 16) else len(data)
        if len(data) < size:
            break
        frames.append(data[:size])
        data = data[size:]
    return frames, data


def can_frames(data: bytes) -> tuple[list[bytes], bytes]:
    """Return the `< ... >` of a socketcand stream, and the rest."""
    frames = []
    while (end := data.find(b">")) >= 0:
        frames.append(data[: end + 1])
        data = data[end + 1 :]
    return frames, data


def as_it_comes(data: bytes) -> tuple[list[bytes], bytes]:
    """Return the stream uncut, as for encrypted streams."""
    return [data], b""


class FaultyLink:
    """Relay from `port` to `target` on the loopback interface."""

    def __init__(self, target: int, split: Split = as_it_comes) -> None:
        self.target = target
        self.port = 0
        self.change: Change | None = None
        self.frames = 0
        self.changed = 0
        """Frames of the rig that passed, and those that were changed."""
        self._split = split
        self._muted = False
        self._listener: socket.socket | None = None
        self._talks: dict[asyncio.Task[None], tuple[asyncio.StreamWriter, ...]] = {}

    async def start(self) -> None:
        """Listen; on the same port as before when it was stopped."""
        listener = socket.create_server((HOST, self.port))
        listener.setblocking(False)
        self.port = int(listener.getsockname()[1])
        self._listener = listener
        asyncio.get_running_loop().add_reader(listener, self._accept, listener)

    async def stop(self) -> None:
        """Close everything."""
        talks = list(self._talks)
        self.drop()
        for talk in talks:
            talk.cancel()
        await asyncio.gather(*talks, return_exceptions=True)

    async def __aenter__(self) -> Self:
        await self.start()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.stop()

    def reset(self) -> None:
        """Reset every connection; new ones are served."""
        for talk, writers in self._talks.items():
            for writer in writers:
                writer.transport.abort()
            if not writers:
                talk.cancel()

    def drop(self) -> None:
        """Reset every connection and refuse new ones."""
        if self._listener is not None:
            asyncio.get_running_loop().remove_reader(self._listener)
            self._listener.close()
            self._listener = None
        self.reset()

    def mute(self) -> None:
        """Make connections half-open: pass nothing either way, and keep them."""
        self._muted = True

    async def restore(self) -> None:
        """Make the link work again. Muted bytes are lost, and their connections are reset."""
        self.change = None
        if self._muted:
            self._muted = False
            self.reset()
        if self._listener is None:
            await self.start()

    def say(self, frame: bytes) -> None:
        """Send a frame to every connection on the harness's side."""
        for writers in self._talks.values():
            for writer in writers[:1]:
                writer.write(frame)

    def _accept(self, listener: socket.socket) -> None:
        # asyncio's own server loses, and never closes, a connection that it accepts in the moment of its closing.
        try:
            connection, _ = listener.accept()
        except OSError:
            return
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        talk = asyncio.create_task(self._serve(connection))
        self._talks[talk] = ()
        talk.add_done_callback(lambda done: self._ended(done, connection))

    def _ended(self, talk: asyncio.Task[None], connection: socket.socket) -> None:
        self._talks.pop(talk, None)
        connection.close()

    async def _serve(self, connection: socket.socket) -> None:
        task = asyncio.current_task()
        assert task is not None
        with contextlib.suppress(OSError, asyncio.CancelledError):
            reader, writer = await asyncio.open_connection(sock=connection)
            self._talks[task] = (writer,)
            try:
                if self._muted:
                    await self._swallow(reader)
                else:
                    await self._relay(task, reader, writer)
            finally:
                writer.transport.abort()

    async def _relay(
        self, task: asyncio.Task[None], reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        far_reader, far_writer = await asyncio.open_connection(HOST, self.target)
        self._talks[task] = (writer, far_writer)
        there = asyncio.create_task(self._up(reader, far_writer))
        back = asyncio.create_task(self._down(far_reader, writer))
        try:
            await asyncio.wait((there, back), return_when=asyncio.FIRST_COMPLETED)
        finally:
            for half in (there, back):
                half.cancel()
            await asyncio.gather(there, back, return_exceptions=True)
            far_writer.transport.abort()

    async def _swallow(self, reader: asyncio.StreamReader) -> None:
        while await reader.read(65536):
            pass

    async def _up(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            while data := await reader.read(65536):
                if not self._muted and not writer.is_closing():
                    writer.write(data)

    async def _down(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        rest = b""
        with contextlib.suppress(OSError):
            while data := await reader.read(65536):
                frames, rest = self._split(rest + data)
                for frame in frames:
                    await self._pass(frame, writer)

    async def _pass(self, frame: bytes, writer: asyncio.StreamWriter) -> None:
        if self._muted:
            return
        self.frames += 1
        change = self.change
        pieces = ((0.0, frame),) if change is None else change(frame)
        if change is not None and tuple(pieces) != ((0.0, frame),):
            self.changed += 1
        for delay_s, piece in pieces:
            if delay_s > 0.0:
                await asyncio.sleep(delay_s)
            if not self._muted and not writer.is_closing():
                writer.write(piece)
