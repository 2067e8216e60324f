"""Plan of the guardian: the safe values of a rig as Modbus requests in bytes, wire by wire.

Made by the engine before it arms. The guardian parses no rig file: it sends these bytes, compares the registers that
it reads back with these words, and decodes a meter by these numbers.
"""

from __future__ import annotations

from typing import Any

from drivers.modbus.protocol.pdu import Read, write_request
from drivers.modbus.read_plan import plan_reads
from drivers.modbus.writes import Writes
from drivers.rig_file.bus_sections import (
    CanBus,
    ModbusBusSection,
    ModbusRtuBus,
    ModbusTcpBus,
    ModbusTlsBus,
    is_numbered,
    is_rtu,
)
from drivers.rig_file.host_address import addresses
from drivers.rig_file.model import Point, Rig
from drivers.rig_file.wires import wires
from drivers.signals.codec import WIDTH, encoder
from hil.run.outputs.heaters import safe_limit
from hil.run.outputs.setpoints import Setpoints
from hil.run.outputs.time_to_safe import SILENCE_S

DEADLINE_S = 1.0
"""Longest wait for one reply, s, however patient the rig file is."""


def plan_of(rig: Rig) -> dict[str, Any] | None:
    """Return the plan of `rig` as JSON has it; None for a rig without set-points, where nothing has to be made safe."""
    safe = Setpoints(rig).safe_values()
    if not safe:
        return None
    first = wires(rig)
    found: dict[str, dict[str, Any]] = {}
    for name, value in safe.items():
        point = rig.get(name)
        bus = rig.bus[point.bus]
        assert not isinstance(bus, CanBus)  # CAN points are read only
        wire = found.setdefault(first[point.bus], wire_of(bus))
        for block, raw in Writes({name: point}, bus).of({name: value}):
            said = f"{name} {value:g} {point.unit}"
            wire["writes"].append({"device": bus.device_id, "pdu": write_request(block, raw).hex(), "name": said})
        (block,) = plan_reads([point], max_gap=0)
        want = encoder(point.type, point.order)((value - point.offset) / point.scale)
        wire["checks"].append(
            {"device": bus.device_id, "pdu": Read(block).request.hex(), "want": want, "name": name, **_number(point)}
        )
    for heater in safe:
        limit = safe_limit(rig, rig.get(heater))
        if limit is None:
            continue
        meter = rig.get(limit.meter)
        bus = rig.bus[meter.bus]
        # A meter on CAN, or on a device that is never written to, is the engine's to read.
        if isinstance(bus, CanBus) or first[meter.bus] not in found:
            continue
        (block,) = plan_reads([meter], max_gap=0)
        found[first[meter.bus]]["meters"].append(
            {
                "device": bus.device_id, "pdu": Read(block).request.hex(), "name": meter.name, "unit": meter.unit,
                "limit": limit.at_most, "within_s": limit.within_s / rig.time_scale,
                "invalid": sorted(meter.sentinels), **_number(meter),
            }
        )  # fmt: skip
    return {"silence_s": SILENCE_S, "wires": list(found.values())}


def wire_of(bus: ModbusBusSection) -> dict[str, Any]:
    """Return how a wire is reached, without requests."""
    found: dict[str, Any] = {
        "place": bus.place, "timeout_s": min(bus.timeout_s, DEADLINE_S), "writes": [], "checks": [], "meters": [],
        "framing": "rtu" if is_rtu(bus) else "mbap" if is_numbered(bus) else "mbap0",
        "connect_delay_s": bus.connect_delay_s if isinstance(bus, ModbusTcpBus) else 0.0,
        # A device that counts its replies wrongly is known by the length that the function code gives them.
        "counts": not isinstance(bus, ModbusTcpBus) or bus.frame_length == "checked",
    }  # fmt: skip
    if isinstance(bus, ModbusRtuBus):
        return found | {
            "kind": "serial", "serial_port": bus.serial_port, "baud": bus.serial_baud, "parity": bus.parity,
            "stop_bits": bus.stop_bits,
        }  # fmt: skip
    assert isinstance(bus, ModbusTcpBus)
    # Resolved now: a name server may be gone when it matters.
    found |= {"kind": "tcp", "host": bus.host, "port": bus.port, "addresses": list(addresses(bus.host))}
    if isinstance(bus, ModbusTlsBus):
        files = {name: str(getattr(bus, name).absolute()) for name in ("ca", "certificate", "key")}
        found |= {"kind": "tls", **files}
    return found


def _number(point: Point) -> dict[str, Any]:
    """Return how the registers of a point become its value."""
    bit = point.table in ("coil", "discrete")
    kind = "bit" if bit else point.type
    return {
        "type": kind, "order": point.order, "scale": point.scale, "offset": point.offset,
        "words": 1 if bit else WIDTH[point.type], "bits": None if point.bits is None else list(point.bits),
    }  # fmt: skip
