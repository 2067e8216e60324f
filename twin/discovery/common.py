"""Kernels that hold many effects at no size, so that any set of them is a matter of numbers.

Compiling a kernel takes as long as some hundred simulations of a day, and a search asks for dozens of pairs and threes.
So what every hypothesis may need is compiled once, beside the twin: elements whose heat is affine in the temperatures
cost a run little where they do nothing. What is slow, masses and thermometers that lag, costs more and is in a second
kernel. The rest (delays, laws that are no straight lines) is compiled hypothesis by hypothesis.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

from twin.discovery.catalogue import catalogue, extended
from twin.elements import KINDS
from twin.elements.base import Candidate
from twin.kernel import Kernel
from twin.network import Network

_LATE = ("history", "rate_of_change")
_SLOW = ("thermal_mass", "sensor")


@dataclass(frozen=True)
class Common:
    """A network with the elements of many candidates, neutral, and the kernel in which their sizes are free."""

    network: Network
    kernel: Kernel

    @classmethod
    def of(cls, network: Network, tunables: tuple[str, ...], fits: Callable[[Candidate], bool]) -> Common:
        """All candidates of the catalogue that fit; parameters in `tunables` are free besides."""
        bigger, ids = network, dict.fromkeys(tunables)
        for candidate in filter(fits, catalogue(network)):
            missing = {k: v for k, v in candidate.adds.items() if k not in {e.name for e in bigger.elements}}
            if missing:
                bigger = extended(bigger, replace(candidate, adds=missing))
            ids |= dict.fromkeys(candidate.changes)
        return cls(bigger, Kernel(bigger, tuple(ids)))

    def holds(self, candidates: tuple[Candidate, ...]) -> bool:
        """Whether all of them are a matter of numbers here."""
        free = set(self.kernel.lane_ids)
        return all(not c.replaces and free.issuperset(c.changes) for c in candidates)


class Commons:
    """The common kernels of a network; each is built when it is first asked for, and compiled when it first runs."""

    def __init__(self, network: Network, tunables: tuple[str, ...]) -> None:
        self._network, self._tunables = network, tunables

    @cached_property
    def _quick(self) -> Common:
        return Common.of(self._network, self._tunables, _quick)

    @cached_property
    def _all(self) -> Common:
        return Common.of(self._network, self._tunables, lambda c: _quick(c) or _slow(c))

    def holding(self, candidates: tuple[Candidate, ...]) -> Common | None:
        """The quickest that holds these candidates, or None."""
        if self._quick.holds(candidates):
            return self._quick
        return self._all if self._all.holds(candidates) else None


def _quick(candidate: Candidate) -> bool:
    return _plain(candidate) and candidate.driver not in _LATE


def _slow(candidate: Candidate) -> bool:
    return _plain(candidate) and candidate.kind in _SLOW


def _plain(candidate: Candidate) -> bool:
    return not candidate.replaces and all(KINDS[str(table["kind"])].linear for table in candidate.adds.values())
