"""The rig as two real processes: strangers read and write it, it protects itself, and it ends with its parent."""

import asyncio
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path

import can
import cantools.database
import pytest
from pymodbus.client import ModbusTcpClient
from raw_client import RawClient

from drivers.virtual.plant.effects import EffectFileError
from drivers.virtual.plant.plant import Plant
from drivers.virtual.processes import PortInUseError, VirtualRigError
from drivers.virtual.rig import VirtualRig, start_virtual_rig

PROFILES = Path(__file__).resolve().parents[2] / "profiles"
Connect = Callable[[VirtualRig], RawClient]

WATCHDOG, ARM = 4, 5


def wait_until(condition: Callable[[], bool], seconds: float) -> float:
    """Poll; the seconds that it took. Fails when it never becomes true."""
    start = time.monotonic()
    while not condition():
        assert time.monotonic() - start < seconds, f"not within {seconds} s"
        time.sleep(0.02)
    return time.monotonic() - start


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


async def test_lockstep_moves_only_when_granted(connect: Connect) -> None:
    async with await start_virtual_rig(mode="lockstep", seed=11) as rig:
        client = connect(rig)
        await asyncio.sleep(0.3)
        assert client.inputs()["cycle"] == 0
        assert client.take_control() == "virtual-rig 1 mode=lockstep period=1.0 t=0.000\n"
        client.write(0, 7500, 1000, 700, 1, 100, 1)
        plant = Plant(seed=11)
        for second in range(1, 41):
            client.write(3, second)
            assert client.step() == f"t {second}.000"
            plant.step(750.0, 1.0, 0.7)
            temperatures = client.temperatures(second)
        inputs = client.inputs()
        assert (inputs["cycle"], inputs["uptime"], inputs["heartbeat"]) == (40, 40.0, 40)
        assert inputs["status"] == 1
        assert inputs["power"] == pytest.approx(plant.heater_power_W, abs=4.0)
        assert inputs["flow"] == pytest.approx(plant.flow_L_per_min, abs=0.04)
        assert (inputs["pump"], inputs["fan"]) == (pytest.approx(100.0, abs=0.3), pytest.approx(70.0, abs=0.5))
        # Nothing but offset (0.03 K), noise (0.05 K) and quantisation lies between plant and wire.
        assert temperatures == pytest.approx(plant.junction.tolist(), abs=0.03 + 5 * 0.05)


async def test_lockstep_is_the_same_every_time(connect: Connect) -> None:
    def drive(rig: VirtualRig) -> list[object]:
        client = connect(rig)
        client.take_control()
        client.write(0, 6000, 900, 500, 1, 100, 1)
        seen: list[object] = []
        for second in range(1, 60):
            client.write(3, second)
            client.step()
            seen.append((client.inputs(), client.frames(second)))
        return seen

    runs = []
    for seed in (5, 5, 6):
        async with await start_virtual_rig(mode="lockstep", seed=seed) as rig:
            runs.append(drive(rig))
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


async def test_effect_file_reaches_both_processes(connect: Connect, tmp_path: Path) -> None:
    path = tmp_path / "both.toml"
    path.write_text(
        '[[effect]]\nkind = "sensor"\nwhere = "T_pm2_C"\nopen_circuit = true\nonset_s = 5\n'
        '[[effect]]\nkind = "flow"\nwhere = "loop"\ndriver = "constant"\nlost_fraction = 0.5\nonset_s = 5\n'
    )
    async with await start_virtual_rig(mode="lockstep", effects=path) as rig:
        client = connect(rig)
        client.take_control()
        client.write(1, 1000)
        client.step(4)
        assert client.frames(4.0)[0x381][2:4] == b"\0\0"
        client.step(10)
        assert client.frames(14.0)[0x381][2:4] == b"\4\0"
        assert client.inputs()["flow"] == pytest.approx(0.5 * 3.75, rel=0.03)


async def test_watchdog_runs_out_in_rig_time_and_wants_rearming(connect: Connect) -> None:
    async with await start_virtual_rig(mode="lockstep") as rig:
        client = connect(rig)
        client.take_control()
        client.write(0, 8000, 1000, 1000, 1, 50, 1)
        client.step(5)
        assert client.inputs()["status"] == 1
        client.step()
        assert client.inputs()["status"] == 2
        assert client.holding() == [0, 1000, 1000, 1, 50, 0]
        client.step(15)
        assert client.inputs()["power"] < 1.0
        assert client.request(struct.pack(">BHH", 6, ARM, 1)) == b"\x86\x03"
        client.write(3, 2)
        client.write(ARM, 1)
        client.write(0, 8000)
        client.step(3)
        assert client.inputs()["power"] > 300.0


async def test_scaled_time_runs_fast_and_its_watchdog_too(connect: Connect) -> None:
    async with await start_virtual_rig(mode="scaled", speed=50.0) as rig:
        client = connect(rig)
        client.write(0, 8000, 1000, 1000, 1, 100, 1)
        start = client.inputs()["uptime"]
        took = wait_until(lambda: client.inputs()["status"] == 2, 3.0)
        assert 9.0 <= client.inputs()["uptime"] - start <= took * 50.0 + 5.0
        assert client.take_control().startswith("virtual-rig 1 mode=scaled period=1.0")
        assert client.step().startswith("error the rig runs in scaled time")


async def test_real_time_at_ten_hertz_keeps_the_clock(connect: Connect) -> None:
    async with await start_virtual_rig(mode="real", period_s=0.1) as rig:
        client = connect(rig)
        first, start = client.inputs()["uptime"], time.monotonic()
        await asyncio.sleep(1.5)
        assert client.inputs()["uptime"] - first == pytest.approx(time.monotonic() - start, abs=0.25)


LOCKSTEP_CLIENT = """
    import socket, struct, sys, time
    modbus, control = (socket.create_connection(("127.0.0.1", int(port))) for port in sys.argv[1:])
    control.recv(100)
    modbus.sendall(struct.pack(">HHHBBHHB6H", 1, 0, 19, 1, 16, 0, 6, 12, 9000, 1000, 1000, 1, 10, 1))
    modbus.recv(100)
    for _ in range(8):
        control.sendall(b"step\\n")
        control.recv(100)
        modbus.sendall(struct.pack(">HHHBBHH", 1, 0, 6, 1, 6, 3, _ + 2))
        modbus.recv(100)
    print("stepped", flush=True)
    time.sleep(60)
"""


async def test_heater_is_cut_when_the_lockstep_client_is_killed(connect: Connect) -> None:
    def drive(rig: VirtualRig) -> None:
        with subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(LOCKSTEP_CLIENT), str(rig.modbus_port), str(rig.control_port)],
            stdout=subprocess.PIPE,
        ) as killed:
            assert killed.stdout is not None
            assert killed.stdout.readline() == b"stepped\n"
            watcher = connect(rig)
            assert watcher.inputs()["power"] > 800.0
            time.sleep(0.3)
            assert watcher.inputs()["uptime"] == 8.0
            killed.kill()
        # Watchdog 1 s; a period of real time each to begin, to notice and to cut; then the heater's own lag.
        wait_until(lambda: watcher.inputs()["status"] == 2, 4.5)
        assert watcher.holding()[0] == 0
        before = watcher.inputs()["power"]
        wait_until(lambda: watcher.inputs()["power"] < 0.7 * before, 3.0)
        # Another client takes over where the rig's own time has come to.
        greeting = watcher.take_control()
        assert float(greeting.split("t=")[1]) >= 10.0
        now = watcher.inputs()["uptime"]
        watcher.step()
        assert watcher.inputs()["uptime"] == now + 1.0

    async with await start_virtual_rig(mode="lockstep") as rig:
        drive(rig)


async def test_only_one_client_holds_the_control_port(connect: Connect) -> None:
    async with await start_virtual_rig(mode="lockstep") as rig:
        first, second = connect(rig), connect(rig)
        first.take_control()
        assert second.take_control().startswith("error another client holds the control port")
        assert first.step() == "t 1.000"
        assert first.control is not None
        first.control.sendall(b"jump\n step \nst")
        first.control.sendall(b"ep\n")
        lines = [first._until(first.control, b"\n") for _ in range(3)]
        assert lines == [b"error unknown command; send step or quit.\n", b"t 2.000\n", b"t 3.000\n"]


async def test_steps_may_be_granted_ahead_and_no_frame_is_lost(connect: Connect) -> None:
    async with await start_virtual_rig(mode="lockstep") as rig:
        client = connect(rig)
        client.take_control()
        assert client.control is not None
        client.control.sendall(b"step\n" * 3000)
        for second in range(1, 3001):
            uptime = struct.unpack("<I", client.frames(second)[0x381][4:])[0]
            assert uptime == 1000 * second


async def test_pipelined_requests_over_tcp(connect: Connect) -> None:
    async with await start_virtual_rig(mode="lockstep") as rig:
        client = connect(rig)
        requests = [struct.pack(">HHHBBHH", n, 0, 6, 1, 4, 0, 12) for n in range(100)]
        client.modbus.sendall(b"".join(requests))
        for n in range(100):
            reply = client._exactly(9 + 24)
            assert struct.unpack(">H", reply[:2])[0] == n


async def test_pymodbus_reads_and_writes() -> None:
    def stranger(rig: VirtualRig) -> None:
        client = ModbusTcpClient(rig.host, port=rig.modbus_port, timeout=3)
        try:
            assert client.connect()
            assert not client.write_registers(0, [5000, 800, 600], device_id=1).isError()
            assert client.read_holding_registers(0, count=6, device_id=1).registers == [5000, 800, 600, 0, 100, 0]
            assert not client.mask_write_register(address=1, and_mask=0, or_mask=900, device_id=1).isError()
            both = client.readwrite_registers(
                read_address=0, read_count=3, write_address=2, values=[650], address=0, device_id=1
            )
            assert both.registers == [5000, 900, 650]
            inputs = client.read_input_registers(0, count=12, device_id=1).registers
            assert client.convert_from_registers(inputs[2:4], client.DATATYPE.FLOAT32, word_order="little") == 0.0
            assert client.read_discrete_inputs(0, count=3, device_id=1).bits[:3] == [False] * 3
            assert not client.write_coil(0, True, device_id=1).isError()
            assert client.read_coils(0, count=1, device_id=1).bits[0] is True
            assert client.read_input_registers(11, count=2, device_id=1).exception_code == 2
            assert client.write_register(WATCHDOG, 0, device_id=1).exception_code == 3
            assert client.read_input_registers(0, count=1, device_id=9).exception_code == 0x0B
        finally:
            client.close()

    async with await start_virtual_rig(mode="lockstep") as rig:
        await asyncio.to_thread(stranger, rig)


@pytest.mark.skipif(shutil.which("mbpoll") is None, reason="mbpoll is not installed (Debian package mbpoll)")
async def test_mbpoll_reads_and_writes() -> None:
    def mbpoll(rig: VirtualRig, *arguments: str) -> str:
        command = ["mbpoll", "-m", "tcp", "-a", "1", "-0", "-1", "-p", str(rig.modbus_port), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=False)
        return done.stdout + done.stderr

    def drive(rig: VirtualRig) -> None:
        assert "Written 3 references" in mbpoll(rig, "-t", "4", "-r", "0", rig.host, "7500", "1000", "700")
        holding = mbpoll(rig, "-t", "4", "-r", "0", "-c", "6", rig.host)
        assert [line.split()[-1] for line in holding.splitlines() if line.startswith("[")] == [
            "7500",
            "1000",
            "700",
            "0",
            "100",
            "0",
        ]
        flow = mbpoll(rig, "-t", "3:float", "-r", "2", "-c", "1", rig.host)
        assert "[2]:" in flow
        assert "Illegal data address" in mbpoll(rig, "-t", "3", "-r", "12", "-c", "1", rig.host)
        assert "Illegal data value" in mbpoll(rig, "-t", "4", "-r", "0", rig.host, "10001")

    async with await start_virtual_rig() as rig:
        drive(rig)


async def test_python_can_and_cantools_decode_the_bus(connect: Connect) -> None:
    database = cantools.database.load_file(PROFILES / "rigs" / "thermocouples.dbc")

    def stranger(rig: VirtualRig) -> None:
        bus = can.Bus(interface="socketcand", host=rig.host, port=rig.can_port, channel="vcan0")
        with bus:
            client = connect(rig)
            client.take_control()
            client.write(0, 9000, 1000, 400, 1, 600, 1)
            plant = Plant(seed=2)
            decoded: dict[str, float] = {}
            for second in range(1, 31):
                client.step()
                plant.step(900.0, 1.0, 0.4)
                identifiers = []
                for _ in range(3):
                    message = bus.recv(5.0)
                    assert message is not None
                    identifiers.append(message.arbitration_id)
                    decoded |= database.decode_message(message.arbitration_id, bytes(message.data))
                assert identifiers == [0x181, 0x281, 0x381]
                assert decoded["tc_uptime"] == second
            assert decoded["T_heater"] == pytest.approx(plant.junction[0], abs=0.28)
            assert decoded["T_tank"] == pytest.approx(plant.junction[8], abs=0.28)

    async with await start_virtual_rig(mode="lockstep", seed=2) as rig:
        await asyncio.to_thread(stranger, rig)


async def test_a_dead_process_is_noticed_and_takes_the_other_down() -> None:
    for victim in ("plc", "thermocouples"):
        async with await start_virtual_rig(mode="lockstep") as rig:
            assert rig.running
            os.kill(rig.pids[victim], signal.SIGKILL)
            reason = await asyncio.wait_for(rig.wait(), 5.0)
            assert not rig.running
            assert reason is not None
            assert "ended" in reason
            await asyncio.sleep(0.2)
        assert not any(alive(pid) for pid in rig.pids.values())


async def test_quit_ends_the_rig_cleanly(connect: Connect) -> None:
    async with await start_virtual_rig(mode="lockstep") as rig:
        client = connect(rig)
        client.take_control()
        assert client.control is not None
        client.control.sendall(b"quit\n")
        assert client._until(client.control, b"\n") == b"bye\n"
        assert await asyncio.wait_for(rig.wait(), 5.0) is None


async def test_children_die_with_a_killed_parent() -> None:
    script = """
        import asyncio
        from drivers.virtual.rig import start_virtual_rig
        async def main():
            rig = await start_virtual_rig()
            print(*rig.pids.values(), flush=True)
            await asyncio.sleep(60)
        asyncio.run(main())
    """

    def drive() -> None:
        with subprocess.Popen([sys.executable, "-c", textwrap.dedent(script)], stdout=subprocess.PIPE) as parent:
            assert parent.stdout is not None
            pids = [int(word) for word in parent.stdout.readline().split()]
            assert len(pids) == 2
            assert all(alive(pid) for pid in pids)
            parent.kill()
        wait_until(lambda: not any(alive(pid) for pid in pids), 3.0)

    drive()


@pytest.mark.parametrize(
    ("which", "server"),
    [("modbus_port", "own"), ("modbus_port", "pymodbus"), ("can_port", "own"), ("control_port", "own")],
)
async def test_a_port_in_use_is_one_sentence(which: str, server: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(PortInUseError, match=rf"port 127\.0\.0\.1:{port} is in use; choose another") as caught:
            await start_virtual_rig(**{which: port, "server": server})
    assert isinstance(caught.value, OSError)
    assert isinstance(caught.value, VirtualRigError)


@pytest.mark.parametrize("options", [{"mode": "warp"}, {"period_s": 0.0}, {"speed": -1.0}, {"can_port": 70000}])
async def test_arguments_that_make_no_rig(options: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"use|give"):
        await start_virtual_rig(**options)


async def test_a_host_that_is_not_here_is_one_sentence() -> None:
    with pytest.raises(PortInUseError, match=r"192\.0\.2\.1:0 cannot be opened"):
        await start_virtual_rig(host="192.0.2.1")


async def test_bad_effect_file_starts_nothing(tmp_path: Path) -> None:
    with pytest.raises(EffectFileError, match="cannot be read"):
        await start_virtual_rig(effects=tmp_path / "none.toml")


async def test_serve_prints_its_ports_and_ends_with_ctrl_c() -> None:
    script = "from drivers.virtual.rig import serve; raise SystemExit(serve(mode='real'))"
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-u", "-c", script, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
    )
    assert process.stdout is not None
    first = await asyncio.wait_for(process.stdout.readline(), 30.0)
    for _ in range(2):
        await process.stdout.readline()
    port = int(first.split(b"port ")[1].split(b",")[0])
    socket.create_connection(("127.0.0.1", port), timeout=2.0).close()
    process.send_signal(signal.SIGINT)
    _, errors = await asyncio.wait_for(process.communicate(), 10.0)
    assert (process.returncode, errors) == (0, b"")
