"""Folder of simulated rigs: one file a rig, made once, with the windows of its records."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.bench.effects.simulated import FIRST_SEED, SEEN, UNSEEN, Watched, make_records, make_rig
from hil.bench.zoo.effects import EFFECTS
from hil.bench.zoo.plants import Array
from hil.files import replacing
from twin.calibrators.hiera_unet.effects.balance import Figures, Hypothesis
from twin.calibrators.hiera_unet.effects.memory import Memory, learn

SPLIT_STRIDE = 1_000_000
_FIGURES = ("end_s", "power", "direction", "levels", "rates", "valid")


@dataclass(frozen=True)
class Split:
    """Rigs for one purpose: their families in turn, their number and the records of each."""

    name: str
    families: tuple[str, ...]
    rigs: int
    records: int


SPLITS = (
    Split("training", SEEN, 100, 4),
    Split("calibration", SEEN, 60, 3),
    Split("test_seen", SEEN, 36, 3),
    Split("test_unseen", UNSEEN, 36, 3),
)
"""No two splits share a seed; `test_unseen` has families that no other split has."""


@dataclass(frozen=True)
class StoredRig:
    """Rig of a folder: its hypotheses, the windows of its healthy record, and its records."""

    hypotheses: tuple[Hypothesis, ...]
    healthy: Figures
    records: tuple[Watched, ...]

    def memory(self) -> Memory:
        """Return the memory of the healthy record."""
        return learn(self.healthy)


def planned(split: Split, seed: int) -> list[tuple[str, int]]:
    """Return family and seed of each rig of a split."""
    order = [s.name for s in SPLITS].index(split.name)
    first = FIRST_SEED + 10 * SPLIT_STRIDE * seed + SPLIT_STRIDE * order
    return [(split.families[k % len(split.families)], first + k) for k in range(split.rigs)]


def effects_of(split: Split, seed: int, k: int) -> tuple[str, ...]:
    """Return the names of the effects that the records of a rig are to have: all in turn, in a drawn order."""
    usual = [e.name for e in EFFECTS if not e.reserved]
    order = np.random.default_rng([seed, len(split.name)]).permutation(len(usual))
    return tuple(usual[order[(k * split.records + j) % len(usual)]] for j in range(split.records))


def fill(folder: Path, split: Split, seed: int, *, say: Callable[[int, str], None], over: Callable[[], bool]) -> bool:
    """Make the missing rigs of a split; return False if `over` ended the work before it was done."""
    for k, (family, own) in enumerate(planned(split, seed)):
        path = _path(folder, split, k)
        if not path.exists():
            if over():
                return False
            rig = make_rig(family, own)
            wanted = effects_of(split, seed, k)
            _write(
                path, StoredRig(rig.balance.hypotheses, rig.usually, tuple(make_records(rig, split.records, wanted)))
            )
        say(k + 1, family)
    return True


def read(folder: Path, split: Split) -> Iterator[StoredRig]:
    """Yield the rigs of a split that are made."""
    for k in range(split.rigs):
        if (path := _path(folder, split, k)).exists():
            yield _read(path)


def _path(folder: Path, split: Split, k: int) -> Path:
    return folder / split.name / f"rig_{k:03d}.npz"


def _write(path: Path, rig: StoredRig) -> None:
    arrays: dict[str, Array] = {f"healthy.{name}": getattr(rig.healthy, name) for name in _FIGURES}
    arrays["kick"] = rig.healthy.kick
    for k, record in enumerate(rig.records):
        arrays[f"{k}.size"] = record.size
        for which in ("figures", "calm"):
            arrays |= {f"{k}.{which}.{name}": getattr(getattr(record, which), name) for name in _FIGURES}
    about = {
        "hypotheses": [(h.kind, h.where) for h in rig.hypotheses],
        "truths": [r.truth for r in rig.records],
    }
    narrow = {k: v.astype(np.float32) if v.dtype == np.float64 else v for k, v in arrays.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as unfinished, unfinished.open("wb") as file:
        np.savez(file, about=np.frombuffer(json.dumps(about).encode(), dtype=np.uint8), **narrow)  # type: ignore[arg-type]


def _read(path: Path) -> StoredRig:
    with np.load(path) as file:
        held = {k: v.astype(np.float64) if v.dtype == np.float32 else v for k, v in file.items()}
    about = json.loads(bytes(held["about"]))

    def figures(prefix: str) -> Figures:
        values = {name: held[f"{prefix}.{name}"] for name in _FIGURES}
        return Figures(kick=held["kick"], **values)

    records = tuple(
        Watched(figures(f"{k}.figures"), figures(f"{k}.calm"), truth, held[f"{k}.size"])
        for k, truth in enumerate(about["truths"])
    )
    return StoredRig(tuple(Hypothesis(*h) for h in about["hypotheses"]), figures("healthy"), records)
