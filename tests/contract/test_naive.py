"""The traps: what the libraries do by themselves, on the wires and devices of the contract suite.

Each test here shows that the trap is there; that our driver does not fall into it is shown by the test of the contract
suite that it names. When one of these fails, a library has become better, and a guard of ours may go.
"""

from __future__ import annotations

import asyncio
import contextlib
import struct
import time
from collections.abc import AsyncIterator

import can
import cantools.database
import pytest
from pymodbus import FramerType
from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException

from drivers.virtual.devices.modbus_protocol import ModbusConnection
from drivers.virtual.devices.registers import INPUT_COUNT, Registers
from drivers.virtual.devices.rtu_protocol import RtuConnection
from drivers.virtual.faults.faulty_link import Change, FaultyLink, modbus_frames, rtu_frames
from drivers.virtual.faults.faulty_replies import in_rtu, too_few_registers, wrong_function
from tests.contract.can_wires import RIG


@contextlib.asynccontextmanager
async def plain(*, rtu: bool, timeout_s: float = 0.1) -> AsyncIterator[tuple[AsyncModbusTcpClient, FaultyLink]]:
    """pymodbus's client as its documentation has it, without retries, on the contract suite's device."""
    registers, clients = Registers(), set()
    registers.inputs = struct.pack(f">{INPUT_COUNT}H", *(100 + a for a in range(INPUT_COUNT)))
    kind = RtuConnection if rtu else ModbusConnection
    server = await asyncio.get_running_loop().create_server(lambda: kind({1: registers}, clients), "127.0.0.1", 0)
    async with FaultyLink(server.sockets[0].getsockname()[1], rtu_frames if rtu else modbus_frames) as link:
        framer = FramerType.RTU if rtu else FramerType.SOCKET
        client = AsyncModbusTcpClient("127.0.0.1", port=link.port, framer=framer, timeout=timeout_s, retries=0)
        await client.connect()
        yield client, link
        client.close()
        server.close()
        for one in list(clients):
            one.close()
        await asyncio.sleep(0.01)


def slow_once(delay_s: float) -> Change:
    """A device that takes 5 ms for an answer, and once `delay_s`."""
    held = [delay_s]
    return lambda frame: [(held.pop() if held else 0.005, frame)]


async def test_rtu_one_late_reply_and_every_answer_is_the_one_before():
    """Ours: `one late reply never shifts the next answers`, `replies that are late again and again`."""
    async with plain(rtu=True) as (client, link):
        link.change = slow_once(0.11)
        with pytest.raises(ModbusException):
            await client.read_input_registers(0, count=2, device_id=1)
        answers = [(await client.read_input_registers(a, count=2, device_id=1)).registers for a in (2, 4, 6, 8)]
    asked = [[100 + a, 101 + a] for a in (2, 4, 6, 8)]
    assert answers == [[100, 101], *asked[:-1]], "one behind, and no error"


async def test_a_reply_with_too_few_registers_is_taken():
    """Ours: `a reply with too few registers is never a value and passes`."""
    import random

    for rtu in (False, True):
        async with plain(rtu=rtu) as (client, link):
            change = too_few_registers(random.Random(1), 1.0)
            link.change = in_rtu(change) if rtu else change
            reply = await client.read_input_registers(0, count=6, device_id=1)
        assert not reply.isError() and len(reply.registers) < 6


async def test_a_reply_of_another_function_is_taken():
    """Ours: `a reply of another function is never a value and passes`."""
    import random

    async with plain(rtu=False) as (client, link):
        link.change = wrong_function(random.Random(1), 1.0)
        reply = await client.read_input_registers(0, count=6, device_id=1)
    assert not reply.isError() and reply.function_code == 3


async def test_a_reply_of_transaction_0_is_taken_for_any():
    """Ours: `tests/drivers/test_replies.py`."""
    async with plain(rtu=False) as (client, link):
        await client.read_input_registers(0, count=2, device_id=1)
        link.change = lambda frame: [(0.0, struct.pack(">HHHBBBHH", 0, 0, 7, 1, 4, 4, 666, 666))]
        reply = await client.read_input_registers(4, count=2, device_id=1)
    assert reply.registers == [666, 666]


async def test_a_half_open_connection_is_held_for_alive():
    """Ours: `a half open wire is noticed within its deadline and comes back`."""
    async with plain(rtu=False, timeout_s=0.05) as (client, link):
        await client.read_input_registers(0, count=2, device_id=1)
        link.mute()
        for _ in range(3):
            with pytest.raises(ModbusException):
                await client.read_input_registers(0, count=2, device_id=1)
            assert client.connected


async def test_a_first_connection_that_fails_is_never_tried_again():
    """Ours: a rig that is off is said with its address, and a lost one is opened again by itself."""
    async with FaultyLink(1) as link:
        link.drop()
        client = AsyncModbusTcpClient("127.0.0.1", port=link.port, timeout=0.1, reconnect_delay=0.05)
        assert await client.connect() is False
        await link.restore()
        await asyncio.sleep(0.3)
        assert not client.connected
        client.close()


async def test_a_periodic_heartbeat_goes_on_while_the_program_hangs():
    """Ours: the heartbeat is written by the loop, after its checks."""
    with can.Bus(interface="virtual", channel="beat") as one, can.Bus(interface="virtual", channel="beat") as other:
        task = one.send_periodic(can.Message(arbitration_id=1, is_extended_id=False), 0.02)
        time.sleep(0.2)  # noqa: ASYNC251
        task.stop()
        beats = 0
        while other.recv(0.0) is not None:
            beats += 1
    assert beats >= 5


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
async def test_the_receiving_thread_ends_with_the_first_error_and_says_nothing():
    """Ours: `a wire that is reset comes back by itself`; the receiving thread is our own."""

    class Broken(can.interfaces.virtual.VirtualBus):
        def _recv_internal(self, timeout):
            raise can.CanOperationError("bus off")

    async def heard() -> None:
        reader = can.AsyncBufferedReader()
        notifier = can.Notifier(bus, [reader], timeout=0.05, loop=asyncio.get_running_loop())
        try:
            async with asyncio.timeout(0.3):
                await reader.get_message()
        finally:
            assert not notifier.stopped
            notifier.stop()

    with Broken("broken") as bus, pytest.raises(TimeoutError):
        await heard()
    with Broken("broken") as bus:
        assert bus.state == can.BusState.ACTIVE


def test_a_dbc_decodes_what_it_does_not_admit_and_reads_as_cp1252():
    """Ours: `a value that the dbc does not admit is out of range`; UTF-8 is read as such."""
    dbc = RIG.bus["thermocouples"].dbc  # type: ignore[union-attr]
    message = cantools.database.load_file(dbc, encoding="utf-8").get_message_by_name("TC_A")
    assert message.decode(struct.pack("<4h", 0x7FFF, 0, 0, 0))["T_heater"] == pytest.approx(327.67)
    text = dbc.read_text(encoding="utf-8").replace('"degC" HARNESS', '"°C" HARNESS', 1)
    wrong = cantools.database.load_string(text.encode("utf-8").decode("cp1252")).get_message_by_name("TC_A")
    assert wrong.signals[0].unit == "Â°C"


def test_a_frame_is_extended_unless_it_is_said_not_to_be():
    """Ours: `frames of another identifier kind or length are counted and not used`."""
    assert can.Message(arbitration_id=0x181).is_extended_id
