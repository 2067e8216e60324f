"""Training of one member from its tables to its weights and card: by steps or by time, with gate, envelope and
curves.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from twin.calibrators.hiera_unet.model.config import HieraError
from twin.calibrators.hiera_unet.model.network import HieraUNet
from twin.calibrators.hiera_unet.model.trees import Trees
from twin.calibrators.hiera_unet.tower.cell_table import CellTable
from twin.calibrators.hiera_unet.tower.plan import TowerPlan
from twin.calibrators.hiera_unet.tower.predict import (
    Blindness,
    blindness,
    judgement,
    outlet_refused,
    predict,
    settle,
)
from twin.calibrators.hiera_unet.tower.score import (
    believed,
    mixed,
    scores,
    shrink_factors,
    shrunk,
    started,
    targets_of,
)
from twin.calibrators.hiera_unet.tower.table import SUBJECT
from twin.calibrators.hiera_unet.tower.train import OwnWindows, TowerTrainer
from twin.calibrators.hiera_unet.tower.windows import Fleet
from twin.calibrators.hiera_unet.weights import checkpoint
from twin.calibrators.hiera_unet.weights.envelope import envelope, place

LOOKED_AT, LOOKS = {"cpu": 256, "cuda": 2048}, 15
"""Held-out windows of an evaluation on a processor and on a device, always the same, and evaluations in a training."""
TIMED = 10
"""Steps, after a warm-up of as many, by which a training with a time limit plans its number of steps."""
FIRST_LOOK = 50
LONGEST = 1_000_000
KEEP_EVERY_S = 60.0
HULL = 256
OWN_MONTHS, MONTH_MIN = 9.0, 365.25 / 12.0 * 1440.0
"""Months of its own record for the adaptation to a station (the paper's), and minutes of a month."""
Say = Callable[[int, int, str], None]


def load_fleet(paths: Sequence[Path], device: str) -> Fleet:
    """Return the windows of these tables on a device.

    Raises
    ------
    HieraError
        A table cannot be read, or there is no window.
    """
    return Fleet([CellTable.load(path) for path in paths], device)


def own_rows(fleet: Fleet, first: float, last: float) -> torch.Tensor:
    """Return the cycles whose targets start within these shares of their records."""
    rows = fleet.rows[(fleet.share[fleet.rows] >= first) & (fleet.share[fleet.rows] < last)]
    return torch.from_numpy(rows).to(fleet.device)


class MemberTraining:
    """Training that resumes from `folder`, until its steps are done, a time is over or `stopped` returns True.

    Parameters
    ----------
    size
        ``small`` or ``full``.
    digest
        Of the data. steps of `plan` are those wanted without a time limit.
    trees
        Boosted trees whose answer the network corrects; without them it corrects the prior mean. `fleet.base` has the
            answers of trees that were not trained on the window's plant.
    """

    def __init__(
        self,
        size: str,
        plan: TowerPlan,
        fleet: Fleet,
        held_out: Fleet,
        folder: Path | None,
        digest: str,
        trees: Trees | None = None,
    ) -> None:
        self.size, self.fleet, self.held_out, self.folder = size, fleet, held_out, folder
        self.config = SUBJECT.config(size)
        if trees is not None:
            settle(held_out, trees)
        self.trainer = TowerTrainer(self.config, fleet, plan, digest, trees=trees)
        self.curves: list[dict[str, Any]] = []
        self.seconds = 0.0
        rng = np.random.default_rng(0)
        count = min(LOOKED_AT[held_out.device.type], len(held_out.rows))
        self.looked = np.sort(rng.choice(held_out.rows, count, replace=False))
        self.targets = targets_of(held_out, self.looked)
        self.base = started(held_out, self.targets)
        self.best: dict[str, Any] = {"score": 1.0, "step": 0, "average": _copied(self.trainer.average)}
        if folder is not None and (folder / "training.pt").exists():
            kept = checkpoint.kept(folder / "training.pt")
            self.trainer.restore(kept)
            self.best = kept["best"]
            self.curves = [json.loads(line) for line in (folder / "curves.jsonl").read_text().splitlines()]

    def run(self, until: float | None, stopped: Callable[[], bool], say: Say) -> bool:
        """Train; return True when all steps are done.

        Parameters
        ----------
        until
            Time.monotonic() at which the training ends, with the learning rate brought down by then; None for the
            plan's steps.
        say
            Called with steps done, steps in all, and a note.
        """
        began = last_kept = time.monotonic()
        gathered: list[dict[str, float]] = []
        trainer = self.trainer
        timed, first = began, trainer.done
        following = first + (max(trainer.plan.steps // LOOKS, 1) if until is None else FIRST_LOOK)
        while trainer.done < trainer.plan.steps and not stopped():
            made = trainer.done - first
            if until is not None and made == TIMED:
                timed = self._now()
            if until is not None and (made == 2 * TIMED or (made and made % (5 * TIMED) == 0)):
                self._fit_to(until, (self._now() - timed) / (made - TIMED))
            found = trainer.step()
            if found:
                gathered.append(found)
            if trainer.done >= following or trainer.done == trainer.plan.steps:
                # A training with a time limit knows its number of steps only after its first ones.
                following = trainer.done + max(trainer.plan.steps // LOOKS, 1)
                self._look(gathered, time.monotonic() - began)
                gathered = []
                say(trainer.done, trainer.plan.steps, self.note())
            if until is not None and time.monotonic() > until:
                break
            if self.folder is not None and time.monotonic() - last_kept > KEEP_EVERY_S:
                self.keep()
                last_kept = time.monotonic()
        self.seconds += time.monotonic() - began
        if self.folder is not None:
            self.keep()
        if trainer.done >= trainer.plan.steps or until is not None:
            self._choose()
        return trainer.done >= trainer.plan.steps or (until is not None and time.monotonic() > until)

    def _choose(self) -> None:
        """Take the averaged weights of the evaluation with the least error on held-out windows, with their factors."""
        self.trainer.average.load_state_dict(self.best["average"])

    def _now(self) -> float:
        if self.fleet.device.type == "cuda":
            torch.cuda.synchronize()
        return time.monotonic()

    def _fit_to(self, until: float, seconds: float) -> None:
        """Set the number of steps that fit before `until` at so many seconds a step."""
        left = max(until - time.monotonic(), 0.0) * 0.97
        steps = self.trainer.done + max(int(left / max(seconds, 1e-5)), 1)
        self.trainer.plan = replace(self.trainer.plan, steps=min(steps, LONGEST))

    def keep(self) -> None:
        """Write the state for resuming."""
        assert self.folder is not None
        self.folder.mkdir(parents=True, exist_ok=True)
        checkpoint.keep({**self.trainer.state(), "best": self.best}, self.folder / "training.pt")
        (self.folder / "curves.jsonl").write_text("".join(json.dumps(c) + "\n" for c in self.curves))

    def _look(self, gathered: Sequence[dict[str, float]], seconds: float) -> None:
        network, t, base = self.trainer.average, self.targets, self.base
        size = 64 if self.held_out.device.type == "cpu" else 512
        found, _, _ = mixed(t, [predict(network, self.held_out, self.looked, size, half=self.trainer.plan.half)])
        theta, water = shrink_factors(t, base, found)
        found = shrunk(base, found, theta, water)
        own, rival = scores(t, found), scores(t, believed(t))
        ratio = _ratio(own, scores(t, base))
        if ratio < self.best["score"]:
            self.best = {"score": ratio, "step": self.trainer.done, "average": _copied(network)}
            self._shrink(self.best["average"], theta, water)
        entry: dict[str, Any] = {"step": self.trainer.done, "seconds": round(seconds, 1), "rate": self.trainer.rate()}
        for key in ("loss", "parameters", "outputs", "even"):
            if gathered:
                entry[key] = float(np.mean([g[key] for g in gathered]))
        entry["water_mae_K"], entry["rival_water_mae_K"] = own["water_mae_K"], rival["water_mae_K"]
        for name, value in own["deviation_mae"].items():
            entry[f"{name}_mae"], entry[f"rival_{name}_mae"] = value, rival["deviation_mae"][name]
        entry |= {"of_base": ratio, "shrink": [*theta.tolist(), water]}
        self.curves.append(entry)

    @staticmethod
    def _shrink(state: dict[str, Any], theta: Any, water: float) -> None:
        """Write the factors into a copy of the weights."""
        state["parameter_head.shrink"].copy_(torch.from_numpy(theta))
        state["output_head.shrink"].fill_(water)

    def note(self) -> str:
        last = self.curves[-1]
        return f"outlet {last['water_mae_K']:.4f} K (Gauss-Newton {last['rival_water_mae_K']:.4f}), " + ", ".join(
            f"{n} {last[n + '_mae']:.4f} ({last['rival_' + n + '_mae']:.4f})"
            for n in ("fill", "air", "uniformity", "bias")
        )

    def gate(self, count: int = 768) -> Blindness:
        """Return the blindness of the averaged weights on held-out windows."""
        return blindness(self.trainer.average, self.held_out, count, half=self.trainer.plan.half)

    def card(self, gate: Blindness, more: dict[str, Any]) -> dict[str, Any]:
        """Return the model card as plain data."""
        trainer = self.trainer
        return {
            "subject": SUBJECT.name,
            **judgement(gate, trainer.average.trees is not None),
            "seed": trainer.plan.seed,
            "plan": trainer.plan.document(),
            "steps_done": trainer.done,
            "chosen": {"step": self.best["step"], "of_base": self.best["score"]},
            "seconds": round(self.seconds, 1),
            "device": _device(self.fleet.device),
            "windows": len(self.fleet),
            "cells": len(self.fleet.names),
            "held_out_cells": len(self.held_out.names),
            "data": trainer.digest,
            "curves": self.curves,
            **more,
        }

    def write(self, path: Path, gate: Blindness, more: dict[str, Any]) -> Path:
        """Write the averaged weights to `path` and the card beside it; return the card's path."""
        member = checkpoint.Member(self.trainer.average, identity(), self._hull(), self.card(gate, more))
        return checkpoint.save(member, path)

    def _hull(self) -> Any:
        rng = np.random.default_rng(1)
        features = []
        for fleet in (self.fleet, self.held_out):
            rows = rng.choice(fleet.rows, min(HULL, len(fleet.rows)), replace=False)
            parts = []
            for at in range(0, len(rows), 64):
                batch = fleet.batch(torch.from_numpy(rows[at : at + 64]))
                parts.append(place(batch.x.cpu().numpy(), batch.m.cpu().numpy()))
            features.append(np.concatenate(parts))
        return envelope(features[0], features[1])


def _ratio(own: dict[str, Any], base: dict[str, Any]) -> float:
    """Return the errors over those of the base: half the outlet's, half the mean of the deviations'."""
    deviations = [own["deviation_mae"][n] / max(v, 1e-9) for n, v in base["deviation_mae"].items()]
    return float(0.5 * own["water_mae_K"] / max(base["water_mae_K"], 1e-9) + 0.5 * np.mean(deviations))


def _copied(network: HieraUNet) -> dict[str, Any]:
    return {name: v.detach().clone() for name, v in network.state_dict().items()}


def adapt(
    network: HieraUNet,
    family: Fleet,
    own: Fleet,
    plan: TowerPlan,
    until: float,
    months: float = OWN_MONTHS,
) -> tuple[HieraUNet, int]:
    """Return a network adapted to readings of the station itself, and the steps that it took.

    Half of the steps see windows of the family with their truth, half those of the station with its readings alone.

    Parameters
    ----------
    network
        Trained on the family.
    family, own
        Windows of simulated stations, and of this one.
    plan
        Steps, batch and rate of the adaptation.
    until
        End of the training, in s of `time.monotonic`.
    months
        Length of the station's own record that it learns from, from the beginning.

    Raises
    ------
    HieraError
        The record is shorter than these months, or has no window in them.
    """
    length = float(own.minutes.min()) / MONTH_MIN
    if length < months:
        raise HieraError(
            f"the station's record has {length:.1f} months, and an adaptation learns from its first {months:g}; give a "
            "longer record",
            code="FEW_MONTHS",
        )
    rows = own_rows(own, 0.0, months / length)
    if not len(rows):
        raise HieraError(
            f"the station has no window in its first {months:g} months; give a longer record", code="NO_WINDOW"
        )
    if network.trees is not None:
        for fleet in (family, own):
            settle(fleet, network.trees)
    trainer = TowerTrainer(network.config, family, plan, "adapted", OwnWindows(own, rows), network.state_dict())
    began = time.monotonic()
    while time.monotonic() < until and trainer.done < trainer.plan.steps:
        trainer.step()
        if trainer.done == TIMED or trainer.done % (4 * TIMED) == 0:
            pace = (time.monotonic() - began) / trainer.done
            steps = trainer.done + max(int(0.97 * (until - time.monotonic()) / pace), 1)
            trainer.plan = replace(trainer.plan, steps=min(steps, plan.steps))
    trainer.average.start_outlet = network.start_outlet
    return trainer.average, trainer.done


def identity() -> checkpoint.Identity:
    """Return what weights of a tower belong to."""
    return checkpoint.Identity(
        checkpoint.TOWER_CELL,
        SUBJECT.digest(),
        tuple(one.name for one in SUBJECT.deviations),
        tuple(one.name for one in SUBJECT.outputs),
    )


def load_member(path: Path, *, blind_too: bool = False) -> checkpoint.Member:
    """Return a trained member.

    Where the gate refused its outputs alone, its outlet is that which the network starts at.

    Raises
    ------
    HieraError
        It is of another subject, table or format, or its parameters were refused as blind.
    """
    member = checkpoint.load(path, identity())
    if member.card.get("refused") and not blind_too:
        raise HieraError(
            f"{path}: its answers are hardly worse with another window's channels, see its card; train longer or with "
            "other data",
            code=str(member.card["refused"]),
        )
    member.network.start_outlet = outlet_refused(member.card)
    return member


def _device(device: torch.device) -> str:
    return torch.cuda.get_device_name(device) if device.type == "cuda" else "cpu"
