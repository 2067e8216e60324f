"""`hil train`: train the network calibrator."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import click

PIECES = ("hierarchy", "gates", "evidence", "residuals", "hiding", "structure", "balance")
"""As `hil.training.ablation` has them, which is not loaded for a list of options."""


@click.group()
def command() -> None:
    """Train the network calibrator of a kind of rig.

    \b
    Example:
      hil train loop --config small --seed 0 --minutes 9
    """


@command.command("loop")
@click.option("--config", "name", type=click.Choice(["small", "full"]), default="small", show_default=True)
@click.option("--seed", default=0, show_default=True, help="Of weights and of the order of windows; one a member.")
@click.option(
    "--data", type=click.Path(file_okay=False, path_type=Path), default=Path("training/loop"), show_default=True,
    help="Folder of generated campaigns; filled when it is empty.",
)  # fmt: skip
@click.option("--windows", "count", default=3000, show_default=True, help="How many to generate where DATA is empty.")
@click.option("--steps", default=6000, show_default=True, help="Of the optimiser, in all.")
@click.option("--batch", default=12, show_default=True, help="Windows a step.")
@click.option(
    "--minutes", type=float, help="Stop after so long; the same command goes on.  [default: until it is done]"
)
@click.option("--device", default="cpu", show_default=True, help="cpu or cuda.")
@click.option("--threads", default=0, help="Of the processor; 0 takes what there is.")
@click.option("--half/--single", default=None, help="bfloat16 products or not.  [default: bfloat16 on cuda]")
@click.option("--without", multiple=True, type=click.Choice(PIECES), help="Leave a piece out; may be repeated.")
@click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path), default=Path("training"), show_default=True,
    help="Folder for weights, card and picture, and for what a cut training goes on from.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def loop_command(
    name: str, seed: int, data: Path, count: int, steps: int, batch: int, minutes: float | None,
    device: str, threads: int, half: bool | None, without: tuple[str, ...], out: Path, as_json: bool,
) -> None:  # fmt: skip
    """Train one member for the coolant loop on simulated rigs.

    Weights, model card and curves go to OUT. A training that was cut, by --minutes or by hand, goes on when the same
    command is given again. No record of a real rig is read.

    \b
    Example:
      hil train loop --config small --seed 0 --minutes 9
      hil train loop --config small --seed 0 --minutes 9      (again, until it says that it is done)
    """
    from hil.terminal import Steps, console, hours, invocation
    from hil.training.data import read
    from hil.training.generate import features_of, generate
    from hil.training.session import begun, train
    from twin.calibrators.hiera_unet.device import ready
    from twin.calibrators.hiera_unet.plan import Plan

    ready(device, threads)
    if not (data / "manifest.json").exists():
        with Steps("simulating", 1.0, quiet=as_json) as bar:
            generate(0, count, data, bar.update)
    windows = read(data, features_of())
    plan = Plan(steps=steps, batch=batch, seed=seed, half=device != "cpu" if half is None else half)
    less = tuple(dict.fromkeys(without))
    stem = "_".join(("loop", name, *(("without", *less) if less else ()), str(seed)))
    typed = f"hil train loop --config {name} --seed {seed} --steps {steps} --batch {batch} --device {device}"
    typed += "".join(f" --without {piece}" for piece in less)
    with Steps("training", steps, quiet=as_json, begun=begun(out / stem)) as bar:
        done = train(
            windows, name, plan, out / stem, out / f"{stem}.safetensors", minutes=minutes, command=typed,
            say=bar.update, device=device, without=less,
        )  # fmt: skip
        bar.cut = done.card is None
    if as_json:
        click.echo(json.dumps(dataclasses.asdict(done), default=str, indent=1))
        return
    to = console()
    if done.card is None:
        left = hours(done.seconds * (done.steps - done.done) / max(done.made, 1))
        to.print(f"{done.done} of {done.steps} steps; about {left} to go: give the same command again", soft_wrap=True)
        return
    to.print(f"written: {done.card}, its weights, and {done.picture}", soft_wrap=True)
    for line in done.lines:
        to.print(line, soft_wrap=True)
    to.print(f"several seeds make an ensemble: {invocation()} train loop --config {name} --seed {seed + 1}")
