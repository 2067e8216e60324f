"""Faults of a case of the campaign: one, or two at a time."""

from __future__ import annotations

import itertools
import random
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from hil.bench.faults.kinds import KINDS, Ending, FaultKind

AND = " + "
APART_S = 1.0
"""Longest time from the first to the second fault of a pair, s: the first has not ended the run yet."""
_SEVERITY: tuple[Ending, ...] = ("rides", "either", "stops", "killed")


@dataclass(frozen=True, slots=True)
class FaultCase:
    """Case by its name, `a` or `a + b`: the first fault, and perhaps a second after `apart_s`."""

    name: str
    kinds: tuple[FaultKind, ...]
    apart_s: float = 0.0

    @property
    def ending(self) -> Ending:
        """Return the required outcome."""
        return worst(kind.ending for kind in self.kinds)

    @property
    def early(self) -> bool:
        """Return True if it may strike before anything is moved; of two faults none does."""
        return len(self.kinds) == 1 and self.kinds[0].early

    @property
    def places(self) -> frozenset[str]:
        """Return its needs, see `FaultKind.place`."""
        return frozenset(kind.place for kind in self.kinds)

    @property
    def resumable(self) -> bool:
        """Return True if the run can continue after the fault; of two, although one of them persists."""
        names = self.name.split(AND)
        if len(names) == 1:
            return True
        others = [kind for name, kind in zip(names, self.kinds, strict=True) if name != "SIGKILL"]
        return "SIGKILL" in names and all(kind.ending in ("rides", "either") for kind in others)


def worst(endings: Iterable[Ending]) -> Ending:
    """Return the outcome of several faults: that of the gravest."""
    return max(endings, key=_SEVERITY.index)


def case_of(name: str, number: int, seed: int) -> FaultCase:
    """Return the case called `name`; raise KeyError for an unknown kind."""
    kinds = tuple(KINDS[part] for part in name.split(AND))
    apart_s = random.Random(f"{seed} {name} {number} apart").uniform(0.0, APART_S) if len(kinds) > 1 else 0.0
    return FaultCase(name, kinds, apart_s)


def singles(runs: int, kinds: Sequence[str] = ()) -> list[tuple[str, int]]:
    """Return name and number of each case: all kinds in turn, up to `runs` cases."""
    names = list(kinds) or list(KINDS)
    return [(names[k % len(names)], k // len(names)) for k in range(runs)]


def pairs(count: int, seed: int, kinds: Sequence[str] = ()) -> list[tuple[str, int]]:
    """Return `count` pairs of different kinds in random order, with about equal counts of every kind.

    Two faults of one wire are no pair: the second would replace the first, or mend it.
    """
    generator, names = random.Random(f"{seed} pairs"), list(kinds) or list(KINDS)
    left = [pair for pair in itertools.combinations(names, 2) if not _same_wire(*pair)]
    generator.shuffle(left)
    used: Counter[str] = Counter()
    found: list[tuple[str, int]] = []
    while left and len(found) < count:
        pair = min(left, key=lambda two: (max(used[two[0]], used[two[1]]), used[two[0]] + used[two[1]]))
        left.remove(pair)
        used.update(pair)
        first, second = generator.sample(pair, 2)
        if first == "SIGKILL":  # A second fault would have no target.
            first, second = second, first
        found.append((f"{first}{AND}{second}", 0))
    return found


def _same_wire(one: str, other: str) -> bool:
    return KINDS[one].wire != "" and KINDS[one].wire == KINDS[other].wire
