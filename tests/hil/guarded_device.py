"""A Modbus device of the test's own: eight holding registers on TCP or on a pseudo terminal."""

from __future__ import annotations

import os
import pty
import socket
import struct
import threading
import time
import tty

from hil.guardian.wires import crc16

HEATER, METER = 0, 4


class Device:
    """Register 0 asks for heat in W, register 4 measures it. `obeys` False: it acknowledges and heats on.

    For `deaf_s` after connecting it drops every request, s. `stuck_W`, if set, is what the meter reads after a write.
    Requests that begin at a register in `mute` get no reply. While it `echoes`, each request is sent back.
    """

    def __init__(self, *, single: bool = False, serial: bool = False, deaf_s: float = 0.0) -> None:
        self.registers = [0] * 8
        self.obeys = True
        self.stuck_W: int | None = None
        self.refuses: set[int] = set()
        self.mute: set[int] = set()
        self.echoes = False
        self.off_s: float | None = None
        self.connections = 0
        self._single = single
        self._deaf_s = deaf_s
        self._open: set[socket.socket] = set()
        self.path = ""
        self.port = 0
        if serial:
            self._master, slave = pty.openpty()
            tty.setraw(slave)
            self.path = os.ttyname(slave)
            self._slave = slave
            threading.Thread(target=self._serve_line, daemon=True).start()
        else:
            self._listener = socket.create_server(("127.0.0.1", 0))
            self.port = self._listener.getsockname()[1]
            threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        if self.port:
            self._listener.close()
        for client in list(self._open):
            client.close()

    def hang_up(self) -> None:
        """Close every connection, as a device does with idle ones."""
        for client in list(self._open):
            client.shutdown(socket.SHUT_RDWR)

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            self._open = {one for one in self._open if one.fileno() >= 0}
            if self._single and self._open:
                client.close()
                continue
            self.connections += 1
            self._open.add(client)
            threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        hears_s = time.monotonic() + self._deaf_s
        try:
            while True:
                head = self._exactly(client, 7)
                transaction, _, size, unit = struct.unpack(">HHHB", head)
                pdu = self._exactly(client, size - 1)
                if time.monotonic() < hears_s:
                    continue
                if struct.unpack(">H", pdu[1:3])[0] in self.mute:
                    continue
                reply = pdu if self.echoes else self._answer(pdu)
                client.sendall(struct.pack(">HHHB", transaction, 0, len(reply) + 1, unit) + reply)
        except OSError:
            client.close()

    @staticmethod
    def _exactly(client: socket.socket, count: int) -> bytes:
        data = b""
        while len(data) < count:
            more = client.recv(count - len(data))
            if not more:
                raise OSError("closed")
            data += more
        return data

    def _serve_line(self) -> None:
        buffer = b""
        while True:
            try:
                buffer += os.read(self._master, 256)
            except OSError:
                return
            if len(buffer) >= 8:
                frame, buffer = buffer[:8], b""
                if crc16(frame[:-2]) == frame[-2:]:
                    reply = frame[:1] + self._answer(frame[1:-2])
                    os.write(self._master, reply + crc16(reply))

    def _answer(self, pdu: bytes) -> bytes:
        code, address, value = struct.unpack(">BHH", pdu[:5])
        if code == 6 and address in self.refuses:
            return bytes((0x86, 4))
        if code == 6:
            if address != HEATER or self.obeys:
                self.registers[address] = value
            if address == HEATER and self.obeys:
                self.registers[METER] = value if self.stuck_W is None else self.stuck_W
                self.off_s = None if value else time.monotonic()
            return pdu
        found = self.registers[address : address + value]
        return struct.pack(f">BB{value}H", code, 2 * value, *found)

    def rig_text(self, *, pump: bool = False, valves: tuple[int, ...] = (), parity: str = "none") -> str:
        bus = (
            f'transport = "modbus_rtu"\nserial_port = "{self.path}"\nparity = "{parity}"\n'
            if self.path
            else f'transport = "modbus_tcp"\nport = {self.port}\n'
        )
        if self._deaf_s:
            bus += f"connect_delay_s = {self._deaf_s + 0.05:g}\n"
        first = (
            '[[point]]\nname = "pump_set"\nbus = "plc"\ntable = "holding"\naddress = 1\nunit = "%"\naccess = "rw"\n'
            "limits = [0, 100]\nsafe_value = 100\n"
        )
        first = first if pump else ""
        for address in valves:
            first += (
                f'[[point]]\nname = "valve_{address}"\nbus = "plc"\ntable = "holding"\naddress = {address}\n'
                'unit = "%"\naccess = "rw"\nlimits = [0, 100]\nsafe_value = 100\nsafe_order = -1\n'
            )
        return f"""
[rig]
name = "guarded"
period_s = 0.1

[bus.plc]
{bus}
{first}
[[point]]
name = "heater_set"
bus = "plc"
table = "holding"
address = 0
unit = "W"
access = "rw"
limits = [0, 1000]
safe_value = 0
readback = "heater"
readback_within_s = 1.0

[[point]]
name = "heater"
bus = "plc"
table = "holding"
address = 4
unit = "W"
"""
