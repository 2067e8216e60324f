"""Benchmark `hil bench bus`: round trips of the Modbus driver and of other clients, on the same server in the same run.

The server is the virtual rig in a process of its own. A round trip reads its twelve input registers; contestants take
turns, a slice each, so that whatever else the machine does falls on all of them. What each library does by itself to
believe a reply differs: ours checks transaction, unit, function, length and count of every one.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import statistics
import struct
import time
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from drivers.modbus import ModbusBus
from drivers.rig_file import ModbusRtuTcpBus, ModbusTcpBus, Point, load_rig
from drivers.virtual import VirtualRig, start_virtual_rig, taking_turns
from hil.bench.measure import ReportTable
from hil.bench.peers import libmodbus, modbus_peer

RIG = Path(__file__).resolve().parents[3] / "profiles" / "rigs" / "virtual.toml"
COUNT = 12
REQUEST = struct.pack(">HHHBBHH", 1, 0, 6, 1, 4, 0, COUNT)
REPLY_BYTES = 9 + 2 * COUNT
STEPS_OF_FORTY_HOURS = 144_000
LOCKSTEP_PARTS = 20
AIM_SHARE = 0.9
AIM_S = 15.0


@dataclass(frozen=True, slots=True)
class BusSize:
    """Size of the benchmark: `slices` of `trips` round trips for each contestant; `steps` in lockstep; `pipelined`
    requests in one segment.
    """

    slices: int
    trips: int
    steps: int
    pipelined: int = 200


FULL = BusSize(slices=25, trips=2000, steps=STEPS_OF_FORTY_HOURS)
QUICK = BusSize(slices=4, trips=300, steps=2000)

Progress = Callable[[float], None]


@dataclass
class _Contestant:
    """Client that is timed; `ask` makes one round trip and returns its registers."""

    name: str
    ask: Callable[[], object] | Callable[[], Awaitable[object]]
    is_async: bool = False
    is_python: bool = True
    is_peer: bool = True
    rates: list[float] = field(default_factory=list)
    latencies_s: list[float] = field(default_factory=list)


def measure(
    size: BusSize, seed: int, progress: Progress = lambda share: None
) -> tuple[tuple[ReportTable, ...], tuple[str, ...]]:
    """Return the tables, and what was left out."""
    return asyncio.run(_measure(size, seed, progress))


async def _measure(size: BusSize, seed: int, progress: Progress) -> tuple[tuple[ReportTable, ...], tuple[str, ...]]:
    skipped: list[str] = []
    async with await start_virtual_rig(mode="lockstep", seed=seed, rtu_port=0) as rig:
        trips = await _round_trips(rig, size, skipped, lambda share: progress(0.6 * share))
        served = _pipelined(rig, size.pipelined)
        stepped = await _lockstep(rig, size, lambda share: progress(0.6 + 0.4 * share))
    return (trips, stepped, served), tuple(skipped)


def _points() -> tuple[Point, ...]:
    return tuple(point for point in load_rig(RIG).point if point.bus == "plc")


async def _round_trips(rig: VirtualRig, size: BusSize, skipped: list[str], progress: Progress) -> ReportTable:
    async with contextlib.AsyncExitStack() as stack:
        contestants = await _contestants(rig, skipped, stack)
        for number in range(size.slices):
            for one in contestants:
                await _slice(one, size.trips)
            progress((number + 1) / size.slices)
    return _rates_table(contestants, size)


async def _slice(one: _Contestant, trips: int) -> None:
    """Run one slice; each trip is timed by itself."""
    now, kept, ask = time.perf_counter, one.latencies_s, one.ask
    began = before = now()
    for _ in range(trips):
        found = ask()
        if one.is_async:
            await found  # type: ignore[misc]
        after = now()
        kept.append(after - before)
        before = after
    one.rates.append(trips / (now() - began))
    await asyncio.sleep(0)


async def _contestants(rig: VirtualRig, skipped: list[str], stack: contextlib.AsyncExitStack) -> list[_Contestant]:
    found: list[_Contestant] = []
    wire = socket.create_connection((rig.host, rig.modbus_port))
    wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    stack.callback(wire.close)

    def raw() -> tuple[int, ...]:
        wire.sendall(REQUEST)
        return struct.unpack(f">{COUNT}H", wire.recv(REPLY_BYTES)[9:])

    found.append(_Contestant("raw socket, nothing checked", raw, is_peer=False))
    ours = ModbusBus("plc", ModbusTcpBus(transport="modbus_tcp", port=rig.modbus_port), _points(), time.monotonic)
    await ours.connect()
    stack.push_async_callback(ours.close)
    (block,) = ours._plan.blocks
    found.append(_Contestant("ours, registers", lambda: ours._request(block), is_async=True, is_peer=False))
    found.append(_Contestant("ours, values with quality", ours.read, is_async=True, is_peer=False))
    config = ModbusRtuTcpBus(transport="modbus_rtu_tcp", port=rig.rtu_port or 0)
    serial = ModbusBus("plc", config, _points(), time.monotonic)
    await serial.connect()
    stack.push_async_callback(serial.close)
    (rtu_block,) = serial._plan.blocks
    name = "ours, registers, RTU over TCP"
    found.append(_Contestant(name, lambda: serial._request(rtu_block), is_async=True, is_peer=False))
    for title, make in (("pymodbus, blocking", modbus_peer.pymodbus_sync), ("pyModbusTCP", modbus_peer.py_modbus_tcp)):
        try:
            peer = make(rig.modbus_port, COUNT)
        except ImportError:
            skipped.append(f"{title}: not installed")
            continue
        stack.callback(peer.close)
        found.append(_Contestant(title, peer.ask))
    peer = await modbus_peer.pymodbus_async(rig.modbus_port, COUNT)
    stack.callback(peer.close)
    found.append(_Contestant("pymodbus, asyncio", peer.ask, is_async=True))
    try:
        client = libmodbus.Client.tcp(rig.modbus_port)
    except (libmodbus.NoLibmodbusError, OSError) as error:
        skipped.append(f"libmodbus: {error}")
    else:
        stack.callback(client.close)
        found.append(
            _Contestant("libmodbus (C), through ctypes", lambda: client.read_inputs(0, COUNT), is_python=False)
        )
    return found


def _rates_table(contestants: list[_Contestant], size: BusSize) -> ReportTable:
    medians = {one.name: statistics.median(one.rates) for one in contestants}
    fastest = max((one for one in contestants if one.is_peer and one.is_python), key=lambda one: medians[one.name])
    rows = []
    for one in contestants:
        ordered = sorted(one.latencies_s)
        share = statistics.median(a / b for a, b in zip(one.rates, fastest.rates, strict=True))
        rows.append(
            (
                one.name,
                medians[one.name],
                share,
                1e6 * ordered[len(ordered) // 2],
                1e6 * ordered[int(0.99 * len(ordered))],
            )
        )
    return ReportTable(
        "round_trips",
        f"Round trips of {COUNT} registers, one after the other, on the virtual rig's server",
        ("client", "a second", f"of {fastest.name}", "p50 us", "p99 us"),
        tuple(rows),
        (
            f"Medians of {size.slices} slices of {size.trips} round trips; contestants take turns.",
            f"{fastest.name} is the fastest other Python client here; the aim is {AIM_SHARE:g} of it.",
            "Shares are medians of slice against slice, since the machine is not the same for long.",
        ),
    )


def _pipelined(rig: VirtualRig, count: int) -> ReportTable:
    """Send requests in one segment, answered in order and each with its own transaction."""
    with socket.create_connection((rig.host, rig.modbus_port), timeout=5.0) as wire:
        wire.sendall(b"".join(struct.pack(">HHHBBHH", n, 0, 6, 1, 4, n % COUNT, 1) for n in range(count)))
        got = b""
        with contextlib.suppress(TimeoutError):
            while len(got) < 11 * count and (data := wire.recv(65536)):
                got += data
        one_by_one = []
        for n in range(COUNT):
            wire.sendall(struct.pack(">HHHBBHH", n, 0, 6, 1, 4, n, 1))
            one_by_one.append(wire.recv(11)[9:])
    frames = [got[at : at + 11] for at in range(0, len(got), 11)]
    right = sum(
        frame[:2] == struct.pack(">H", n) and frame[9:] == one_by_one[n % COUNT] for n, frame in enumerate(frames)
    )
    return ReportTable(
        "pipelined",
        "Requests sent to the virtual rig in one segment",
        ("server", "requests", "answers", "right and in order"),
        (("virtual rig", count, len(frames), right),),
        ("Right: the transaction of its request, and the register that it asked for. The rig stands still meanwhile.",),
    )


async def _lockstep(rig: VirtualRig, size: BusSize, progress: Progress) -> ReportTable:
    """Return the time that the bus takes of a replay in lockstep: all points read, four registers written a step."""
    bus = ModbusBus("plc", ModbusTcpBus(transport="modbus_tcp", port=rig.modbus_port), _points(), time.monotonic)
    await bus.connect()
    part = max(1, size.steps // LOCKSTEP_PARTS)
    spent = {"turns": 0.0, "apart": 0.0, "raw": 0.0}
    used = {"turns": 0.0, "apart": 0.0}
    steps = 0

    async def replay(kind: str) -> None:
        began, cpu = time.perf_counter(), time.process_time()
        for step in range(steps, min(steps + part, size.steps)):
            await bus.read()
            setpoints = {"heater_power_set": step % 900, "pump_speed_set": 80.0, "fan_speed_set": 50.0}
            await bus.write({**setpoints, "heartbeat": step % 60_000})
        spent[kind] += time.perf_counter() - began
        used[kind] += time.process_time() - cpu

    try:
        with _raw_step(rig) as raw_step:
            while steps < size.steps:
                await replay("apart")
                with taking_turns(rig.pids.values()):
                    await replay("turns")
                steps = min(steps + part, size.steps)
                began = time.perf_counter()
                for _ in range(part // 10):
                    raw_step()
                spent["raw"] += (time.perf_counter() - began) * part / max(part // 10, 1)
                progress(steps / size.steps)
    finally:
        await bus.close()
    forty = STEPS_OF_FORTY_HOURS / size.steps
    return ReportTable(
        "lockstep",
        "Bus time of forty hours in lockstep: 144,000 reads and writes, one after the other",
        ("client", "s", "CPU s", "aim s"),
        (
            ("ours, as in a run: on one processor with the rig", spent["turns"] * forty, used["turns"] * forty, AIM_S),
            ("ours, on processors of their own", spent["apart"] * forty, used["apart"] * forty, None),
            ("raw socket, nothing decoded or checked", spent["raw"] * forty, None, None),
        ),
        (
            f"Ours: {size.steps:,} steps measured of each, in turns. All points are read, decoded and judged, four "
            "registers written and confirmed.",
            "Raw: the same bytes for a tenth of the steps, in turns with ours. Nobody gets below that on this machine.",
        ),
    )


@contextlib.contextmanager
def _raw_step(rig: VirtualRig) -> Iterator[Callable[[], None]]:
    """Yield a function that reads and writes on a plain blocking socket."""
    write = struct.pack(">HHHBBHHB4H", 1, 0, 15, 1, 16, 0, 4, 8, 100, 800, 500, 1)
    with socket.create_connection((rig.host, rig.modbus_port)) as wire:
        wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

        def step() -> None:
            for request in (REQUEST, write):
                wire.sendall(request)
                wire.recv(300)

        yield step
