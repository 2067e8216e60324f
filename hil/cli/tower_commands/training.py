"""Command `hil train tower`: train the network calibrator of cooling-tower cells."""

from __future__ import annotations

import json
import shlex
import sys
from dataclasses import asdict
from pathlib import Path

import click

INTERRUPTED, REFUSED = 130, 1
STATIONS = 24


@click.command("tower")
@click.option("--config", "size", type=click.Choice(["small", "full"]), default="small", show_default=True)
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Seed of the weights and of the order of windows; one for each member.",
)
@click.option(
    "--data",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("training/tower"),
    show_default=True,
    help="Folder of simulated stations; filled if it is empty.",
)
@click.option(
    "--stations",
    type=click.IntRange(1),
    default=STATIONS,
    show_default=True,
    help="Stations of two cells to train on; a few more set intervals and are tested.",
)
@click.option(
    "--months", type=click.FloatRange(1.0), default=8.0, show_default=True, help="Length of each station's record."
)
@click.option("--workers", type=click.IntRange(1), default=1, show_default=True, help="Processes that simulate.")
@click.option("--steps", type=click.IntRange(1), default=4000, show_default=True, help="Steps of the optimiser.")
@click.option("--batch", type=click.IntRange(2), default=24, show_default=True, help="Windows of each step.")
@click.option(
    "--minutes",
    type=float,
    help="Stop simulating or training after this time; the same command continues.  [default: until it is done]",
)
@click.option("--device", default="cpu", show_default=True, help="Device: cpu or cuda.")
@click.option("--threads", default=0, help="Threads of the processor; 0 takes all.")
@click.option("--half/--single", default=None, help="Use bfloat16 products.  [default: bfloat16 on cuda]")
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("training"),
    show_default=True,
    help="Folder for weights and card, and for the state of an interrupted training.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def tower_command(
    size: str,
    seed: int,
    data: Path,
    stations: int,
    months: float,
    workers: int,
    steps: int,
    batch: int,
    minutes: float | None,
    device: str,
    threads: int,
    half: bool | None,
    out: Path,
    as_json: bool,
) -> None:
    """Train one member for cooling-tower cells on simulated stations.

    Weights and model card go to OUT. A training that --minutes or Ctrl-C interrupted continues when the same command is
    given again. A member whose parameters hardly change with another window's channels is refused, code BLIND. Where
    its outputs alone do, the outlet is that of the answer which the network starts at, and the card says so.

    \b
    Example:
      hil train tower --config small --seed 0 --minutes 9
      hil train tower --config small --seed 0 --minutes 9      (again, until it says that it is done)
    """
    from hil.run.session import ProgressBar, console
    from hil.training import Stop
    from hil.training.tower import DataPlan, simulate_stations, train_member
    from twin.calibrators.hiera_unet.tower import TowerPlan
    from twin.calibrators.hiera_unet.weights.device import ready

    ready(device, threads)
    plan = TowerPlan(steps=steps, batch=batch, seed=seed, half=device != "cpu" if half is None else half)
    wanted = DataPlan(train=stations, months=months)
    words = ["hil", "train", "tower", "--config", size, "--seed", str(seed), "--stations", str(stations)]
    words += ["--months", f"{months:g}", "--steps", str(steps), "--batch", str(batch), "--device", device]
    to = console()
    with Stop(minutes) as stop:
        with ProgressBar("simulating", float(len(wanted.stations())), quiet=as_json) as bar:
            done = simulate_stations(wanted, data, workers, minutes, lambda: stop.over, bar.update)
            bar.cut = done.stations < done.wanted
        if done.stations == done.wanted:
            with ProgressBar("training", float(steps), quiet=as_json) as bar:
                done = train_member(
                    data,
                    size,
                    plan,
                    out / f"tower_{size}_{seed}.safetensors",
                    stopped=lambda: stop.over,
                    command=shlex.join(words),
                    say=bar.update,
                    device=device,
                )
                bar.cut = done.card is None
    if as_json:
        click.echo(json.dumps(asdict(done), default=str, indent=1))
    elif done.card is None:
        said = f"{done.done} of {done.steps} steps" if done.steps else f"{done.stations} of {done.wanted} stations"
        to.print(f"{said}: give the same command again", soft_wrap=True)
    else:
        to.print(f"written: {done.card} and its weights", soft_wrap=True)
        to.print(f"held-out windows: {done.note}", soft_wrap=True)
        if done.refused:
            to.print(
                f"{done.refused}: parameters are {done.gate['parameters_worse'][0]:.1%} worse with another window's "
                f"channels, which is less than {done.gate['least']:.0%} or not certain; the member is not used: train "
                "longer or on more stations"
                if done.gate
                else done.refused,
                soft_wrap=True,
            )
        elif done.outlet and done.gate:
            to.print(
                f"outputs are {done.gate['outputs_worse'][0]:.1%} worse with another window's channels, which is less "
                f"than {done.gate['least']:.0%} or not certain: {done.outlet}",
                soft_wrap=True,
            )
    sys.exit(INTERRUPTED if stop.interrupted else REFUSED if done.refused else 0)
