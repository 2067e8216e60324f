"""`hil tower simulate`: stations of cooling towers with a historian, as files of a plant's export."""

from __future__ import annotations

import datetime
import json
import os
from pathlib import Path

import click

# As in `drivers.virtual.tower.effects`, which loads the physics; a test holds the two against each other.
EFFECTS = ("recirculation", "bypass_leak", "neighbour", "solar")


@click.command()
@click.option("--out", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder of the stations.")
@click.option(
    "--months", type=click.FloatRange(0.1, 36.0), default=14.0, show_default=True, help="Length of the record."
)
@click.option(
    "--cells", type=click.IntRange(1, 6), default=6, show_default=True, help="Cells with a record, of A and then of B."
)
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of plant, weather and operation."
)
@click.option(
    "--start", type=click.DateTime(["%Y-%m-%d"]), default="2022-05-01", show_default=True, help="First day, UTC."
)
@click.option(
    "--hide", multiple=True, type=click.Choice(EFFECTS), help="Undeclared effect; may be given several times."
)
@click.option("--defects", is_flag=True, help="Seed defects into instruments and archive.")
@click.option("--score", is_flag=True, help="Write the truth too: truth.parquet and KEY.json.")
@click.option(
    "--weather",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    help="Folder of .epw and .tm2 files; default: $HIL_DATA/weather.",
)
def command(
    out: Path,
    months: float,
    cells: int,
    seed: int,
    start: datetime.datetime,
    hide: tuple[str, ...],
    defects: bool,
    score: bool,
    weather: Path | None,
) -> None:
    """Simulate one or two stations of cooling towers and their historian.

    Station A has four cells in Chicago, station B two in Miami; `--cells` says how many have a record, two thirds of
    them of A. Writes OUT/stationA and OUT/stationB with raw.parquet, tags.csv, datasheet.json, commissioning.csv,
    events.csv and labels.csv. Where there is no file of weather, a seeded generator makes it.

    \b
    Example:
      hil tower simulate --out station --months 1 --cells 2
      hil tower simulate --out station --hide recirculation --defects --score
    """
    from drivers.virtual.tower import SITES, STATION_FILES, SimulationPlan, key_of, simulate, write_station
    from hil.files import held, replacing, replacing_all
    from hil.run.session import console
    from hil.tower import TowerOutputError, writing

    say = console(stderr=True)
    folder = weather or (Path(os.environ["HIL_DATA"]) / "weather" if os.environ.get("HIL_DATA") else None)
    plan = SimulationPlan(
        months, cells, seed, start.replace(tzinfo=datetime.UTC), tuple(dict.fromkeys(hide)), defects, folder
    )
    key = {}
    with writing(out), held(out, TowerOutputError):
        (out / "KEY.json").unlink(missing_ok=True)
        for site in SITES:
            recorded = plan.recorded()[site.station]
            if not recorded:
                continue
            made = simulate(site, recorded, plan, lambda text: say.print(text, markup=False, highlight=False))
            name = f"station{site.station}"
            with held(out / name, TowerOutputError), replacing_all(out / name, STATION_FILES.__contains__) as part:
                write_station(made, part, score=score)
            key[name] = key_of(made)
            samples = sum(len(one.time_s) for one in made.samples.values())
            what = f"{plan.days} days, {recorded} of {site.cells} cells recorded, {samples} samples"
            click.echo(f"{out / name}: {what}")
            del made
        if score:
            with replacing(out / "KEY.json") as unfinished:
                unfinished.write_text(json.dumps(key, indent=1) + "\n")
