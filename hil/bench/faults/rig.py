"""Rig of the fault campaign: the shipped rig file at ten hertz, with short limits, and wires that can fail.

Everything is in real time: half a second of time-out, a second of staleness and the watchdog of two keep their
proportions, which they would not in scaled time, where the wire is slower than the rig.
"""

from __future__ import annotations

import asyncio
import re
import ssl
import struct
from pathlib import Path

PROFILES = Path(__file__).resolve().parents[3] / "profiles"
PERIOD_S = 0.1
STALE_AFTER_S = 1.0
STUCK_AFTER_S = 1.0
ABORT_AFTER_S = 1.5
STALE_LIMIT_S = 3.0
"""Time from an occurrence to safe, s: staleness, the delay of a trip, and half a second for ticks, write and read-back.
"""
WATCHDOG_S = 2.0
METER_WITHIN_S = 10.0
"""Time for the virtual power meter, s: its lag is 1.6 s, so from 1000 W it is below 10 W after 7.4 s."""
_PUMP, _FAN = 1, 2
LOAD = "time_s,heater_power_W,pump_speed_pct,fan_speed_pct\n0,{0},100,100\n600,{0},100,100\n"

_INTERLOCKS = """
[[interlock]]
kind = "no_flow"
level = "alarm"
heater = "heater_power"
above = 20.0
flow = "flow"
low = 1.0
deadband = 0.2
on_delay_s = 0.3

[[interlock]]
kind = "heater_power"
level = "alarm"
setpoint = "heater_power_set"
tolerance = 200.0
on_delay_s = 2.5

[[interlock]]
kind = "heater_power"
level = "alarm"
setpoint = "fan_speed_set"
tolerance = 25.0
on_delay_s = 0.8
"""


def rig_text(ports: dict[str, int], tls: dict[str, Path] | None = None) -> str:
    """Return the rig file, with the port of each bus; `tls` has the paths of ca, certificate and key."""
    text = (PROFILES / "rigs" / "virtual.toml").read_text(encoding="utf-8")
    head, *points = text.split("[[point]]\n")
    head = _set(head, "period_s", PERIOD_S)
    head = _set(head, "abort_after_s", ABORT_AFTER_S)
    for bus, port in ports.items():
        before, after = head.split(f"[bus.{bus}]\n")
        head = f"{before}[bus.{bus}]\n{_set(after, 'port', port)}"
    plc, can = head.split("[bus.thermocouples]\n")
    plc = _set(plc, "timeout_s", WATCHDOG_S, after="[heartbeat]")
    plc = plc.replace("[heartbeat]\n", f"[heartbeat]\nwatchdog_s = {WATCHDOG_S}\n")
    plc = _set(plc, "timeout_s", 0.25, after="[bus.plc]")
    if tls is not None:
        files = "".join(f'{name} = "{path}"\n' for name, path in tls.items())
        plc = plc.replace('transport = "modbus_tcp"\n', f'transport = "modbus_tls"\n{files}')
    head = f"{plc}[bus.thermocouples]\n{can}".replace(
        '"thermocouples.dbc"', f'"{PROFILES / "rigs" / "thermocouples.dbc"}"'
    )
    head = head.replace('"../twins/virtual.toml"', f'"{PROFILES / "twins" / "virtual.toml"}"')
    return "[[point]]\n".join([head, *map(_point, points)]) + _INTERLOCKS


def _point(text: str) -> str:
    text = f"stale_after_s = {STALE_AFTER_S}\n" + re.sub(
        r"(?m)^stuck_after_s = .*$", f"stuck_after_s = {STUCK_AFTER_S}", text
    )
    text = re.sub(r"(?m)^readback_within_s = .*\n", "", text)
    if "readback = " in text:
        # The power meter has a lag and must be below 10 W before the rig counts as safe.
        within_s = METER_WITHIN_S if 'readback = "heater_power"' in text else 0.3
        text = text.replace("readback = ", f"readback_within_s = {within_s}\nreadback = ", 1)
    return re.sub(r"(?m)^max_rate = 100\.0$", "max_rate = 1000.0", text)


def _set(text: str, key: str, value: float, after: str = "") -> str:
    """Set the first `key` after `after` in `text` to `value`."""
    at = text.index(after) + len(after)
    changed, count = re.subn(rf"(?m)^{key} = \S+", f"{key} = {value}", text[at:], count=1)
    if count != 1:
        raise ValueError(f"the shipped rig file has no {key} after {after!r}")
    return text[:at] + changed


async def prepare(port: int, tls: ssl.SSLContext | None = None) -> None:
    """Set pump and fans to full speed, as after a run."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port, ssl=tls)
    for register, value in ((_PUMP, 1000), (_FAN, 1000)):
        writer.write(struct.pack(">HHHBBHH", 1, 0, 6, 1, 6, register, value))
        await reader.readexactly(12)
    writer.close()
    await writer.wait_closed()
