"""Which faults a case of the campaign has: one, or two at a time."""

from __future__ import annotations

import itertools
import random
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from hil.bench.faults.kinds import KINDS, Ending, Kind

AND = " + "
APART_S = 1.0
"""The second fault of a pair strikes up to this long after the first, which then has not ended the run yet."""
_SEVERITY: tuple[Ending, ...] = ("rides", "either", "stops", "killed")


@dataclass(frozen=True, slots=True)
class Case:
    """One case by its name, `a` or `a + b`: the first strikes, and perhaps a second after `apart_s`."""

    name: str
    kinds: tuple[Kind, ...]
    apart_s: float = 0.0

    @property
    def ending(self) -> Ending:
        """What has to come of it."""
        return worst(kind.ending for kind in self.kinds)

    @property
    def early(self) -> bool:
        """Whether it may strike before anything is moved; of two faults none does."""
        return len(self.kinds) == 1 and self.kinds[0].early

    @property
    def places(self) -> frozenset[str]:
        """What it needs, see `Kind.place`."""
        return frozenset(kind.place for kind in self.kinds)

    @property
    def resumable(self) -> bool:
        """Whether the run that it leaves can go on once the fault is over; of two, that it can although one is not."""
        names = self.name.split(AND)
        if len(names) == 1:
            return True
        others = [kind for name, kind in zip(names, self.kinds, strict=True) if name != "SIGKILL"]
        return "SIGKILL" in names and all(kind.ending in ("rides", "either") for kind in others)


def worst(endings: Iterable[Ending]) -> Ending:
    """What comes of faults together: what comes of the gravest of them."""
    return max(endings, key=_SEVERITY.index)


def case_of(name: str, number: int, seed: int) -> Case:
    """The case called `name`; KeyError where there is no such kind."""
    kinds = tuple(KINDS[part] for part in name.split(AND))
    apart_s = random.Random(f"{seed} {name} {number} apart").uniform(0.0, APART_S) if len(kinds) > 1 else 0.0
    return Case(name, kinds, apart_s)


def singles(runs: int, kinds: Sequence[str] = ()) -> list[tuple[str, int]]:
    """Name and number of each case: all kinds in turn until there are `runs`."""
    names = list(kinds) or list(KINDS)
    return [(names[k % len(names)], k // len(names)) for k in range(runs)]


def pairs(count: int, seed: int, kinds: Sequence[str] = ()) -> list[tuple[str, int]]:
    """`count` pairs of different kinds in random order, drawn so that every kind comes about equally often.

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
        if first == "SIGKILL":  # nothing is left that a second fault could strike
            first, second = second, first
        found.append((f"{first}{AND}{second}", 0))
    return found


def _same_wire(one: str, other: str) -> bool:
    return KINDS[one].wire != "" and KINDS[one].wire == KINDS[other].wire
