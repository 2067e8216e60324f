"""A twin with effects added as real elements, run freely with each effect coming in as its shape says."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twin.assembly import System
from twin.discovery.catalogue import extended
from twin.discovery.search import Entry
from twin.discovery.shapes import Shape
from twin.elements.base import Candidate
from twin.kernel import Kernel
from twin.network import Array, Network

PIECE_S = 600.0
"""A growing effect is held constant for so long."""


@dataclass(frozen=True)
class Model:
    """`original` with the elements of `entries`, neutral, as `network`, and the kernel that simulates it."""

    original: Network
    network: Network
    entries: tuple[Entry, ...]
    kernel: Kernel

    @classmethod
    def of(cls, network: Network, entries: tuple[Entry, ...], tunables: tuple[str, ...]) -> Model:
        """Compile, or load from the cache, the network with these effects and these parameters free.

        Raises:
            TwinFileError: an element does not fit.
        """
        bigger = network
        # In one order, so that a pair named the other way round is the same kernel.
        ordered = sorted(entries, key=lambda e: e.candidate.id)
        for entry in ordered:
            if not any(name in {e.name for e in bigger.elements} for name in entry.candidate.adds):
                bigger = extended(bigger, entry.candidate)
        ids = dict.fromkeys((*tunables, *(name for e in ordered for name in e.candidate.changes)))
        return cls(network, bigger, entries, Kernel(bigger, tuple(ids)))

    @cached_property
    def _here(self) -> np.ndarray:
        """Positions of the original network's parameters."""
        return self.network.index(self.original.ids)

    @cached_property
    def _masses(self) -> list[tuple[int, int, int]]:
        """Effects that bring a temperature of their own: effect, its place in a full state, the node beside it."""
        names = System(self.network, ()).states
        found = []
        for i, entry in enumerate(self.entries):
            for element in self.network.elements:
                own = [k for k, name in enumerate(names) if name.startswith(f"{element.name}.")]
                if element.name in entry.candidate.adds and own:
                    found.append((i, own[0], self.network.nodes.index(element.nodes()[0])))
        return found

    @cached_property
    def _shared(self) -> list[tuple[int, int]]:
        """Parameters that are the same as another."""
        where = {name: i for i, name in enumerate(self.network.ids)}
        return [(where[p.id], where[p.same_as]) for p in self.network.parameters.values() if p.same_as]

    def parameters(self, values: Array, sizes: Array) -> Array:
        """Full parameter vectors (P, p) of the bigger network.

        Args:
            values: (P, p) of the original network. sizes: (P, e).
        """
        out = np.tile(self.network.values, (len(values), 1))
        out[:, self._here] = values
        for j, entry in enumerate(self.entries):
            _size(self.network, entry.candidate, out, sizes[:, j])
        for k, other in self._shared:
            out[:, k] = out[:, other]
        return out

    def run(
        self,
        time: Array,
        inputs: Array,
        state: Array,
        values: Array,
        sizes: Array,
        shapes: tuple[tuple[Shape, ...], ...] | None = None,
    ) -> Array:
        """Readings (P, n, m) in degC of free runs.

        Args:
            state: (P, k) at the first sample. values: (P, p) of the original network. sizes: (P, e).
            shapes: (P, e) how the effects come in, as the entries say by default.
        """
        since = time - time[0]
        each = shapes or tuple(tuple(e.shape for e in self.entries) for _ in range(len(values)))
        borders = {0.0}
        for shape in {s for row in each for s in row}:
            borders.add(min(shape.onset_s, float(since[-1])))
            if shape.name != "step":
                borders.update(np.arange(PIECE_S * np.ceil(shape.onset_s / PIECE_S), since[-1], PIECE_S).tolist())
        cuts = np.unique(np.searchsorted(since, sorted(borders)))
        cuts = np.concatenate([cuts[cuts < len(time)], [len(time)]])
        readings = np.empty((len(values), len(time), len(self.network.sensors)))
        before = np.zeros((len(values), len(self.entries)))
        for first, last in zip(cuts[:-1], cuts[1:], strict=True):
            until = min(last + 1, len(time))
            span = np.append(since[first:last], since[min(last, len(since) - 1)])
            known = {s: s.mean(float(span[0]), float(span[-1])) for row in each for s in row}
            at = np.array([[known[s] for s in row] for row in each]).reshape(len(values), len(self.entries))
            for effect, mass, node in self._masses if first else ():
                # A mass that comes in now has had the time to be as warm as what it stands beside.
                begins = (before[:, effect] == 0.0) & (at[:, effect] > 0.0)
                state[begins, mass] = state[begins, node]
            before = at
            full = self.parameters(values, sizes * at)
            part, state = self.kernel.trace(full, state, time[first:until], inputs[first:until])
            readings[:, first:last] = part[:, : last - first]
        return readings


def _size(network: Network, candidate: Candidate, rows: Array, sizes: Array) -> None:
    """Enter a candidate's sizes (P,) into full parameter vectors (P, p), within the parameters' bounds."""
    for name, weight in candidate.changes.items():
        p, k = network.parameters[name], int(network.index([name])[0])
        if candidate.inverse:
            value = np.where(sizes > weight / p.upper, weight / np.maximum(sizes, weight / p.upper), p.upper)
        else:
            value = rows[:, k] + weight * sizes
        rows[:, k] = np.clip(value, p.lower, p.upper)
