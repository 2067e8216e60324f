"""Command `hil bench effects`: unmodelled effects found while a record goes on, by a network and a linear rival."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import click

from hil.bench.commands.output import JSON, OUT, QUICK, SEED, finish
from hil.cli.options import PROJECT

NETWORK = PROJECT / "profiles" / "trained" / "effects_0.safetensors"
INTERRUPTED = 130
QUICK_RIGS = 2


@click.command("effects")
@click.option(
    "--data",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("training/effects"),
    show_default=True,
    help="Folder of simulated rigs; missing ones are made.",
)
@click.option(
    "--network",
    type=click.Path(dir_okay=False, path_type=Path),
    default=NETWORK,
    help="Trained network; with --train it is written.  [default: the shipped one]",
)
@click.option("--train", "training", is_flag=True, help="Train the network instead; the same command continues.")
@click.option("--steps", type=click.IntRange(1), default=2000, show_default=True, help="Steps of the training.")
@click.option("--minutes", type=float, help="Stop after this time; the same command continues.")
@click.option(
    "--diagnosed", type=click.IntRange(0), default=6, show_default=True, help="Records that `hil diagnose` judges too."
)
@QUICK
@SEED
@OUT
@JSON
def effects_command(
    data: Path,
    network: Path,
    training: bool,
    steps: int,
    minutes: float | None,
    diagnosed: int,
    quick: bool,
    seed: int,
    out: Path | None,
    as_json: bool,
) -> None:
    """Find power that a twin lacks within two windows of its onset, on simulated plants that no training saw.

    The seed is that of the plants; with --train, of weights and batches, and the plants are those of seed 0.

    \b
    Example:
      hil bench effects --train --minutes 9
      hil bench effects --out docs/results
    """
    from dataclasses import replace

    from hil.bench.effects import store, trial
    from hil.bench.effects import training as session
    from hil.run.session import ProgressBar
    from hil.training import Stop
    from twin.calibrators.hiera_unet.effects.member import load_effects

    member = None if training else load_effects(network)
    splits = [replace(s, rigs=min(s.rigs, QUICK_RIGS)) for s in store.SPLITS] if quick else list(store.SPLITS)
    rigs = 0 if training else seed
    data = data / f"seed_{rigs}" if rigs else data
    request = session.EffectsRequest(
        session.EffectsPlan(steps=steps, seed=seed),
        data,
        data.with_name(f"{data.name}_{seed}"),
        network,
        _typed(),
        rigs,
    )
    wanted = splits[:2] if training else splits[1:]
    with Stop(minutes) as stop:
        with ProgressBar("simulating", float(sum(s.rigs for s in wanted)), quiet=as_json) as bar:
            whole = session.simulate(request, wanted, over=lambda: stop.over, say=bar.update)
            bar.cut = not whole
        if not whole:
            _continue()
        if training:
            with ProgressBar("training", float(steps), quiet=as_json) as bar:
                card = session.train(request, over=lambda: stop.over, say=bar.update)
                bar.cut = card is None
            if card is None:
                _continue()
            click.echo(str(card))
            return
    assert member is not None
    done = trial.judge_all(data, member, lambda text: click.echo(text, err=True))
    more = trial.further_tables(data, rigs, member, diagnosed, lambda text: click.echo(text, err=True))
    finish("effects", seed, (*trial.tables(done), *more), (), out, as_json)


def _typed() -> str:
    return " ".join(["hil", *(shlex.quote(word) for word in sys.argv[1:])])


def _continue() -> None:
    click.echo("stopped; the same command continues", err=True)
    raise SystemExit(INTERRUPTED)
