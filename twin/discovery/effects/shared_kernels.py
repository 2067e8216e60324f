"""Kernels that hold many effects at no size, so that any set of them is a matter of numbers.

Compiling a kernel takes as long as some hundred simulations of a day, and a search asks for dozens of pairs and threes.
So what every hypothesis may need is compiled once, beside the twin: elements whose heat is affine in the temperatures
cost a run little where they do nothing. What is slow, masses and thermometers that lag, costs more and is in a second
kernel. The rest (delays, laws that are no straight lines) is compiled hypothesis by hypothesis.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

from twin.discovery.effects.catalogue import LATE, catalogue, extended
from twin.elements import KINDS
from twin.elements.base import Candidate
from twin.kernel import Kernel
from twin.network import Network

_SLOW = ("thermal_mass", "sensor")


@dataclass(frozen=True)
class SharedKernel:
    """A network with the elements of many candidates, neutral, and the kernel in which their sizes are free."""

    network: Network
    kernel: Kernel

    @classmethod
    def of(cls, network: Network, tunables: tuple[str, ...], candidates: Iterable[Candidate]) -> SharedKernel:
        """The network with all of `candidates`; parameters in `tunables` are free besides."""
        bigger, ids = network, dict.fromkeys(tunables)
        for candidate in candidates:
            missing = {k: v for k, v in candidate.adds.items() if k not in {e.name for e in bigger.elements}}
            if missing or candidate.replaces:
                bigger = extended(bigger, replace(candidate, adds=missing))
            ids |= dict.fromkeys(candidate.changes)
        return cls(bigger, Kernel(bigger, tuple(ids), whole_memory=True))

    def holds(self, candidates: tuple[Candidate, ...]) -> bool:
        """Whether all of them are a matter of numbers here."""
        free = set(self.kernel.lane_ids)
        return all(not c.replaces and free.issuperset(c.changes) for c in candidates)


class SharedKernels:
    """The shared kernels of a network; each is built when it is first asked for, and compiled when it first runs."""

    def __init__(self, network: Network, tunables: tuple[str, ...]) -> None:
        self._network, self._tunables = network, tunables

    @cached_property
    def _plain(self) -> list[Candidate]:
        every = catalogue(self._network)
        # Other forms are mostly other sizes of the same elements, and some have elements of their own.
        others = (o for c in every if c.near is not None for o in c.near() if not set(o.adds) <= set(c.adds))
        return [c for c in (*every, *others) if _is_plain(c)]

    @cached_property
    def _quick(self) -> SharedKernel:
        return SharedKernel.of(self._network, self._tunables, (c for c in self._plain if c.driver not in LATE))

    @cached_property
    def _all(self) -> SharedKernel:
        held = (c for c in self._plain if c.driver not in LATE or c.kind in _SLOW)
        return SharedKernel.of(self._network, self._tunables, held)

    def holding(self, candidates: tuple[Candidate, ...]) -> SharedKernel | None:
        """The quickest that holds these candidates, or None."""
        if self._quick.holds(candidates):
            return self._quick
        return self._all if self._all.holds(candidates) else None


def _is_plain(candidate: Candidate) -> bool:
    return not candidate.replaces and all(KINDS[str(table["kind"])].linear for table in candidate.adds.values())
