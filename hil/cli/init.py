"""`hil init`: a commented rig file, of a table or configuration that a user has, or of what they say is on the rig."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.options.paths import INPUT_FILE

if TYPE_CHECKING:
    from drivers.importers.described import Place
    from drivers.importers.draft import Draft
    from drivers.rig_file.model import Rig


_LAST_PORT = 65535
"""Last port of TCP (RFC 9293)."""


@click.command()
@click.option("--from", "source", type=INPUT_FILE, help="A .csv, .toml (Telegraf), .yaml or .dbc file.")
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), default=Path("rig.toml"), show_default=True)
@click.option(
    "--addressing",
    type=click.Choice(["zero", "one", "modicon"]),
    help="What the addresses of a CSV count from: 0, 1, or 40001 for the first holding register.",
)
@click.option(
    "--order",
    type=click.Choice(["ABCD", "CDAB", "BADC", "DCBA"]),
    default="ABCD",
    show_default=True,
    help="Of a CSV: byte order of values of more than one register, unless it has a column.",
)
@click.option("--host", default="127.0.0.1", show_default=True, help="Where the Modbus device is.")
@click.option("--port", type=click.IntRange(1, 65535), default=502, show_default=True, help="Its TCP port.")
@click.option("--device-id", type=click.IntRange(0, 255), default=1, show_default=True, help="Its unit.")
@click.option("--channel", default="can0", show_default=True, help="The CAN interface.")
@click.option("--socketcand", metavar="HOST:PORT", help="Daemon that the CAN interface is reached through.")
@click.option("--encoding", help="Of a DBC or a CSV. By itself UTF-8 and then cp1252 are tried.")
@click.option("--heater", "heaters", multiple=True, metavar="set=PLACE,read=PLACE,max=W", help="May be repeated.")
@click.option("--pump", "pumps", multiple=True, metavar="set=PLACE,read=PLACE,max=%", help="May be repeated.")
@click.option("--fan", "fans", multiple=True, metavar="set=PLACE,read=PLACE,max=%", help="May be repeated.")
@click.option("--flow", metavar="PLACE", help="Where the flow is read, L/min.")
@click.option("--thermocouple", "thermocouples", multiple=True, metavar="NAME=PLACE", help="May be repeated.")
@click.option("--dbc", type=INPUT_FILE, help="Describes the CAN frames; all its temperatures unless some are named.")
@click.option("--heartbeat", metavar="point=PLACE,counter=PLACE,arm=PLACE,watchdog=PLACE", help="What the rig watches.")
@click.option("--trip-at", type=float, default=75.0, show_default=True, help="Temperature that ends a run, degC.")
@click.option("--name", help="Name of the rig; the file's name unless given.")
@click.option("--period", type=click.FloatRange(0, 3600, min_open=True), default=1.0, show_default=True, help="s")
@click.option("--force", is_flag=True, help="Write over a file that is there.")
def command(
    source: Path,
    out: Path,
    addressing: str | None,
    order: str,
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
    trip_at: float,
    name: str | None,
    period: float,
    force: bool,
) -> None:
    """Write a rig file: of what there is already (--from), of what you say is on the rig, or, where you say nothing,
    of what you answer. Then `hil check` it and go through what is marked there.

    A PLACE is TABLE:ADDRESS from zero, perhaps with type, byte order and what a count is (holding:0*0.1,
    input:12:float32:CDAB), a number as Modicon counts (40001), or MESSAGE.SIGNAL of the DBC.

    \b
    Example:
      hil init --out my_rig.toml
      hil init --host 192.168.1.20 --heater set=holding:0*0.1,read=input:0:float32:CDAB,max=2000 \\
               --pump set=holding:1*0.1 --thermocouple T_tank=input:20:int16*0.01 --out my_rig.toml
      hil init --from registers.csv --addressing modicon --host 192.168.1.20 --out my_rig.toml
      hil init --from telegraf.conf --out my_rig.toml
      hil init --from sensors.dbc --channel can0 --out my_rig.toml
    """
    if out.exists() and not force:
        raise click.UsageError(f"{out} is there already; give another --out, or --force to write over it")
    if not out.parent.is_dir():
        raise click.UsageError(f"{out.parent}: there is no such folder; make it or give another --out")
    bus = {"transport": "modbus_tcp", "host": _host("--host", host), "port": port, "device_id": device_id}
    can: dict[str, Any] = {"transport": "socketcan", "channel": channel}
    if socketcand is not None:
        can = {"transport": "socketcand", **_address(socketcand), "channel": channel}
    said = heaters or pumps or fans or flow or thermocouples or dbc or heartbeat
    if source is not None:
        if said:
            raise click.UsageError("--from takes the rig from a file; what is said beside it cannot be used")
        draft = _imported(source, out, addressing, order, encoding, bus, can)
        name = name or source.stem
    else:
        from drivers.importers.described import Described, actuator_of, draft_of, heartbeat_of, place_of

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
            from hil.cli.options.init_questions import ask

            rig = ask(name or out.stem, period)
        else:
            raise click.UsageError(
                "say what is on the rig (--heater, --pump, --thermocouple ...), give a file with --from, or call it "
                "in a terminal to be asked; `hil init --help` has examples"
            )
        draft, name, period = draft_of(rig, out), rig.name, rig.period_s
    _write(draft, out, name, period, source)


def _somebody_is_there() -> bool:
    return sys.stdin.isatty()


def _imported(
    source: Path,
    out: Path,
    addressing: str | None,
    order: str,
    encoding: str | None,
    bus: dict[str, Any],
    can: dict[str, Any],
) -> Draft:
    suffix = source.suffix.lower()
    if suffix in (".csv", ".tsv", ".txt"):
        from drivers.importers.vendor_csv import import_csv

        return import_csv(source, addressing, bus, order=order, encoding=encoding)  # type: ignore[arg-type]
    if suffix in (".toml", ".conf"):
        from drivers.importers.telegraf import import_telegraf

        return import_telegraf(source)
    if suffix in (".yaml", ".yml"):
        from drivers.importers.homeassistant import import_homeassistant

        return import_homeassistant(source)
    if suffix == ".dbc":
        from drivers.importers.dbc import import_dbc

        return import_dbc(source, out, can, encoding=encoding)
    raise click.UsageError(f"{source}: is no .csv, .toml, .yaml or .dbc file; nothing here knows how to import it")


def _thermocouples(said: tuple[str, ...], dbc: Path | None, encoding: str | None) -> dict[str, Place]:
    """Those that were named; where none of them is on CAN, also every temperature of the DBC."""
    from drivers.importers.described import CAN, place_of, temperatures_of

    found: dict[str, Place] = {}
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
    """Return the name or address of a host; raise click.UsageError with the remedy where it is none."""
    from drivers.rig_file.plain_values import checked_host

    try:
        return checked_host(host)
    except ValueError as error:
        said = re.sub(r'write host = "(.*)" and port = (\d+)', rf"write {option} \1 --port \2", str(error))
        raise click.UsageError(f"{option} {said}") from None


def _bind_messages(rig: Rig) -> None:
    """Find the messages of every point on CAN in its DBC, as `hil check` does; raise ConfigurationError."""
    from drivers.rig_file.bus_sections import CanBus

    for name, bus in rig.bus.items():
        if isinstance(bus, CanBus):
            from drivers.can.dbc import bind

            bind(name, bus, [point for point in rig.point if point.bus == name])


def _write(draft: Draft, out: Path, name: str, period_s: float, source: Path | None) -> None:
    """Write the rig file, unless it would be one that `hil check` refuses."""
    from drivers.importers.draft import ImportFileError, write
    from drivers.rig_file.reader import load_rig
    from drivers.signals.points import ConfigurationError
    from hil.files.atomic import replacing

    with replacing(out) as unfinished:
        unfinished.write_text(write(draft, name, period_s=period_s), encoding="utf-8")
        try:
            rig = load_rig(unfinished)
            _bind_messages(rig)
        except ConfigurationError as error:
            what = str(error).splitlines()[0].removeprefix(f"{unfinished}, ").removeprefix(f"{source}: ")
            if source is not None:
                raise ImportFileError(source, None, f"makes a rig file that cannot be used ({what}); mend it") from None
            what = re.sub(r"^line \d+: ", "", what)
            raise click.UsageError(f"that makes no rig file that can be used: {what}; nothing was written") from None
    for note in draft.notes:
        click.echo(f"note: {note}" if source is None else f"note: {source.name}, {note}")
    click.echo(f"{out}: {len(rig.point)} points on {', '.join(rig.bus)}; next: hil check {out}")
