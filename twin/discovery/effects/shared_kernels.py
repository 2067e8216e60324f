"""Kernels with many candidates at neutral values, so that any set of them is simulated without another compilation.

Compiling a kernel takes as long as some hundred simulations of a day, and a search fits dozens of sets. Elements whose
heat is affine in the temperatures cost little at neutral values and share one kernel. Masses and lagging thermometers
cost more and share a second one. The rest (delays, nonlinear laws) is compiled for each hypothesis.
"""

from __future__ import annotations

import contextlib
from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

from twin.discovery.effects.catalogue import LATE, catalogue, extended, with_columns
from twin.elements import KINDS, Parameter
from twin.elements.base import Status
from twin.elements.candidates import Candidate
from twin.elements.heat_source import HeatSource
from twin.kernel import Kernel
from twin.network import Network

KEPT = 16
"""Kernels of single hypotheses in the cache: more than a search fits at once."""
SLOTS = 2
"""Open laws in one hypothesis at most: each has a heat input of its own."""
_SLOW = ("thermal_mass", "sensor")


def injection(slot: int, node: str) -> str:
    """Return the name of the element that injects the heat of an open law into a node, which its column's name begins
    with.
    """
    return f"inject_{slot}_{node}"


@dataclass(frozen=True)
class SharedKernel:
    """Network with the neutral elements of many candidates, and a kernel in which their sizes are free."""

    network: Network
    kernel: Kernel

    @classmethod
    def of(cls, network: Network, tunables: tuple[str, ...], candidates: Iterable[Candidate]) -> SharedKernel:
        """Return the kernel of a network with all of `candidates`; parameters in `tunables` are free too."""
        bigger, ids = network, dict.fromkeys(tunables)
        for candidate in candidates:
            missing = {k: v for k, v in candidate.adds.items() if k not in {e.name for e in bigger.elements}}
            if missing or candidate.replaces:
                bigger = extended(bigger, replace(candidate, adds=missing))
            ids |= dict.fromkeys(candidate.changes)
        return cls(bigger, Kernel(bigger, tuple(ids), whole_memory=True))

    def with_injections(self) -> SharedKernel:
        """Return the same with a heat injection into every node, for as many open laws as have a slot."""
        places = [(slot, node) for slot in range(SLOTS) for node in self.network.nodes]
        bigger = with_columns(self.network, [injection(slot, node) + "_W" for slot, node in places])
        elements, parameters = list(bigger.elements), dict(bigger.parameters)
        for slot, node in places:
            name = injection(slot, node)
            elements.append(HeatSource(name, node, f"{name}_W", "linear"))
            for spec in elements[-1].parameter_specs():
                key = f"{name}.{spec.name}"
                status: Status = "tunable" if spec.name == "gain" else "fixed"
                parameters[key] = Parameter(
                    key, name, spec.name, 0.0, spec.unit, spec.lower, spec.upper, status, "an open law"
                )
        bigger = replace(bigger, elements=tuple(elements), parameters=MappingProxyType(parameters), digest="")
        gains = (f"{injection(slot, node)}.gain" for slot, node in places)
        return SharedKernel(bigger, Kernel(bigger, (*self.kernel.lane_ids, *gains), whole_memory=True))

    def holds(self, candidates: tuple[Candidate, ...]) -> bool:
        """Return True if this kernel simulates all of these candidates."""
        free = set(self.kernel.lane_ids)
        return all(not c.replaces and free.issuperset(c.changes) for c in candidates)


class SharedKernels:
    """Shared kernels of a network; each is built on first request, and compiled on its first run."""

    def __init__(self, network: Network, tunables: tuple[str, ...]) -> None:
        self._network, self._tunables = network, tunables
        self._alone: OrderedDict[tuple[int, ...], tuple[tuple[Candidate, ...], SharedKernel]] = OrderedDict()

    def of_these(self, candidates: tuple[Candidate, ...]) -> SharedKernel:
        """Return the kernel of these candidates and no others; the last few are cached.

        Raises:
            TwinFileError: an element does not fit.
        """
        key = tuple(id(c) for c in candidates)  # with the candidates, whose identities so stay their own
        known = self._alone.get(key)
        if known is None:
            bigger = self._network
            for candidate in candidates:
                if candidate.adds.keys().isdisjoint(e.name for e in bigger.elements):
                    bigger = extended(bigger, candidate)
            ids = dict.fromkeys((*self._tunables, *(name for c in candidates for name in c.changes)))
            known = candidates, SharedKernel(bigger, Kernel(bigger, tuple(ids), whole_memory=True))
            self._alone[key] = known
            while len(self._alone) > KEPT:
                with contextlib.suppress(KeyError):  # two threads may fit hypotheses at once
                    self._alone.popitem(last=False)
        return known[1]

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

    @cached_property
    def _open(self) -> SharedKernel:
        return self._quick.with_injections()

    def holding(self, candidates: tuple[Candidate, ...]) -> SharedKernel | None:
        """Return the fastest shared kernel that holds these candidates, or None."""
        opened = [c for c in candidates if c.column]
        if len([c for c in opened if c.injects]) > SLOTS or any(not c.injects and not c.reads for c in opened):
            return None
        candidates = tuple(c for c in candidates if not c.column)
        if opened:
            return self._open if self._open.holds(candidates) else None
        if self._quick.holds(candidates):
            return self._quick
        return self._all if self._all.holds(candidates) else None


def _is_plain(candidate: Candidate) -> bool:
    return not candidate.replaces and all(KINDS[str(table["kind"])].linear for table in candidate.adds.values())
