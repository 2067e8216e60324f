"""Plan of a trial: which family, seed and effect each case has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.bench.zoo.effects import EFFECTS
from hil.bench.zoo.plants import DEVELOPMENT, SEALED

SEED_STRIDE = 10_000
"""Seeds of one trial: its own times this, plus the number of the case."""
SEALED_SEEDS = 1_000_000_000
"""First seed of the sealed half, which no development case has."""


@dataclass(frozen=True)
class Planned:
    """A planned case: its name, family and seed; `effect` is None for a healthy plant."""

    name: str
    family: str
    seed: int
    effect: str | None
    sealed: bool


def plan(which: str, cases: int, healthy: int, seed: int) -> tuple[Planned, ...]:
    """Return the cases of a trial: families in turn, and effects in a random order without repetition.

    An effect that a plant has no place for is replaced by the next one that fits, in `trial`.

    Parameters
    ----------
    which
        "dev" or "sealed".
    cases, healthy
        Numbers of records with an effect and without.
    seed
        Seed of the trial.
    """
    sealed = which == "sealed"
    families: Sequence[str] = SEALED if sealed else DEVELOPMENT
    rng = np.random.default_rng([seed, int(sealed)])
    first = seed * SEED_STRIDE + (SEALED_SEEDS if sealed else 0)
    names = [e.name for e in EFFECTS if sealed or not e.reserved]
    order: list[str] = []
    while len(order) < cases:
        order += [names[k] for k in rng.permutation(len(names))]
    found = [Planned(f"case_{k}", families[k % len(families)], first + k, order[k], sealed) for k in range(cases)]
    found += [
        Planned(f"healthy_{k}", families[k % len(families)], first + SEED_STRIDE // 2 + k, None, sealed)
        for k in range(healthy)
    ]
    return tuple(found)
