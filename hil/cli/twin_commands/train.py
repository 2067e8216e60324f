"""Command `hil train`: train the network calibrator."""

from __future__ import annotations

import contextlib
import json
import shlex
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.options import on_workers, workers_of
from hil.cli.tower_commands import tower_command

if TYPE_CHECKING:
    from twin.calibrators.hiera_unet import TrainingPlan

WINDOWS = 3000
INTERRUPTED = 130
PIECES = ("hierarchy", "gates", "evidence", "residuals", "hiding", "structure", "balance")
"""Names as in `hil.training.ablation`, which is not imported for a list of options."""


@click.group()
def command() -> None:
    """Train the network calibrator of a kind of rig.

    \b
    Example:
      hil train loop --config small --seed 0 --minutes 9
    """


command.add_command(tower_command)


@command.command("loop")
@click.option("--config", "name", type=click.Choice(["small", "full"]), default="small", show_default=True)
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
    default=Path("training/loop"),
    show_default=True,
    help="Folder of simulated campaigns; filled if it is empty.",
)
@click.option(
    "--windows",
    "count",
    type=int,
    help="Number of windows to simulate; more than DATA has are added.  [default: those of DATA, else 3000]",
)
@click.option(
    "--data-seed", type=int, help="Seed of the simulated rigs, loads and faults.  [default: that of DATA, else 0]"
)
@click.option("--steps", default=6000, show_default=True, help="Steps of the optimiser, in all.")
@click.option("--batch", default=12, show_default=True, help="Windows of each step.")
@click.option(
    "--minutes",
    type=float,
    help="Stop simulating or training after this time; the same command continues.  [default: until it is done]",
)
@click.option(
    "--workers",
    type=click.IntRange(1, 1024),
    help="Processes that simulate.  [default: 1; on a scheduler: all of its workers]",
)
@on_workers
@click.option("--device", default="cpu", show_default=True, help="Device: cpu or cuda.")
@click.option("--threads", default=0, help="Threads of the processor; 0 takes all.")
@click.option("--half/--single", default=None, help="Use bfloat16 products.  [default: bfloat16 on cuda]")
@click.option(
    "--without", multiple=True, type=click.Choice(PIECES), help="Leave a part of the network out; may be repeated."
)
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("training"),
    show_default=True,
    help="Folder for weights, card and picture, and for the state of an interrupted training.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def loop_command(
    name: str,
    seed: int,
    data: Path,
    count: int | None,
    data_seed: int | None,
    steps: int,
    batch: int,
    minutes: float | None,
    workers: int | None,
    place: dict[str, Any],
    device: str,
    threads: int,
    half: bool | None,
    without: tuple[str, ...],
    out: Path,
    as_json: bool,
) -> None:
    """Train one member for the coolant loop on simulated rigs.

    Weights, model card and curves go to OUT. A training that --minutes or Ctrl-C interrupted continues when the same
    command is given again. No record of a real rig is read. --workers and --on are for the simulation; the training
    itself is one process.

    \b
    Example:
      hil train loop --config small --seed 0 --minutes 9
      hil train loop --config small --seed 0 --minutes 9      (again, until it says that it is done)
      hil train loop --windows 8000 --on tcp://10.0.0.5:8786
    """
    from hil.executor import SERIAL, opened
    from hil.run.session import ProgressBar, console, hours, invocation
    from hil.training import (
        Stop,
        TrainingProgress,
        TrainingRequest,
        complete,
        features_of,
        generate_windows,
        generation_begun,
        least_windows,
        read,
        train,
        training_begun,
    )
    from twin.calibrators.hiera_unet import TrainingPlan
    from twin.calibrators.hiera_unet.weights.device import ready

    ready(device, threads)
    plan = TrainingPlan(steps=steps, batch=batch, seed=seed, half=device != "cpu" if half is None else half)
    less = tuple(dict.fromkeys(without))
    stem = "_".join(("loop", name, *(("without", *less) if less else ()), str(seed)))
    data_seed, count = wanted(data, data_seed, count)
    if count < (least := least_windows()):
        raise click.UsageError(
            f"{count} windows are of too few rigs to train on some and set intervals with others; give --windows "
            f"{least} or more"
        )
    with Stop(minutes) as stop:
        if not complete(data, data_seed, count):
            options = workers_of(workers, place)
            with (
                contextlib.nullcontext() if options.on == SERIAL else opened(options, lambda message: None) as executor,
                ProgressBar("simulating", 1.0, quiet=as_json, begun=generation_begun(data, count)) as bar,
            ):
                bar.cut = generate_windows(data_seed, count, data, bar.update, stop, executor) is None
        if not complete(data, data_seed, count):
            done = TrainingProgress(training_begun(out / stem), steps, 0, 0.0, simulated=generation_begun(data, count))
        else:
            windows = read(data, features_of())
            typed = again(name, plan, device, threads, less, anywhere(data), data_seed, count)
            with ProgressBar("training", steps, quiet=as_json, begun=training_begun(out / stem)) as bar:
                weights = out / f"{stem}.safetensors"
                request = TrainingRequest(name, plan, out / stem, weights, typed, device, less)
                done = train(windows, request, stop=stop, say=bar.update)
                bar.cut = done.card is None
    if as_json:
        click.echo(json.dumps(asdict(done), default=str, indent=1))
        sys.exit(INTERRUPTED if stop.interrupted else 0)
    to = console()
    if done.card is None:
        said = f"{done.done} of {done.steps} steps" if done.simulated == 1.0 else f"{done.simulated:.0%} simulated"
        if done.made:
            said += f"; about {hours(done.seconds * (done.steps - done.done) / done.made)} to go"
        to.print(f"{said}: give the same command again", soft_wrap=True)
        sys.exit(INTERRUPTED if stop.interrupted else 0)
    to.print(f"written: {done.card}, its weights, and {done.picture}", soft_wrap=True)
    for line in done.lines:
        to.print(line, soft_wrap=True)
    following = again(name, replace(plan, seed=seed + 1), device, threads, less, str(data), data_seed, count)
    following = f"{invocation()} {following.removeprefix('hil ')} --out {shlex.quote(str(out))}"
    to.print(f"several seeds make an ensemble: {following}", soft_wrap=True)


def wanted(data: Path, seed: int | None, count: int | None) -> tuple[int, int]:
    """Return seed and number of windows: as given, else those of the folder, else the defaults."""
    from hil.training import asked_of

    there = asked_of(data) or (0, WINDOWS)
    return there[0] if seed is None else seed, there[1] if count is None else count


def anywhere(data: Path) -> str:
    """Return a folder for a command on any machine: a folder of this machine only by its last name."""
    return data.name if data.is_absolute() or ".." in data.parts else data.as_posix()


def again(
    name: str,
    plan: TrainingPlan,
    device: str,
    threads: int,
    less: tuple[str, ...],
    data: str,
    data_seed: int,
    count: int,
) -> str:
    """Return the command that simulates the same windows into `data` and trains the same network on them."""
    words = ["hil", "train", "loop", "--config", name, "--seed", str(plan.seed)]
    words += ["--data", data, "--windows", str(count), "--data-seed", str(data_seed)]
    words += ["--steps", str(plan.steps), "--batch", str(plan.batch), "--device", device]
    words += ["--half" if plan.half else "--single", *(["--threads", str(threads)] if threads else [])]
    words += [word for piece in less for word in ("--without", piece)]
    return shlex.join(words)
