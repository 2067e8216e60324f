"""One wire by itself: what lies on it before a request goes out is no answer to it."""

from __future__ import annotations

import struct

import pytest

from drivers.modbus.link import ModbusLink
from drivers.modbus.protocol.pymodbus_codec import rtu_frame
from drivers.rig_file.bus_sections import ModbusBusSection, ModbusRtuTcpBus, ModbusTcpBus
from drivers.signals.points import DeadlineError

ASKED = struct.pack(">BHH", 4, 0, 1)


def tcp_frame(pdu: bytes) -> bytes:
    return struct.pack(">HHHB", 0, 0, len(pdu) + 1, 1) + pdu


class OnTheWire:
    """A wire on which something lies that nobody has read, and which answers what is sent."""

    def __init__(self, lies: bytes, answer: bytes) -> None:
        self.lies, self.answer = lies, answer
        self.closed = False

    def send(self, data: bytes) -> None:
        self.lies += self.answer

    def take(self, seconds: float) -> bytes:
        taken, self.lies = self.lies, b""
        return taken

    def close(self) -> None:
        self.closed = True


@pytest.mark.parametrize(
    ("config", "framed"),
    [
        (ModbusRtuTcpBus(transport="modbus_rtu_tcp"), lambda pdu: rtu_frame(1, pdu)),
        (ModbusTcpBus(transport="modbus_tcp", transaction="zero"), tcp_frame),
    ],
    ids=["rtu over tcp", "transaction 0"],
)
async def test_a_reply_that_nobody_has_read_yet_is_not_the_answer_to_the_next_request(
    config: ModbusBusSection, framed
) -> None:
    wire = OnTheWire(b"", framed(b"\4\2\0\1"))

    async def opened(*_: object) -> OnTheWire:
        return wire

    link = ModbusLink(config, opener=opened)
    link.devices = 1
    await link.open("here")
    assert await link.ask(1, ASKED, 0.2, "here") == b"\4\2\0\1"
    wire.lies, wire.answer = framed(b"\4\2\0\1"), framed(b"\4\2\0\2")
    assert await link.ask(1, ASKED, 0.2, "here") == b"\4\2\0\2"
    await link.close()


@pytest.mark.parametrize(("transaction", "closed"), [("checked", False), ("zero", True)])
async def test_a_shared_connection_without_numbers_is_closed_after_any_time_out(transaction, closed):
    wire = OnTheWire(b"", b"")

    async def opened(*_: object) -> OnTheWire:
        return wire

    link = ModbusLink(ModbusTcpBus(transport="modbus_tcp", transaction=transaction), opener=opened)
    link.devices = 2
    await link.open("here")
    with pytest.raises(DeadlineError):
        await link.ask(1, ASKED, 0.05, "here")
    assert wire.closed == closed
    await link.close()
