"""`hil init`: a commented rig file, made of the register table or configuration that a user already has."""

from __future__ import annotations

from pathlib import Path

import click

from hil.commands.paths import INPUT_FILE


@click.command()
@click.option("--from", "source", type=INPUT_FILE, required=True, help="A .csv, .toml (Telegraf), .yaml or .dbc file.")
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
@click.option("--host", default="127.0.0.1", show_default=True, help="Of a CSV: where the device is.")
@click.option("--port", type=click.IntRange(1, 65535), default=502, show_default=True, help="Of a CSV: its TCP port.")
@click.option("--device-id", type=click.IntRange(0, 255), default=1, show_default=True, help="Of a CSV: its unit.")
@click.option("--channel", default="can0", show_default=True, help="Of a DBC: the CAN interface.")
@click.option("--encoding", default="utf-8", show_default=True, help="Of a DBC: cp1252 for most older files.")
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
    encoding: str,
    name: str | None,
    period: float,
    force: bool,
) -> None:
    """Write a rig file of what there is already, then `hil check` it and fill in what no import can know.

    \b
    Example:
      hil init --from registers.csv --addressing modicon --host 192.168.1.20 --out my_rig.toml
      hil init --from telegraf.conf --out my_rig.toml
      hil init --from sensors.dbc --channel can0 --out my_rig.toml
    """
    from drivers.imports.draft import Draft, ImportFileError, write
    from drivers.rigfile import RigFileError, load_rig
    from hil.atomic import replacing

    if out.exists() and not force:
        raise click.UsageError(f"{out} is there already; give another --out, or --force to write over it")
    if not out.parent.is_dir():
        raise click.UsageError(f"{out.parent}: there is no such folder; make it or give another --out")
    suffix = source.suffix.lower()
    draft: Draft
    if suffix in (".csv", ".tsv", ".txt"):
        from drivers.imports.vendor_csv import import_csv

        bus = {"transport": "modbus_tcp", "host": host, "port": port, "device_id": device_id}
        draft = import_csv(source, addressing, bus, order=order)  # type: ignore[arg-type]
    elif suffix in (".toml", ".conf"):
        from drivers.imports.telegraf import import_telegraf

        draft = import_telegraf(source)
    elif suffix in (".yaml", ".yml"):
        from drivers.imports.homeassistant import import_homeassistant

        draft = import_homeassistant(source)
    elif suffix == ".dbc":
        from drivers.imports.dbc import import_dbc

        draft = import_dbc(source, out, {"transport": "socketcan", "channel": channel}, encoding=encoding)
    else:
        raise click.UsageError(f"{source}: is no .csv, .toml, .yaml or .dbc file; nothing here knows how to import it")
    with replacing(out) as unfinished:
        unfinished.write_text(write(draft, name or source.stem, period_s=period), encoding="utf-8")
        try:
            rig = load_rig(unfinished)
        except RigFileError as error:
            what = str(error).splitlines()[0].removeprefix(f"{unfinished}, ")
            raise ImportFileError(source, None, f"makes a rig file that cannot be used ({what}); mend it") from None
    for note in draft.notes:
        click.echo(f"note: {note}")
    click.echo(f"{out}: {len(rig.point)} points on {', '.join(rig.bus)}; next: hil check {out}")
