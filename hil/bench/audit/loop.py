"""Audit of the coolant loop's network on simulated rigs that no training saw."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hil.bench.audit.probe import Probe
from hil.bench.audit.subject import MemberAudit, SubjectAudit, TrainingProgress
from hil.bench.audit.terms import LossTerm, weighed
from hil.training import features_of
from twin.calibrators.hiera_unet import Family, Features, Trainer, TrainingPlan, Windows, load_ensemble
from twin.calibrators.hiera_unet.data.parameters import Deviations
from twin.calibrators.hiera_unet.model.heads import evidence_of
from twin.calibrators.hiera_unet.simulated.campaigns import PER_RIG, ends, label, simulated
from twin.calibrators.hiera_unet.simulated.store import Kept, windows_of
from twin.calibrators.hiera_unet.training.batches import Batch
from twin.calibrators.hiera_unet.training.train import Physics
from twin.calibrators.hiera_unet.weights.binding import identity_of, physics_of
from twin.calibrators.hiera_unet.weights.leakage import leakage

CAMPAIGNS = 3
"""Campaigns of each rig: their changes differ, their rig does not."""
BATCHES = 4
"""Batches of the training's size that the terms of the loss are measured on."""
OUTPUT_TERMS, TWIN_TERMS = ("data", "laplace", "delta", "slow", "balance"), ("twin",)
PARAMETER_TERMS = ("parameter", "gaussian", "smooth")
SCALE = 1.4826
"""Standard deviation of a normal law over its median absolute deviation."""


def audit_loop(card: Path, rigs: int, seed: int) -> SubjectAudit:
    """Return the audit of the members of an ensemble on windows of `rigs` simulated rigs.

    Raises
    ------
    HieraError
        The card or a member cannot be used.
    """
    features = features_of()
    parts = (features.network, features.table, features.deviations)
    members = load_ensemble(card, identity_of(*parts)).members
    physics = physics_of(*parts)
    windows = loop_windows(features, rigs, seed)
    told = windows.m.copy()
    told[:, -windows.target.shape[1] :] &= ~physics.told
    windows = replace(windows, m=told)
    first = members[0].network
    probe = probe_of(first.config, windows, physics, features.table.groups, features.deviations)
    plan = dict(members[0].card["plan"])
    trainer = Trainer(first.config, windows, physics, TrainingPlan(steps=1, batch=plan["batch"], seed=plan["seed"]))
    trainer.done = trainer.plan.steps
    untrained = loss_terms(trainer)
    trainer.network.load_state_dict(first.state_dict())
    return SubjectAudit(
        probe,
        tuple(MemberAudit.of(f"loop_small_{k}", one.network, probe, seed) for k, one in enumerate(members)),
        {"before training": untrained, "after training": loss_terms(trainer)},
        (OUTPUT_TERMS, PARAMETER_TERMS, TWIN_TERMS),
        tuple(_progress(f"loop_small_{k}", one.card) for k, one in enumerate(members)),
        sensitivities=0,
        channels=len(features.table),
        leakage=max(_leakage(one.network, probe) for one in members),
    )


def loop_windows(features: Features, rigs: int, seed: int) -> Windows:
    """Return the windows of `CAMPAIGNS` campaigns of each of `rigs` rigs."""
    family = Family(features.network, features.deviations)
    kept = []
    for rig in range(rigs):
        for number in range(rig * PER_RIG, rig * PER_RIG + CAMPAIGNS):
            campaign = simulated(family, seed, number)
            rng = np.random.default_rng([seed, number, 13])
            kept.append(Kept(campaign, tuple(label(features, campaign, end) for end in ends(campaign, rng))))
    return windows_of(features, kept)


def probe_of(
    config: Any, windows: Windows, physics: Physics, groups: dict[str, int], deviations: Deviations | None
) -> Probe:
    """Return the probe of windows whose targets are hidden.

    Parameters
    ----------
    config
        `model.config.Config` of the network.
    groups
        Number of channels of each group, in order.
    deviations
        Deviations by name; None numbers them.
    """
    batch = Batch.of(windows)
    given = evidence_of(config, batch.meta)
    assert given is not None
    goal = np.where(np.isfinite(windows.truth), windows.truth, windows.target).astype(np.float64)
    at_fit = physics.simulate(given.fit, windows).detach().double().numpy()
    at_true = physics.simulate(batch.theta.nan_to_num(0.0), windows).detach().double().numpy()
    at_true[~np.isfinite(windows.theta).all(axis=1)] = np.nan
    noise = (windows.target - windows.truth)[np.isfinite(windows.target - windows.truth)]
    ends_at = np.cumsum(list(groups.values()))
    plant = np.unique(windows.nominal, axis=0, return_inverse=True)[1].reshape(-1)
    names = deviations.ids if deviations is not None else tuple(f"deviation {k}" for k in range(config.parameters))
    return Probe(
        "loop",
        names,
        {name: getattr(batch, name) for name in ("x", "m", "regime", "clock", "meta")} | {"memory": None},
        {name: slice(int(end) - groups[name], int(end)) for name, end in zip(groups, ends_at, strict=True)},
        slice(config.meta - config.told, config.meta),
        np.array(config.bounds),
        given.mean.double().numpy(),
        windows.theta.astype(np.float64),
        windows.known.astype(np.float64),
        at_fit - goal,
        at_true - goal,
        at_fit - windows.base,
        float(SCALE * np.median(np.abs(noise))) if len(noise) else float("nan"),
        plant,
        plant,
    )


def loss_terms(trainer: Trainer) -> list[LossTerm]:
    """Return the weighted terms of the loss on batches of the training's own sampler, targets hidden."""
    w = trainer.plan.weights
    weight = {
        "delta": w.delta,
        "slow": w.slow,
        "balance": w.balance,
        "laplace": w.uncertainty,
        "gaussian": w.uncertainty,
        "parameter": w.parameter,
        "smooth": w.smooth,
    }

    def batches() -> Iterator[dict[str, Any]]:
        for _ in range(BATCHES):
            rows, pairs = trainer.sampler.draw(structural=False)
            b = Batch.of(trainer.windows.take(rows))
            p = trainer.network(b.x, b.m, b.regime, b.clock, b.meta)
            parts = trainer.loss(p, b, pairs, structural=False)
            yield {name: weight.get(name, 1.0) * parts[name] for name in parts if name != "loss"}

    return weighed(trainer.network, batches())


def _progress(name: str, card: dict[str, Any]) -> TrainingProgress:
    plan, curves = card["plan"], card["curves"]
    seen = sum(s["windows"] for s in card["data"]["shards"].values() if s["split"] == "train")
    late = [one["unseen"] for one in curves[-max(len(curves) // 3, 2) :]]

    def outputs(one: dict[str, Any]) -> float:
        return float(np.mean(one["mae"]) / np.mean(one["mae_evidence"]) - 1.0)

    def parameters(one: dict[str, Any]) -> float:
        return _known(one["theta_mae"]) / _known(one["theta_mae_evidence"]) - 1.0

    return TrainingProgress(
        name,
        plan["steps"],
        plan["batch"],
        seen,
        parameters(late[-1]),
        outputs(late[-1]),
        outputs(late[-1]) - outputs(late[0]),
    )


def _known(values: list[float | None]) -> float:
    return float(np.mean([v for v in values if v is not None]))


def _leakage(network: Any, probe: Probe) -> float:
    some = {name: v[:32] for name, v in probe.inputs.items() if v is not None}
    return leakage(network, **some)
