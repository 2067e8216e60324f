"""Modbus RTU server, over a TCP connection or a pseudo-terminal that stands in for a serial line.

Requests are delimited by function and length, since a pseudo-terminal has no timing. A frame with a wrong CRC is
dropped with all bytes behind it. Requests to other devices are not answered (Modbus over serial line V1.02, 2.4 and
2.5.1).
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import tty

from drivers.virtual.devices.modbus_protocol import Connection, Devices, answer

_LONGEST = 256


def _table() -> tuple[int, ...]:
    rows = []
    for value in range(256):
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
        rows.append(value)
    return tuple(rows)


_CRC = _table()


def crc(data: bytes) -> bytes:
    """Return the two CRC bytes behind a frame (V1.02, 6.2.2)."""
    value = 0xFFFF
    for byte in data:
        value = value >> 8 ^ _CRC[(value ^ byte) & 0xFF]
    return value.to_bytes(2, "little")


def request_size(start: bytes) -> int | None:
    """Return the length of the request that begins with `start`; None while unknown, 0 where it is no request."""
    if len(start) < 2:
        return None
    function = start[1]
    if 1 <= function <= 6:
        return 8
    if function == 22:
        return 10
    at, rest = (6, 9) if function in (15, 16) else (10, 13) if function == 23 else (0, 0)
    if not at:
        return 0
    return rest + start[at] if len(start) > at else None


class RtuServer:
    """Server of one line: bytes of requests in, bytes of answers out."""

    def __init__(self, devices: Devices) -> None:
        self._devices = devices
        self._rest = b""

    def feed(self, data: bytes) -> bytes:
        """Return the answers to the requests that are whole now."""
        self._rest += data
        answers = b""
        while self._rest:
            size = request_size(self._rest)
            if size == 0:  # a function without a known length: the frame is all that came
                size = len(self._rest)
            if size is None or len(self._rest) < size:
                if len(self._rest) > _LONGEST:
                    self._rest = b""
                break
            frame, self._rest = self._rest[:size], self._rest[size:]
            if len(frame) < 4 or crc(frame[:-2]) != frame[-2:]:
                self._rest = b""
                break
            memory = self._devices.get(frame[0])
            if memory is not None:
                reply = frame[:1] + answer(memory, frame[1:-2])
                answers += reply + crc(reply)
        return answers


class RtuConnection(Connection):
    """Connection of one client of RTU over TCP."""

    def __init__(self, devices: Devices, connections: set[RtuConnection]) -> None:
        super().__init__(connections)
        self._frames = RtuServer(devices)

    def data_received(self, data: bytes) -> None:
        """Answer every whole request."""
        answers = self._frames.feed(data)
        if answers:
            self._transport.write(answers)


class PseudoLine:
    """Pseudo-terminal as a serial line: a client opens `path`. `powered` is False while the PLC reboots."""

    def __init__(self, devices: Devices) -> None:
        self._frames = RtuServer(devices)
        self._ours, self._theirs = os.openpty()  # theirs stays open here, or the line would end with its first client
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self.path = os.ttyname(self._theirs)
        self.powered = True
        asyncio.get_running_loop().add_reader(self._ours, self._readable)

    def _readable(self) -> None:
        with contextlib.suppress(BlockingIOError, OSError):
            answers = self._frames.feed(os.read(self._ours, 4096))
            if answers and self.powered:
                os.write(self._ours, answers)

    def close(self) -> None:
        """End the line."""
        asyncio.get_running_loop().remove_reader(self._ours)
        os.close(self._ours)
        os.close(self._theirs)
