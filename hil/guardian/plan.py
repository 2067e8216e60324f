"""Plan of the guardian: the safe values of a rig as Modbus requests in bytes, wire by wire.

The engine makes it before arming. The guardian parses no rig file: it sends these bytes, compares the registers of the
read-back with these words, and decodes a meter by these numbers.
"""

from __future__ import annotations

from typing import Any

from drivers.modbus import Writes, plan_reads
from drivers.modbus.protocol import Read, write_request
from drivers.rig_file import (
    CanBus,
    ModbusBusSection,
    ModbusRtuBus,
    ModbusTcpBus,
    ModbusTlsBus,
    Point,
    Rig,
    addresses,
    is_numbered,
    is_rtu,
    wire_of_bus,
)
from drivers.signals import WIDTH, encoder
from hil.run.outputs import SILENCE_S, Setpoints, is_heater, safe_limit

DEADLINE_S = 1.0
"""Longest wait for one reply, s, also where the rig file has a longer time-out."""


def plan_of(rig: Rig) -> dict[str, Any] | None:
    """Return the plan of `rig` as plain data for JSON; None for a rig without set-points, which has no safe values."""
    safe = Setpoints(rig).safe_values()
    if not safe:
        return None
    first = wire_of_bus(rig)
    found: dict[str, dict[str, Any]] = {}
    for name, value in safe.items():
        point = rig.get(name)
        bus = rig.bus[point.bus]
        assert not isinstance(bus, CanBus)  # CAN points are read only
        wire = found.setdefault(first[point.bus], wire_of(bus))
        for block, raw in Writes({name: point}, bus).of({name: value}):
            label = f"{name} {value:g} {point.unit}"
            wire["writes"].append(
                {
                    "device": bus.device_id,
                    "pdu": write_request(block, raw).hex(),
                    "name": label,
                    "heater": is_heater(rig, point),
                }
            )
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
        # The engine reads a meter on CAN or on a device without writes.
        if isinstance(bus, CanBus) or first[meter.bus] not in found:
            continue
        (block,) = plan_reads([meter], max_gap=0)
        found[first[meter.bus]]["meters"].append(
            {
                "device": bus.device_id,
                "pdu": Read(block).request.hex(),
                "name": meter.name,
                "unit": meter.unit,
                "limit": limit.at_most,
                "within_s": limit.within_s / rig.time_scale,
                "invalid": sorted(meter.sentinels),
                **_number(meter),
            }
        )
    return {"silence_s": SILENCE_S, "wires": list(found.values())}


def wire_of(bus: ModbusBusSection) -> dict[str, Any]:
    """Return the connection data of a wire, with empty lists of requests."""
    found: dict[str, Any] = {
        "place": bus.place,
        "timeout_s": min(bus.timeout_s, DEADLINE_S),
        "writes": [],
        "checks": [],
        "meters": [],
        "framing": "rtu" if is_rtu(bus) else "mbap" if is_numbered(bus) else "mbap0",
        "connect_delay_s": bus.connect_delay_s if isinstance(bus, ModbusTcpBus) else 0.0,
        # A device with a wrong length in its replies is read by the length that the function code implies.
        "counts": not isinstance(bus, ModbusTcpBus) or bus.frame_length == "checked",
    }
    if isinstance(bus, ModbusRtuBus):
        return found | {
            "kind": "serial",
            "serial_port": bus.serial_port,
            "baud": bus.serial_baud,
            "parity": bus.parity,
            "stop_bits": bus.stop_bits,
        }
    assert isinstance(bus, ModbusTcpBus)
    # Resolved now: a name server may be gone when it matters.
    found |= {"kind": "tcp", "host": bus.host, "port": bus.port, "addresses": list(addresses(bus.host))}
    if isinstance(bus, ModbusTlsBus):
        files = {name: str(getattr(bus, name).absolute()) for name in ("ca", "certificate", "key")}
        found |= {"kind": "tls", **files}
    return found


def _number(point: Point) -> dict[str, Any]:
    """Return the data that convert the registers of a point to its value."""
    bit = point.table in ("coil", "discrete")
    kind = "bit" if bit else point.type
    return {
        "type": kind,
        "order": point.order,
        "scale": point.scale,
        "offset": point.offset,
        "words": 1 if bit else WIDTH[point.type],
        "bits": None if point.bits is None else list(point.bits),
    }
