"""Session of one training from its data to its card, in as many parts as it takes.

The folder holds the state to continue from: `training.pt`, `curves.jsonl`. A finished network has weights, card and
figure.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from hil import __version__
from hil.training.ablation import without as leave_out
from hil.training.data import TrainingData
from hil.training.ensemble import assemble
from hil.training.learning_curve import draw
from hil.training.stopping import Stop

LOOK_EVERY = 250
"""Steps between scores on held-out windows."""
KEEP_EVERY_S = 60.0
LIBRARIES = ("torch", "numpy")
LOOKED_AT = 192
"""Held-out windows of each score, always the same."""
LEAKED = 24
"""Windows of the leakage diagnostic."""

Say = Callable[[int, str], None]
"""Callback with the steps done and a note."""


@dataclass(frozen=True)
class TrainingProgress:
    """Progress of a training: `done` of `steps`, `made` of them now in `seconds`; `simulated`, the share of its data.

    At its end `card` and `picture` are the written files, and `lines` report its scores.
    """

    done: int
    steps: int
    made: int
    seconds: float
    card: Path | None = None
    picture: Path | None = None
    lines: tuple[str, ...] = ()
    simulated: float = 1.0


@dataclass(frozen=True)
class TrainingRequest:
    """Options of a training.

    Attributes
    ----------
    name
        Name of the configuration, ``small`` or ``full``.
    plan
        `twin.calibrators.hiera_unet.training.plan.TrainingPlan`.
    folder, out
        Folder of the state of the training, and path of the weights that it ends with.
    command
        Command that makes this training again, for the model card.
    device
        Device of torch.
    without
        Pieces to leave out, see `hil.training.ablation`.
    """

    name: str
    plan: Any
    folder: Path
    out: Path
    command: str
    device: str = "cpu"
    without: tuple[str, ...] = ()


def train(data: TrainingData, request: TrainingRequest, *, stop: Stop, say: Say) -> TrainingProgress:
    """Continue a training until it is stopped, or to its end; then write the network.

    Parameters
    ----------
    data
        Windows of simulated rigs.
    request
        Options of the training.
    stop
        Object that ends the work in order.
    say
        Function that gets the steps done and a note.

    Raises
    ------
    HieraError
        The training in the folder is another one.
    """
    name, plan, without, folder, out = request.name, request.plan, request.without, request.folder, request.out
    from twin.calibrators.hiera_unet import Trainer
    from twin.calibrators.hiera_unet.weights.binding import config_for, identity_of, physics_of
    from twin.calibrators.hiera_unet.weights.checkpoint import keep, kept

    config = config_for(name, data.network, data.table, data.deviations)
    physics = physics_of(data.network, data.table, data.deviations)
    config, plan, data = leave_out(without, config, plan, data)
    trainer = Trainer(config, data.train, physics, plan, request.device, " ".join((data.digest, *without)))
    at, curves_at = folder / "training.pt", folder / "curves.jsonl"
    if at.exists():
        trainer.restore(kept(at))
    curves = [c for c in _read(curves_at) if c["step"] <= trainer.done]
    first = trainer.done
    began = last_kept = time.monotonic()
    gathered: list[dict[str, float]] = []
    while trainer.done < plan.steps and not stop.over:
        gathered.append(trainer.step())
        if trainer.done % LOOK_EVERY == 0 or trainer.done == plan.steps:
            curves.append(_look(trainer, data, gathered))
            gathered = []
            folder.mkdir(parents=True, exist_ok=True)
            curves_at.write_text("".join(json.dumps(c) + "\n" for c in curves), encoding="utf-8")
        if time.monotonic() - last_kept > KEEP_EVERY_S:
            keep(trainer.state(), at)
            last_kept = time.monotonic()
        say(trainer.done, _note(curves))
    keep(trainer.state(), at)
    came = (trainer.done, plan.steps, trainer.done - first, time.monotonic() - began)
    if trainer.done < plan.steps:
        return TrainingProgress(*came)
    identity = identity_of(data.network, data.table, data.deviations)
    card, metrics = _finish(trainer, data, identity, curves, out, request.command, without)
    assemble(data, out.parent, out.stem.rpartition("_")[0])
    drawn = draw(curves, out.with_suffix(".png"), f"{data.table.name} {name}, seed {plan.seed}: {plan.steps} steps")
    return TrainingProgress(*came, card, drawn, tuple(_sentence(mode, m) for mode, m in metrics.items()))


def _look(trainer: Any, data: TrainingData, gathered: list[dict[str, float]]) -> dict[str, Any]:
    """Return one entry of the curves: means of the losses since the last entry, and scores on held-out windows."""
    from twin.calibrators.hiera_unet.training.score import outcome

    names = {n for parts in gathered for n in parts}
    means = {n: float(np.mean([p[n] for p in gathered if n in p])) for n in sorted(names)}
    rows = np.linspace(0, len(data.validation) - 1, min(LOOKED_AT, len(data.validation))).astype(np.intp)
    unseen = outcome(
        trainer.average, data.validation.take(rows), trainer.physics.simulate, trainer.physics.told
    ).metrics()
    return {
        "step": trainer.done,
        "loss": means.pop("loss", float("nan")),
        "rate": trainer.rate(),
        "parts": means,
        "unseen": unseen,
    }


def _note(curves: list[dict[str, Any]]) -> str:
    if not curves:
        return ""
    now, fitted, _, theta, rival = _figures(curves[-1]["unseen"])
    return (
        f"loss {curves[-1]['loss']:.3f}, held-out {now:.4f} K (Gauss-Newton {fitted:.4f}), parameters {theta:.4f} "
        f"({rival:.4f})"
    )


def _figures(metrics: dict[str, Any]) -> tuple[float, ...]:
    from twin.calibrators.hiera_unet.training.score import average

    names = ("mae", "mae_evidence", "mae_before", "theta_mae", "theta_mae_evidence")
    return tuple(average(metrics[name]) for name in names)


def _finish(
    trainer: Any,
    data: TrainingData,
    identity: Any,
    curves: list[dict[str, Any]],
    out: Path,
    command: str,
    without: tuple[str, ...],
) -> tuple[Path, dict[str, Any]]:
    """Compute envelope, leakage and metrics of the averaged weights, and write all files."""
    from twin.calibrators.hiera_unet import Member
    from twin.calibrators.hiera_unet.training.batches import Batch
    from twin.calibrators.hiera_unet.training.score import outcome
    from twin.calibrators.hiera_unet.weights.checkpoint import save
    from twin.calibrators.hiera_unet.weights.envelope import envelope, place
    from twin.calibrators.hiera_unet.weights.leakage import leakage

    network, simulate, told = trainer.average.eval(), trainer.physics.simulate, trainer.physics.told
    rows = np.random.default_rng(0).permutation(len(data.train))[: min(len(data.train), 1500)]
    seen = data.train.take(rows)
    hull = envelope(place(seen.x, seen.m), place(data.conformal.x, data.conformal.m))
    probe = Batch.of(data.conformal.take(slice(0, LEAKED)), trainer.device)
    metrics = {
        mode: outcome(network, data.test, simulate, told, causal=causal, hidden=hidden).metrics()
        for mode, causal, hidden in (("blind", False, True), ("blind_causal", True, True), ("seen_causal", True, False))
    }
    card = {
        "name": out.stem,
        "seed": trainer.plan.seed,
        "command": command,
        "versions": {"hil": __version__, **{name: metadata.version(name) for name in LIBRARIES}},
        "without": list(without),
        "plan": trainer.plan.document(),
        "data": {**data.manifest, "sha256": data.digest},
        "data_kind": "simulated: random rigs of this structure, the virtual rig's plant; no record of a real rig",
        "leakage": leakage(network, probe.x, probe.m, probe.regime, probe.clock, probe.meta),
        "metrics": metrics,
        "curves": curves,
    }
    return save(Member(network, identity, hull, card), out), metrics


def _sentence(mode: str, metrics: dict[str, Any]) -> str:
    now, fitted, before, theta, rival = _figures(metrics)
    return (
        f"{mode.replace('_', ', ')}: {now:.4f} K mean absolute error on {metrics['windows']} held-out windows, "
        f"Gauss-Newton {fitted:.4f} K, commissioned {before:.4f} K; parameters {theta:.4f}, Gauss-Newton {rival:.4f}"
    )


def begun(folder: Path) -> int:
    """Return the number of steps of the training in `folder` so far.

    Raises
    ------
    HieraError
        Its stored state cannot be read.
    """
    from twin.calibrators.hiera_unet.weights.checkpoint import kept

    at = folder / "training.pt"
    return int(kept(at)["done"]) if at.exists() else 0


def _read(path: Path) -> list[dict[str, Any]]:
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line]
