"""A stranger's client for the virtual rig: plain sockets, no code of the project."""

from __future__ import annotations

import contextlib
import socket
import struct
from typing import Any, Self


class RawClient:
    """Modbus, CAN and control sockets of one rig. Blocking, with a deadline on every read."""

    def __init__(self, rig: Any) -> None:
        self._stack = contextlib.ExitStack()
        self.modbus = self._connect(rig.host, rig.modbus_port)
        self.can = self._connect(rig.host, rig.can_port)
        self.control: socket.socket | None = None
        self._rig = rig
        self._transaction = 0
        assert self._until(self.can, b">") == b"< hi >"
        for command in (b"< open vcan0 >", b"< rawmode >"):
            self.can.sendall(command)
            assert self._until(self.can, b">") == b"< ok >"
        self._heard = b""

    def _connect(self, host: str, port: int) -> socket.socket:
        connection = self._stack.enter_context(socket.create_connection((host, port), timeout=10.0))
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return connection

    @staticmethod
    def _until(connection: socket.socket, end: bytes) -> bytes:
        data = b""
        while not data.endswith(end):
            chunk = connection.recv(1)
            if not chunk:
                raise EOFError(data)
            data += chunk
        return data

    def take_control(self) -> str:
        """Connect to the control port; the greeting."""
        self.control = self._connect(self._rig.host, self._rig.control_port)
        return self._until(self.control, b"\n").decode()

    def step(self, count: int = 1) -> str:
        """Grant steps; the last answer."""
        assert self.control is not None
        answer = b""
        for _ in range(count):
            self.control.sendall(b"step\n")
            answer = self._until(self.control, b"\n")
        return answer.decode().strip()

    def request(self, pdu: bytes, device: int = 1) -> bytes:
        """Response PDU to a request PDU."""
        self._transaction += 1
        self.modbus.sendall(struct.pack(">HHHB", self._transaction, 0, len(pdu) + 1, device) + pdu)
        return self.response()

    def response(self) -> bytes:
        """Next response PDU; the transaction must be the one that was asked."""
        transaction, protocol, length, _ = struct.unpack(">HHHB", self._exactly(7))
        assert (transaction, protocol) == (self._transaction, 0)
        return self._exactly(length - 1)

    def _exactly(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            chunk = self.modbus.recv(count - len(data))
            if not chunk:
                raise EOFError(data)
            data += chunk
        return data

    def write(self, address: int, *values: int) -> None:
        """Write holding registers; a refusal fails the test."""
        count = len(values)
        answer = self.request(struct.pack(f">BHHB{count}H", 16, address, count, 2 * count, *values))
        assert answer == struct.pack(">BHH", 16, address, count), answer.hex()

    def holding(self) -> list[int]:
        """All six holding registers."""
        return list(struct.unpack(">6H", self.request(struct.pack(">BHH", 3, 0, 6))[2:]))

    def inputs(self) -> dict[str, float]:
        """All input registers, decoded."""
        words = struct.unpack(">12H", self.request(struct.pack(">BHH", 4, 0, 12))[2:])
        power, flow = (struct.unpack(">f", struct.pack(">HH", words[k + 1], words[k]))[0] for k in (0, 2))
        return {
            "power": power,
            "flow": flow,
            "pump": words[4] * 0.1,
            "fan": words[5] * 0.1,
            "ambient": struct.unpack(">h", struct.pack(">H", words[6]))[0] * 0.01,
            "status": words[7],
            "uptime": ((words[8] << 16) | words[9]) * 0.001,
            "heartbeat": words[10],
            "cycle": words[11],
        }

    def frames(self, until_s: float) -> dict[int, bytes]:
        """The three frames of the period that ends at rig time `until_s`."""
        frames: dict[int, bytes] = {}
        while True:
            while b">" not in self._heard:
                chunk = self.can.recv(4096)
                if not chunk:
                    raise EOFError
                self._heard += chunk
            line, self._heard = self._heard.split(b">", 1)
            _, kind, identifier, _, data = line.split()
            assert kind == b"frame"
            frames[int(identifier, 16)] = bytes.fromhex(data.decode())
            if int(identifier, 16) == 0x381 and struct.unpack("<I", frames[0x381][4:])[0] >= round(until_s * 1000):
                return frames

    def temperatures(self, until_s: float) -> list[float]:
        """Nine temperatures of the period that ends at rig time `until_s`."""
        frames = self.frames(until_s)
        raw = struct.unpack("<9h", frames[0x181] + frames[0x281] + frames[0x381][:2])
        return [value * 0.01 for value in raw]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()
