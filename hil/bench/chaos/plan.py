"""Cases of the chaos campaign: one or two attacks, with the rig's watchdog on in one half and off in the other."""

from __future__ import annotations

import itertools
import random
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from hil.bench.chaos.kinds import CHAOS_KINDS, SEVERITY, ChaosKind, Ending

AND = " + "
APART_S = 2.0
"""Longest time from the first to the second attack, s."""
APART_OF_ENDING_S = 0.4
"""Longest time if the first attack ends the run: later there would be no target."""
EARLY_SHARE = 0.2
"""Share of the cases of an early kind that come at any instant after the command."""
_TERMINALS = frozenset({"pipe", "pty"})


@dataclass(frozen=True, slots=True)
class ChaosCase:
    """Case of one or two attacks by name, the second `apart_s` later; `index` is its place in the campaign."""

    names: tuple[str, ...]
    index: int
    watchdog: bool
    early: bool = False
    apart_s: float = 0.0

    @property
    def name(self) -> str:
        """Return the names of its kinds, joined."""
        return AND.join(self.names)

    @property
    def kinds(self) -> tuple[ChaosKind, ...]:
        """Return its kinds, in order of time."""
        return tuple(CHAOS_KINDS[name] for name in self.names)

    @property
    def needs(self) -> frozenset[str]:
        """Return the needs of all its kinds."""
        return frozenset().union(*(kind.needs for kind in self.kinds))


def chaos_case(names: Sequence[str], index: int, seed: int, *, watchdog: bool) -> ChaosCase:
    """Return the case of these kinds; raise KeyError for an unknown one."""
    kinds = [CHAOS_KINDS[name] for name in names]
    draw = random.Random(f"{seed} chaos {AND.join(names)} {index}")
    early = len(kinds) == 1 and kinds[0].early and draw.random() < EARLY_SHARE
    ends = kinds[0].ending in ("stops", "pauses") and kinds[0].group not in ("process", "guardian")
    apart_s = draw.uniform(0.0, APART_OF_ENDING_S if ends else APART_S) if len(kinds) > 1 else 0.0
    on = watchdog or any(kind.watched for kind in kinds)
    return ChaosCase(tuple(names), index, on, early, apart_s)


def chaos_cases(runs: int, seed: int, names: Sequence[str] = ()) -> list[ChaosCase]:
    """Return `runs` cases of `names`, or of all kinds: singles of each in turn, and as many pairs, in random order.

    A pair has kinds of different groups that need no two different terminals. It leaves the harness or the guardian
    able to act, but for what a kind does alone. Kinds come about equally often.
    """
    chosen = list(names) or list(CHAOS_KINDS)
    draw = random.Random(f"{seed} chaos")
    drawn = _pairs(runs // 2, chosen, draw)
    singles = [(chosen[k % len(chosen)],) for k in range(runs - len(drawn))]
    # A kind's occurrences alternate between watchdog on and off, from a random first one.
    first = {name: draw.random() < 0.5 for name in chosen}
    seen: Counter[str] = Counter()
    plan: list[tuple[tuple[str, ...], bool]] = []
    for (name,) in singles:
        plan.append(((name,), first[name] ^ (seen[name] % 2 == 1)))
        seen[name] += 1
    plan += [(pair, k % 2 == 0) for k, pair in enumerate(drawn)]
    draw.shuffle(plan)
    return [chaos_case(chosen_names, k, seed, watchdog=on) for k, (chosen_names, on) in enumerate(plan)]


def _pairs(count: int, names: Sequence[str], draw: random.Random) -> list[tuple[str, str]]:
    left = [pair for pair in itertools.combinations(names, 2) if compatible(*pair)]
    draw.shuffle(left)
    used: Counter[str] = Counter()
    found: list[tuple[str, str]] = []
    while left and len(found) < count:
        pair = min(left, key=lambda two: (max(used[two[0]], used[two[1]]), used[two[0]] + used[two[1]]))
        left.remove(pair)
        used.update(pair)
        first, second = draw.sample(pair, 2)
        if CHAOS_KINDS[first].ending == "killed":  # A second attack would have no target.
            first, second = second, first
        found.append((first, second))
    return found


def compatible(one: str, other: str) -> bool:
    """Return True if two kinds make a pair."""
    a, b = CHAOS_KINDS[one], CHAOS_KINDS[other]
    terminals = (a.needs | b.needs) & _TERMINALS
    nobody_left = {"harness", "guardian"} <= a.disables | b.disables
    protected = (a.protects or b.protects) and (a.deletes or b.deletes)
    possible = len(terminals) < 2 and not nobody_left and not protected
    return a.group != b.group and not (a.alone or b.alone) and possible


def order(ending: Ending) -> int:
    """Return the rank of an ending in `SEVERITY`."""
    return SEVERITY.index(ending)
