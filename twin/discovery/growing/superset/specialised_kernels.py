"""Kernels of a superset that hold only the kinds of elements that some hypotheses use.

A kernel with a single law that is not affine in the temperatures integrates by Runge-Kutta, whose substep is bounded by
the fastest volume, and evaluates that law in every stage, at neutral values too. Memories and delays cost time as well.
An element at its neutral value has no effect, so a hypothesis is simulated without the kinds that it does not use.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from twin.discovery.effects.catalogue import LATE
from twin.elements import KINDS
from twin.elements.candidates import Candidate
from twin.kernel import Kernel
from twin.network import Network
from twin.network.assembly import NetworkEquations

OWN_MEMORY = "memory"
"""Key of the memories of the twin's own elements, such as the lag of a thermometer, beside kinds of elements."""


@dataclass(frozen=True, eq=False)
class SpecialisedKernel:
    """Kernel of a part of a superset's network, and the `columns` (p,) of its parameters in full vectors."""

    kernel: Kernel
    columns: np.ndarray


class SpecialisedKernels:
    """Kernels of one superset by the costly kinds of elements that they hold; each is built on first request.

    Args:
        original: without the candidates. network: with all of them. free: parameters that vary in its kernel.
    """

    def __init__(
        self, original: Network, network: Network, candidates: Iterable[Candidate], free: tuple[str, ...]
    ) -> None:
        self._network, self._free = network, free
        self._candidates = tuple(candidates)
        own = {e.name for e in original.elements}
        self._costly = {
            name: OWN_MEMORY
            for c in self._candidates
            if c.driver in LATE
            for name in c.changes
            if _element(name) in own
        }
        for name, fragment in NetworkEquations(network, free).parts:
            kind = next(e.kind for e in network.elements if e.name == name)
            remembers = fragment.states or fragment.delay or fragment.drive or fragment.lags or fragment.memories
            if name not in own and (remembers or not KINDS[kind].linear):
                self._costly |= {p.id: kind for p in network.parameters.values() if p.element == name}
        self._added = {e.name for e in network.elements} - own
        self._made: dict[frozenset[str], SpecialisedKernel] = {}

    def kinds(self, candidates: Iterable[Candidate]) -> frozenset[str]:
        """Return the costly kinds of elements that candidates change."""
        return frozenset(self._costly[name] for c in candidates for name in c.changes if name in self._costly)

    def of(self, kinds: frozenset[str]) -> SpecialisedKernel:
        """Return the kernel that holds these costly kinds and no others."""
        if kinds not in self._made:
            self._made[kinds] = self._make(kinds)
        return self._made[kinds]

    def _make(self, kinds: frozenset[str]) -> SpecialisedKernel:
        held = [c for c in self._candidates if self.kinds([c]) <= kinds]
        changed = {name for c in held for name in c.changes}
        elements = {_element(name) for name in changed}
        left_out = {name for c in self._candidates for name in c.changes} - changed
        parameters = {
            p.id: replace(p, status="fixed") if p.id in left_out else p
            for p in self._network.parameters.values()
            if p.element not in self._added or p.element in elements
        }
        network = replace(
            self._network,
            elements=tuple(e for e in self._network.elements if e.name not in self._added or e.name in elements),
            parameters=MappingProxyType(parameters),
            digest="",
        )
        free = tuple(name for name in self._free if name in parameters and name not in left_out)
        return SpecialisedKernel(Kernel(network, free, whole_memory=True), self._network.index(network.ids))


def _element(parameter: str) -> str:
    return parameter.rsplit(".", 1)[0]
