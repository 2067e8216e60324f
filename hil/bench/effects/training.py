"""Training of the network of effects on simulated rigs, in as many parts as it takes, and its calibration."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from hil import __version__
from hil.bench.effects.judge import FALSE_A_DAY, Case, days, threshold_for
from hil.bench.effects.simulated import SEEN, Watched
from hil.bench.effects.store import SPLITS, Split, StoredRig, fill, read
from twin.calibrators.hiera_unet.effects.labels import Effect, Example, cropped, example
from twin.calibrators.hiera_unet.effects.member import EffectsMember, save_effects
from twin.calibrators.hiera_unet.effects.scores import window_scores
from twin.calibrators.hiera_unet.effects.train import EffectsPlan, EffectsTrainer
from twin.calibrators.hiera_unet.effects.variations import put_in, resized
from twin.calibrators.hiera_unet.weights.checkpoint import keep, kept

SIZED = {"W": "heat_source", "K": "sensor"}
"""Kind of hypothesis whose size is compared, by the unit of the true one."""
KEEP_EVERY_S = 60.0
COVERED = 0.9
RESIZED, PUT_IN = 1, 3
"""Variations of each record with other sizes of its effect, and with other effects."""
KEPT = 64
"""Windows about the onset that are kept of each of these."""

Say = Callable[[int, str], None]


@dataclass(frozen=True)
class EffectsRequest:
    """Options of a training: plan, folders of the rigs and of the state, path of the weights, seed of the rigs."""

    plan: EffectsPlan
    data: Path
    folder: Path
    out: Path
    command: str
    data_seed: int = 0


def simulate(request: EffectsRequest, splits: Sequence[Split], *, over: Callable[[], bool], say: Say) -> bool:
    """Make the missing rigs; return False if `over` ended the work before."""
    done = 0
    for split in splits:

        def told(k: int, note: str, before: int = done) -> None:
            say(before + k, note)

        if not fill(request.data, split, request.data_seed, over=over, say=told):
            return False
        done += split.rigs
    return True


def examples(rigs: Iterator[StoredRig], seed: int = 0) -> Iterator[Example]:
    """Yield the examples of rigs: each record without its effect, with it, with other sizes of it and other effects."""
    for k, rig in enumerate(rigs):
        memory, rng = rig.memory(), np.random.default_rng([seed, k])
        for record in rig.records:
            figures, calm, truth = record.figures, record.calm, effect_of(record)
            yield example(calm, calm, memory, rig.hypotheses, None)
            varied = [(figures, truth), *(resized(figures, calm, truth, rng) for _ in range(RESIZED))]
            varied += [put_in(calm, memory, rig.hypotheses, rng) for _ in range(PUT_IN)]
            for changed, effect in varied:
                yield cropped(example(changed, calm, memory, rig.hypotheses, effect), KEPT)


def effect_of(record: Watched) -> Effect:
    """Return the truth of a record as a training takes it."""
    truth = record.truth
    answers = tuple((str(kind), str(where)) for kind, where in truth["answers"])
    return Effect(tuple(truth["places"]), answers, float(truth["acts_s"]), record.size, SIZED.get(truth["unit"], ""))


def train(request: EffectsRequest, *, over: Callable[[], bool], say: Say) -> Path | None:
    """Continue a training; at its end calibrate and write the network and return its card, else None.

    Raises
    ------
    HieraError
        The training in the folder is another one, or the folder of rigs is empty.
    """
    training, calibration = SPLITS[0], SPLITS[1]
    trainer = EffectsTrainer(list(examples(read(request.data, training))), request.plan)
    at = request.folder / "training.pt"
    if at.exists():
        trainer.restore(kept(at))
    gathered: list[float] = []
    curve: list[dict[str, float]] = []
    last = time.monotonic()
    while trainer.done < request.plan.steps and not over():
        gathered.append(trainer.step()["loss"])
        if time.monotonic() - last > KEEP_EVERY_S:
            keep(trainer.state(), at)
            last = time.monotonic()
        if trainer.done % 100 == 0:
            curve.append({"step": trainer.done, "loss": float(np.mean(gathered))})
            gathered = []
        say(trainer.done, f"loss {curve[-1]['loss']:.2f}" if curve else "")
    keep(trainer.state(), at)
    if trainer.done < request.plan.steps:
        return None
    member = EffectsMember(trainer.average.eval())
    card: dict[str, Any] = {
        "command": request.command,
        "seed": request.plan.seed,
        "data_seed": request.data_seed,
        "families": list(SEEN),
        "rigs": {s.name: s.rigs for s in (training, calibration)},
        "records": {s.name: s.rigs * s.records for s in (training, calibration)},
        "curve": curve,
        "versions": {"hil": __version__, "torch": metadata.version("torch"), "numpy": metadata.version("numpy")},
    }
    calibrated = calibrate(member, cases_of(member, read(request.data, calibration)))
    return save_effects(replace(calibrated, card={**card, **calibrated.card}), request.out)


def cases_of(member: EffectsMember, rigs: Iterator[StoredRig]) -> list[Case]:
    """Return the cases of rigs as the network judges them."""
    found = []
    for rig in rigs:
        memory = rig.memory()
        for record in rig.records:
            course, calm = (
                member.course(window_scores(figures, memory), rig.hypotheses)
                for figures in (record.figures, record.calm)
            )
            found.append(Case(course, calm, rig.hypotheses, record))
    return found


def calibrate(member: EffectsMember, cases: Sequence[Case]) -> EffectsMember:
    """Return the network with the threshold and interval factors of records that it was not trained on.

    The threshold is the least with at most `FALSE_A_DAY` false alarms a day. A factor is the quantile of the errors
    over the network's scale, with one error a record (split conformal prediction, Vovk et al. 2005).
    """
    calm = [(c.calm, c.record.calm.end_s) for c in cases]
    threshold = threshold_for(calm)
    since, size = [], []
    for case in cases:
        found = _errors(member, case, threshold)
        if found is not None:
            since.append(found[0])
            size += [found[1]] if np.isfinite(found[1]) else []
    card = {
        "calibrated": {
            "healthy_days": sum(days(end) for _, end in calm),
            "false_a_day": FALSE_A_DAY,
            "since": len(since),
            "size": len(size),
        }
    }
    return EffectsMember(
        member.network,
        threshold,
        _quantile(since) * member.since_factor,
        _quantile(size) * member.size_factor,
        card,
    )


def _errors(member: EffectsMember, case: Case, threshold: float) -> tuple[float, float] | None:
    """Return the errors of onset and size over half their intervals, in the first window with a right warning."""
    course, truth, end = case.course, case.record.truth, case.record.figures.end_s
    acts = float(truth["acts_s"])
    hit = np.flatnonzero((course.statistic > threshold) & (end > acts))
    if not hit.size:
        return None
    k = int(hit[0])
    named = case.hypotheses[int(course.hypothesis[k])]
    if named.where not in truth["places"]:
        return None
    wide = np.log(course.since_high_s[k] / course.since_s[k])
    since = abs(np.log(float(end[k] - acts) / course.since_s[k])) / wide
    size = np.nan
    if named.kind == SIZED.get(truth["unit"]):
        reach = 0.5 * (course.size_high[k] - course.size_low[k])
        size = abs(float(case.record.size[k]) - course.size[k]) / reach
    return float(since), float(size)


def _quantile(errors: Sequence[float]) -> float:
    """Return the finite-sample quantile of split conformal prediction; 1 without errors."""
    if not errors:
        return 1.0
    rank = min(int(np.ceil(COVERED * (len(errors) + 1))), len(errors))
    return float(np.sort(errors)[rank - 1])
