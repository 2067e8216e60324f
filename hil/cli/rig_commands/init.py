"""Command `hil init`: write a commented rig file from a table, a configuration, options or answers."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from hil.cli.options import INPUT_FILE

if TYPE_CHECKING:
    from drivers.importers import Draft, SignalPlace
    from drivers.rig_file import Rig


_WITH_ADDRESS = (".toml", ".conf", ".yaml", ".yml")
"""Endings of sources that state the addresses of their devices."""
_LAST_PORT = 65535
"""Last port of TCP (RFC 9293)."""


@click.command()
@click.option("--from", "source", type=INPUT_FILE, help="A .csv, .toml (Telegraf), .yaml or .dbc file.")
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), default=Path("rig.toml"), show_default=True)
@click.option(
    "--addressing",
    type=click.Choice(["zero", "one", "modicon"]),
    help="Base of the addresses of a CSV: 0, 1, or modicon (40001 is the first holding register).",
)
@click.option(
    "--order",
    type=click.Choice(["ABCD", "CDAB", "BADC", "DCBA"]),
    help="Byte order of values of more than one register of a CSV without a column for it; default: ABCD, as a guess.",
)
@click.option("--host", default="127.0.0.1", show_default=True, help="Host of the Modbus device.")
@click.option(
    "--port", type=click.IntRange(1, 65535), default=502, show_default=True, help="TCP port of the Modbus device."
)
@click.option(
    "--device-id", type=click.IntRange(0, 255), default=1, show_default=True, help="Unit id of the Modbus device."
)
@click.option("--channel", default="can0", show_default=True, help="CAN interface.")
@click.option("--socketcand", metavar="HOST:PORT", help="Daemon (host:port) that serves the CAN interface.")
@click.option("--encoding", help="Text encoding of a DBC or a CSV; default: UTF-8, then cp1252.")
@click.option("--heater", "heaters", multiple=True, metavar="set=PLACE,read=PLACE,max=W", help="May be repeated.")
@click.option("--pump", "pumps", multiple=True, metavar="set=PLACE,read=PLACE,max=%", help="May be repeated.")
@click.option("--fan", "fans", multiple=True, metavar="set=PLACE,read=PLACE,max=%", help="May be repeated.")
@click.option("--flow", metavar="PLACE", help="Place of the flow reading, L/min.")
@click.option("--thermocouple", "thermocouples", multiple=True, metavar="NAME=PLACE", help="May be repeated.")
@click.option("--dbc", type=INPUT_FILE, help="DBC file of the CAN frames; all its temperatures, unless some are named.")
@click.option(
    "--heartbeat",
    metavar="point=PLACE,counter=PLACE,arm=PLACE,watchdog=PLACE",
    help="Heartbeat registers that the rig monitors.",
)
@click.option(
    "--set",
    "settings",
    metavar="POINT.KEY=VALUE",
    multiple=True,
    help="With --from: a key of a point, or heartbeat.KEY=POINT. May be repeated.",
)
@click.option("--trip-at", type=float, default=75.0, show_default=True, help="Temperature that ends a run, degC.")
@click.option("--name", help="Name of the rig; default: the file's name.")
@click.option("--period", type=click.FloatRange(0, 3600, min_open=True), default=1.0, show_default=True, help="s")
@click.option("--force", is_flag=True, help="Overwrite an existing file.")
def command(
    source: Path,
    out: Path,
    addressing: str | None,
    order: str | None,
    host: str,
    port: int,
    device_id: int,
    channel: str,
    socketcand: str | None,
    encoding: str | None,
    heaters: tuple[str, ...],
    pumps: tuple[str, ...],
    fans: tuple[str, ...],
    flow: str | None,
    thermocouples: tuple[str, ...],
    dbc: Path | None,
    heartbeat: str | None,
    settings: tuple[str, ...],
    trip_at: float,
    name: str | None,
    period: float,
    force: bool,
) -> None:
    """Write a rig file from an existing file (--from), from options, or from answers at the terminal. Check it with
    `hil check`, and review the marked lines.

    A PLACE is TABLE:ADDRESS from zero, optionally with type, byte order and value of one count (holding:0*0.1,
    input:12:float32:CDAB), a Modicon number (40001), or MESSAGE.SIGNAL of the DBC.

    \b
    Example:
      hil init --out my_rig.toml
      hil init --host 192.168.1.20 --heater set=holding:0*0.1,read=input:0:float32:CDAB,max=2000 \\
               --pump set=holding:1*0.1 --thermocouple T_tank=input:20:int16*0.01 --out my_rig.toml
      hil init --from registers.csv --addressing modicon --host 192.168.1.20 --out my_rig.toml
      hil init --from registers.csv --addressing zero --set pump_set.limits=[0,100] --set pump_set.readback=pump \\
               --out my_rig.toml
      hil init --from telegraf.conf --out my_rig.toml
      hil init --from sensors.dbc --channel can0 --out my_rig.toml
    """
    from hil.run_folder import RunFolderError, require_output

    if out.exists() and not force:
        raise click.UsageError(f"{out} exists already; give another --out, or --force to overwrite it")
    require_output(out, RunFolderError, [path for path in (source, dbc) if path is not None])
    bus = {"transport": "modbus_tcp", "host": _host("--host", host), "port": port, "device_id": device_id}
    can: dict[str, Any] = {"transport": "socketcan", "channel": channel}
    if socketcand is not None:
        can = {"transport": "socketcand", **_address(socketcand), "channel": channel}
    said = heaters or pumps or fans or flow or thermocouples or dbc or heartbeat
    if source is not None:
        if said:
            raise click.UsageError("--from takes the rig from a file; leave out the options that describe points")
        draft = _imported(source, out, addressing, order, encoding, bus, can)
        from drivers.importers import apply_settings

        apply_settings(draft, settings)
        name = name or source.stem
    elif settings:
        raise click.UsageError("--set adds keys to the points of an import; give its file with --from")
    else:
        from drivers.importers import Described, actuator_of, draft_of_description, heartbeat_of, place_of

        if said:
            rig = Described(name or out.stem, period, modbus=bus, trip_C=trip_at)
            rig.actuators += [actuator_of("heater", text) for text in heaters]
            rig.actuators += [actuator_of("pump", text) for text in pumps]
            rig.actuators += [actuator_of("fan", text) for text in fans]
            rig.flow = place_of(flow) if flow else None
            rig.heartbeat = heartbeat_of(heartbeat) if heartbeat else {}
            if dbc is not None:
                rig.can = can | {"dbc": str(dbc)} | ({"dbc_encoding": encoding} if encoding is not None else {})
            rig.thermocouples = _thermocouples(thermocouples, dbc, encoding)
        elif _somebody_is_there():
            from hil.cli.options import ask

            rig = ask(name or out.stem, period)
        else:
            raise click.UsageError(
                "describe the rig (--heater, --pump, --thermocouple ...), give a file with --from, or call it "
                "in a terminal to be asked; `hil init --help` has examples"
            )
        draft, name, period = draft_of_description(rig, out), rig.name, rig.period_s
    if source is not None or said:
        _mark_defaults(draft, source)
    _write(draft, out, name, period, source)


def _mark_defaults(draft: Draft, source: Path | None) -> None:
    """Mark keys whose values are defaults of this command, that neither the user nor the source has given."""
    context = click.get_current_context()

    def is_default(option: str) -> bool:
        return context.get_parameter_source(option) is not ParameterSource.COMMANDLINE

    has_address = source is not None and source.suffix.lower() in _WITH_ADDRESS
    options = ["channel"] if has_address else ["host", "port", "channel"]
    options += ["device_id"] if source is None else []
    for bus in draft.buses:
        for option in filter(is_default, options):
            if option in bus.keys:
                bus.remarks[option] = f"guessed: no --{option.replace('_', '-')} was given"
    if is_default("period"):
        draft.period_remark = "guessed: no --period was given"


def _somebody_is_there() -> bool:
    return sys.stdin.isatty()


def _imported(
    source: Path,
    out: Path,
    addressing: str | None,
    order: str | None,
    encoding: str | None,
    bus: dict[str, Any],
    can: dict[str, Any],
) -> Draft:
    suffix = source.suffix.lower()
    if suffix in (".csv", ".tsv", ".txt"):
        from drivers.importers import import_csv

        given = click.get_current_context().get_parameter_source("device_id") is ParameterSource.COMMANDLINE
        return import_csv(source, addressing, bus, order=order, encoding=encoding, is_device_given=given)  # type: ignore[arg-type]
    if suffix in (".toml", ".conf"):
        from drivers.importers import import_telegraf

        return import_telegraf(source)
    if suffix in (".yaml", ".yml"):
        from drivers.importers import import_homeassistant

        return import_homeassistant(source)
    if suffix == ".dbc":
        from drivers.importers import import_dbc

        return import_dbc(source, out, can, encoding=encoding)
    raise click.UsageError(f"{source}: is no .csv, .toml, .yaml or .dbc file; give a file of one of these types")


def _thermocouples(said: tuple[str, ...], dbc: Path | None, encoding: str | None) -> dict[str, SignalPlace]:
    """Return the named thermocouples, and where none of them is on CAN every temperature of the DBC."""
    from drivers.importers import CAN, place_of, temperatures_of

    found: dict[str, SignalPlace] = {}
    for text in said:
        name, _, where = text.partition("=")
        if not where or name in found:
            raise click.UsageError(f"--thermocouple {text!r}: write NAME=PLACE, each name once, T_tank=input:20*0.1")
        found[name] = place_of(where)
    if dbc is not None and not any(place.bus == CAN for place in found.values()):
        found = temperatures_of(dbc, encoding) | found
    return found


def _address(text: str) -> dict[str, Any]:
    host, _, port = text.rpartition(":")
    if not host or not port.isascii() or not port.isdigit():
        raise click.UsageError(f"--socketcand {text!r} is no host:port; write it like 192.168.1.21:29536")
    if not 1 <= int(port[:6]) <= _LAST_PORT:
        raise click.UsageError(f"--socketcand {text!r}: port {port} is not from 1 to {_LAST_PORT}; correct it")
    return {"host": _host("--socketcand", host), "port": int(port)}


def _host(option: str, host: str) -> str:
    """Return the name or address of a host; raise click.UsageError with the remedy if it is none."""
    from drivers.rig_file import checked_host

    try:
        return checked_host(host)
    except ValueError as error:
        said = re.sub(r'write host = "(.*)" and port = (\d+)', rf"write {option} \1 --port \2", str(error))
        raise click.UsageError(f"{option} {said}") from None


def _bind_messages(rig: Rig) -> None:
    """Find the messages of every point on CAN in its DBC, as `hil check` does; raise ConfigurationError."""
    from drivers.rig_file import CanBus

    for name, bus in rig.bus.items():
        if isinstance(bus, CanBus):
            from drivers.can import bind

            bind(name, bus, [point for point in rig.point if point.bus == name])


def _write(draft: Draft, out: Path, name: str, period_s: float, source: Path | None) -> None:
    """Write the rig file, unless it would be one that `hil check` refuses."""
    from drivers.importers import ImportFileError, rig_file_text
    from drivers.rig_file import load_rig
    from drivers.signals import ConfigurationError
    from hil.files import replacing

    with replacing(out) as unfinished:
        unfinished.write_text(rig_file_text(draft, name, period_s=period_s), encoding="utf-8")
        try:
            rig = load_rig(unfinished)
            _bind_messages(rig)
        except ConfigurationError as error:
            what = str(error).splitlines()[0].removeprefix(f"{unfinished}, ").removeprefix(f"{source}: ")
            if source is not None:
                raise ImportFileError(source, None, f"makes an invalid rig file ({what}); correct it") from None
            what = re.sub(r"^line \d+: ", "", what)
            raise click.UsageError(f"these options make an invalid rig file: {what}; nothing was written") from None
    for note in draft.notes:
        click.echo(f"note: {note}" if source is None else f"note: {source.name}, {note}")
    click.echo(f"{out}: {len(rig.point)} points on {', '.join(rig.bus)}; next: hil check {shlex.quote(str(out))}")
