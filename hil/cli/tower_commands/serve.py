"""`hil tower serve`: a station as a Modbus/TCP device that replays its historian."""

from __future__ import annotations

import asyncio
import datetime
from pathlib import Path

import click

_READ = ("raw.parquet", "tags.csv", "datasheet.json", "events.csv", "truth.parquet", "labels.csv", "commissioning.csv")
"""Files of a station's folder, none of which a rig file may replace."""


@click.command()
@click.argument("station", type=click.Path(path_type=Path, file_okay=False, exists=True))
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=5030,
    show_default=True,
    help="Modbus/TCP port; 0 picks a free one.",
)
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on.")
@click.option("--speed", type=click.FloatRange(0.1, 3600.0), default=60.0, show_default=True, help="Times real time.")
@click.option(
    "--from",
    "start",
    type=click.DateTime(["%Y-%m-%d", "%Y-%m-%dT%H:%M:%S"]),
    help="Begin here, UTC; default: the first sample.",
)
@click.option(
    "--rig", type=click.Path(path_type=Path, dir_okay=False), help="Rig file to write; default: STATION/rig.toml."
)
def command(
    station: Path, port: int, host: str, speed: float, start: datetime.datetime | None, rig: Path | None
) -> None:
    """Serve the folder STATION as a Modbus/TCP device in accelerated time, until its record ends or Ctrl-C.

    Writes a rig file, and beside it <rig>_tags.csv: the dictionary of what `hil tower collect` stores. The device's
    clock gives the samples the station's own times.

    \b
    Example:
      hil tower serve station/stationA --speed 600
      hil tower collect station/stationA/rig.toml --into plant --minutes 5
      hil tower align plant --tags station/stationA/rig_tags.csv --out record
    """
    from drivers.virtual.tower import Replay, load_station, rig_text, serve_station, write_dictionary
    from hil.files import replacing
    from hil.record import RecordError
    from hil.run.session import console
    from hil.run_folder import RunFolderError, require_output

    file = rig or station / "rig.toml"
    dictionary = file.with_name(f"{file.stem}_tags.csv")
    for path in (file, dictionary):
        require_output(path, RunFolderError, (station / name for name in _READ))
    say = console(stderr=True)
    tags = load_station(station)
    begin = None if start is None else start.replace(tzinfo=datetime.UTC).timestamp()
    replay = Replay(tags, speed, begin)
    if replay.start_s >= replay.end_s:
        end = datetime.datetime.fromtimestamp(replay.end_s, datetime.UTC)
        raise click.UsageError(f"the record of {station} ends at {end:%Y-%m-%dT%H:%M}; begin before with --from")

    def ready(found: int) -> None:
        with replacing(file) as unfinished:
            unfinished.write_text(rig_text(tags, f"station_{station.name}", host, found, speed))
        with replacing(dictionary) as unfinished:
            write_dictionary(tags, unfinished)
        say.print(
            f"{len(tags)} tags on Modbus/TCP {host}:{found}, {speed:g} times real time; Ctrl-C ends", markup=False
        )
        click.echo(str(file))

    try:
        asyncio.run(serve_station(replay, host, port, ready))
    except KeyboardInterrupt:
        return
    except OSError as error:
        if error.filename is not None:
            raise
        raise RecordError(
            f"Modbus port {host}:{port} cannot be opened ({error.strerror or error}); choose another with --port"
        ) from error
