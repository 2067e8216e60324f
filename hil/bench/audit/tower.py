"""Audit of the tower's network on simulated stations: some that its training saw, and some that it did not."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.bench.audit.probe import Probe, mean_known
from hil.bench.audit.shares import intraclass
from hil.bench.audit.subject import MemberAudit, OutputGain, SubjectAudit, TrainingProgress
from hil.bench.audit.terms import LossTerm, weighed
from hil.training.tower import StationPlan, station_cells, table_of
from twin.calibrators.hiera_unet.tower import Fleet, load_tower_ensemble
from twin.calibrators.hiera_unet.tower.plan import TowerPlan
from twin.calibrators.hiera_unet.tower.predict import begun, interval, predict, settle
from twin.calibrators.hiera_unet.tower.score import (
    MethodPrediction,
    believed,
    boosted,
    mixed,
    shrink_factors,
    targets_of,
)
from twin.calibrators.hiera_unet.tower.table import SUBJECT
from twin.calibrators.hiera_unet.tower.train import TowerTrainer

PART_MONTHS, WHOLE_MONTHS = 14.0, 7.0
"""Months of a record of which parts are simulated, as for training, and of a whole one, as those held out."""
FIRST_SEEN, FIRST_UNSEEN = 1, 9601
"""Seeds of stations: those of the training, and those behind its last split."""
BATCH, BATCHES = 16, 3
LEAST_WEIGHT = 0.05
"""Least weight of a label in the loss."""
SCALE = 1.4826
OUTPUT_TERMS, PARAMETER_TERMS = ("outputs", "price"), ("parameters",)
LEARNED, OTHERS = "the training's own records", "such records of unseen stations"
SEEN_WHOLE, UNSEEN_WHOLE = "whole records of training stations", "whole records of unseen stations"
TREES, GAUSS_NEWTON = "boosted trees", "Gauss-Newton"
Say = Callable[[str], None]


def audit_tower(card: Path, stations: tuple[int, int], windows: int, seed: int, say: Say) -> SubjectAudit:
    """Return the audit of the members of an ensemble.

    Parameters
    ----------
    stations
        Number of training and of unseen stations whose records are simulated in parts, and whole.
    windows
        Windows of each of these four kinds.

    Raises
    ------
    HieraError
        The card or a member cannot be used.
    """
    ensemble = load_tower_ensemble(card, blind_too=True)
    members = dict(zip(_names(card), ensemble.members, strict=True))
    parts, whole = stations
    unseen = FIRST_UNSEEN + 100 * seed
    plans = {
        LEARNED: [StationPlan("F", FIRST_SEEN + k, PART_MONTHS, 2, True) for k in range(parts)],
        OTHERS: [StationPlan("F", unseen + k, PART_MONTHS, 2, True) for k in range(parts)],
        SEEN_WHOLE: [StationPlan("F", FIRST_SEEN + k, WHOLE_MONTHS, 1) for k in range(whole)],
        UNSEEN_WHOLE: [StationPlan("F", unseen + k, WHOLE_MONTHS, 1) for k in range(whole)],
    }
    fleets = {kind: _fleet(some, say) for kind, some in plans.items()}
    return tower_audit(members, fleets, windows, seed)


def tower_audit(members: Mapping[str, Any], fleets: Mapping[str, Fleet], windows: int, seed: int) -> SubjectAudit:
    """Return the audit of members (`checkpoint.Member` by name) on fleets by kind, `LEARNED` and `UNSEEN_WHOLE`
    among them."""
    networks = {name: one.network for name, one in members.items()}
    rows = {kind: _chosen(fleet, windows) for kind, fleet in fleets.items()}
    first = next(iter(members.values()))
    probe = probe_of(first.network, fleets[UNSEEN_WHOLE], rows[UNSEEN_WHOLE])
    raw = {name: unshrunk(network) for name, network in networks.items()}
    gains: list[OutputGain] = []
    for name, network in raw.items():
        for kind, fleet in fleets.items():
            gains += gains_of(name, network, fleet, rows[kind], kind)
    trainer = trainer_of(first, fleets[LEARNED])
    untrained = loss_terms(trainer)
    trainer.network.load_state_dict(next(iter(raw.values())).state_dict())
    after = loss_terms(trainer)
    return SubjectAudit(
        probe,
        tuple(MemberAudit.of(name, network, probe, seed) for name, network in networks.items()),
        {"before training": untrained, "after training": after},
        (OUTPUT_TERMS, PARAMETER_TERMS, ()),
        tuple(_progress(name, one.card) for name, one in members.items()),
        sensitivities=sum(one.group == "evidence" for one in SUBJECT.channels),
        channels=len(SUBJECT.channels),
        gains=tuple(gains),
        factors={name: float(network.output_head.shrink) for name, network in networks.items()},
    )


def probe_of(network: Any, fleet: Fleet, rows: NDArray[np.int64]) -> Probe:
    """Return the probe of cycles `rows` (N,), which starts from the answer of the network's trees."""
    parts = [begun(network, fleet.batch(fleet.start.new_tensor(rows[at : at + 64]))) for at in range(0, len(rows), 64)]
    joined = {
        name: _joined([getattr(one, name) for one in parts])
        for name in ("x", "m", "regime", "clock", "meta", "memory", "base_theta", "true", "information")
    }
    t = targets_of(fleet, rows)
    base = boosted(network.trees, fleet, rows) if network.trees is not None else MethodPrediction(t.mean, t.water)
    at_true = t.water + np.einsum("kij,kj->ki", t.slopes, (t.true - t.mean)[:, :3])
    noise = (t.reading - t.true_water - t.true[:, 3:]).ravel()
    sizes: dict[str, int] = {}
    for one in SUBJECT.channels:
        sizes[one.group] = sizes.get(one.group, 0) + 1
    ends = dict(zip(sizes, np.cumsum(list(sizes.values())).tolist(), strict=True))
    config = network.config
    return Probe(
        SUBJECT.name,
        tuple(one.name for one in SUBJECT.deviations),
        {name: joined[name] for name in ("x", "m", "regime", "clock", "meta", "memory")},
        {name: slice(ends[name] - size, ends[name]) for name, size in sizes.items()},
        slice(config.meta - config.told, config.meta),
        np.array(config.bounds),
        joined["base_theta"].double().numpy(),
        joined["true"].double().numpy(),
        joined["information"].double().numpy().clip(LEAST_WEIGHT),
        (base.water - t.true_water)[..., None],
        (at_true - t.true_water)[..., None],
        (base.water - t.commissioned)[..., None],
        float(SCALE * np.nanmedian(np.abs(noise))),
        t.cell.astype(np.int64),
        t.block,
    )


def unshrunk(network: Any) -> Any:
    """Return a copy of a network with both factors on its corrections at one, as in its training."""
    found = copy.deepcopy(network)
    found.start_outlet = False
    for head in (found.parameter_head, found.output_head):
        if head.shrink is not None:
            head.shrink.fill_(1.0)
    return found


def gains_of(name: str, raw: Any, fleet: Fleet, rows: NDArray[np.int64], kind: str) -> list[OutputGain]:
    """Return the gains of a network's raw correction of the outlet on cycles `rows`, by its causal branch.

    The shipped trees learned from the training stations themselves, those of the training from other stations alone.
    So the correction is added to the Gauss-Newton answer too, which learned from none.
    """
    t = targets_of(fleet, rows)
    newton = believed(t)
    starts = {GAUSS_NEWTON: newton}
    if raw.trees is not None:
        starts = {TREES: boosted(raw.trees, fleet, rows), **starts}
    base = next(iter(starts.values()))
    found, _, _ = mixed(t, [predict(raw, fleet, rows)])
    delta = found.water - base.water
    within, mean = (mean_known(np.abs(delta - mean_known(delta)[:, None])), mean_known(delta))
    gains = []
    for start, one in starts.items():
        moved = MethodPrediction(one.theta, one.water + delta)
        own, rival = (mean_known(np.abs(x.water - t.true_water)) for x in (moved, one))
        gains.append(
            OutputGain(
                name,
                kind,
                start,
                float(np.nanmean(np.abs(delta))),
                float(np.nanmean(rival)),
                float(np.nanmean(within)),
                intraclass(mean, t.cell),
                interval(own, rival, t.block, np.random.default_rng(0)),
                shrink_factors(t, one, moved)[1],
            )
        )
    return gains


def trainer_of(member: Any, fleet: Fleet) -> TowerTrainer:
    """Return the trainer of a member's plan on a fleet, with the weight of the parameter loss of its training's end."""
    network = member.network
    if network.trees is not None:
        settle(fleet, network.trees)
    kept: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in member.card["plan"].items()}
    plan = replace(TowerPlan(**kept), steps=1, batch=BATCH, half=False)
    trainer = TowerTrainer(replace(network.config, trees=()), fleet, plan, trees=network.trees)
    trainer.done = plan.steps
    curves = member.card.get("curves") or [{}]
    trainer.even = float(curves[-1].get("even", 1.0))
    return trainer


def loss_terms(trainer: TowerTrainer) -> list[LossTerm]:
    """Return the weighted terms of the loss on batches of the training's own sampler."""

    def batches() -> Iterator[dict[str, Any]]:
        for _ in range(BATCHES):
            batch, pairs, own = trainer.sampled()
            p = trainer.network(batch.x, batch.m, batch.regime, batch.clock, batch.meta, memory=batch.memory)
            parameters, outputs, rest = trainer.losses_of(p, batch, pairs, own)
            yield {"outputs": outputs, "parameters": trainer.even * parameters, "likelihoods and the rest": rest}

    return weighed(trainer.network, batches())


def _fleet(plans: Sequence[StationPlan], say: Say) -> Fleet:
    tables = []
    for plan in plans:
        say(f"simulating station {plan.name}")
        tables += [table_of(cell, plan.segments()) for cell in station_cells(plan)]
    return Fleet(tables)


def _chosen(fleet: Fleet, most: int) -> NDArray[np.int64]:
    """Return at most so many windows, evenly taken."""
    rows = fleet.rows
    return rows[np.unique(np.linspace(0, len(rows) - 1, min(most, len(rows))).astype(np.int64))]


def _joined(parts: Sequence[Any]) -> Any:
    found = parts[0].new_empty((sum(len(p) for p in parts), *parts[0].shape[1:]))
    at = 0
    for part in parts:
        found[at : at + len(part)] = part
        at += len(part)
    return found


def _names(card: Path) -> list[str]:
    return [Path(name).stem for name in json.loads(card.read_text())["members"]]


def _progress(name: str, card: Mapping[str, Any]) -> TrainingProgress:
    plan, curves = card["plan"], card["curves"]
    chosen = [one for one in curves if one["step"] <= card["chosen"]["step"]][-1]
    names = [one.name for one in SUBJECT.deviations]

    def parameters(one: Mapping[str, Any]) -> float:
        return float(np.mean([one[f"{n}_mae"] / one[f"rival_{n}_mae"] for n in names])) - 1.0

    def outputs(one: Mapping[str, Any]) -> float:
        return float(one["water_mae_K"] / one["rival_water_mae_K"]) - 1.0

    late = curves[-max(len(curves) // 3, 2) :]
    return TrainingProgress(
        name,
        card["steps_done"],
        plan["batch"],
        card["windows"],
        parameters(chosen),
        outputs(chosen),
        outputs(late[-1]) - outputs(late[0]),
        (curves[0]["outputs"], curves[-1]["outputs"]),
        {one["step"]: one["shrink"][-1] for one in curves},
    )
