"""Questions of `hil init`, asked if no option describes the rig; each answer is checked before the next question."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from drivers.importers import PLACE_SYNTAX, Described, DescribedActuator, SignalPlace, place_of, temperatures_of
from drivers.signals import ConfigurationError

_KINDS = (("heater", "W", 1000.0), ("pump", "%", 100.0), ("fan", "%", 100.0))


def ask(name: str, period_s: float) -> Described:
    """Ask for a rig at the terminal and return its description."""
    click.echo("Describe the rig. Enter takes the value in [brackets]; Ctrl-C writes nothing.")
    rig = Described(click.prompt("Name of the rig", default=name), period_s)
    host = click.prompt("Host of its Modbus/TCP server (- for none)", default="127.0.0.1")
    if host != "-":
        port = click.prompt("  TCP port", default=502, type=click.IntRange(1, 65535))
        unit = click.prompt("  device id", default=1, type=click.IntRange(0, 255))
        rig.modbus = {"transport": "modbus_tcp", "host": host, "port": port, "device_id": unit}
    channel = click.prompt("CAN interface of its thermocouples, such as can0 (- for none)", default="-")
    if channel != "-":
        dbc = click.prompt("  DBC file that describes its frames", type=click.Path(exists=True, dir_okay=False))
        rig.can = {"transport": "socketcan", "channel": channel, "dbc": dbc}
    click.echo(
        f"A place is {PLACE_SYNTAX}: zero-based with its table, or Modicon's number; *0.1 is the value of one count."
    )
    for kind, unit_of, most in _KINDS:
        for number in range(1, click.prompt(f"How many {kind}s?", default=1, type=click.IntRange(0, 99)) + 1):
            which = kind if number == 1 else f"{kind} {number}"
            written = _place(f"  {which}: set-point ({unit_of}) is written to")
            assert written is not None
            read = _place(f"  {which}: its actual value is read from (- for nowhere)", optional=True)
            highest = click.prompt(
                f"  {which}: upper limit, {unit_of}", default=most, type=click.FloatRange(0, min_open=True)
            )
            rig.actuators.append(DescribedActuator(kind, written, read, highest))  # type: ignore[arg-type]
    rig.flow = _place("Flow, L/min, is read from (- for nowhere)", optional=True)
    if rig.can is not None and click.confirm("Take every temperature of the DBC as a thermocouple?", default=True):
        rig.thermocouples = _checked(temperatures_of)(rig.can["dbc"])
    while True:
        name = click.prompt("Another thermocouple, by name, such as T_tank (- for no more)", default="-")
        if name == "-":
            break
        at = _place(f"  {name}, degC, is read from")
        assert at is not None
        rig.thermocouples[name] = at
    rig.trip_C = click.prompt("Temperature that ends a run, degC", default=75.0, type=float)
    beat = _place("Register that the rig monitors for a heartbeat (- for none)", optional=True)
    if beat is not None:
        rig.heartbeat["point"] = beat
        for key, role in (
            ("counter", "counter of the rig that must advance"),
            ("arm", "register that lets outputs go live when 1 is written"),
            ("watchdog", "time-out of the rig's own watchdog, s (such as holding:4*0.1)"),
        ):
            found = _place(f"  {role} (- for none)", optional=True)
            if found is not None:
                rig.heartbeat[key] = found
    return rig


def _place(question: str, *, optional: bool = False) -> SignalPlace | None:
    read = _checked(place_of)

    def value(text: str) -> SignalPlace | None:
        return None if optional and text == "-" else read(text)

    found: SignalPlace | None = click.prompt(question, default="-" if optional else None, value_proc=value)
    return found


def _checked(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Wrap `function` so that click shows its errors and asks again."""

    def value(text: Any) -> Any:
        try:
            return function(Path(text) if function is temperatures_of else text)
        except ConfigurationError as error:
            raise click.UsageError(str(error)) from None

    return value
