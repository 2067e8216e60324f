"""One network that holds every effect of a catalogue at no size, so that any set of them is a matter of numbers.

Compiling a kernel takes longer than a hundred simulations of a short record; here one kernel serves all hypotheses.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin.discovery.effects.catalogue import LATE, catalogue, extended, sites_of
from twin.discovery.effects.laws import CandidateLaw
from twin.discovery.effects.shapes import Shape
from twin.discovery.effects.shared_kernels import SharedKernel
from twin.discovery.growing.superset.equivalent_places import apart, together
from twin.discovery.growing.superset.hidden_masses import masses
from twin.discovery.growing.superset.steady_states import SteadyStates
from twin.discovery.refit.model import Model
from twin.discovery.scoring.search import Entry
from twin.elements.candidates import Candidate
from twin.kernel import Kernel
from twin.network import Array, Network

MOVING = (*LATE, "elapsed_time", "time_of_day")
"""Drivers that tell nothing where nothing changes."""
UNNOTICED = 5.0
"""Typical sizes that an instrument may be off by: a thermometer by 1 K, a meter by 15 %. Where nothing was
commissioned, larger ones would stand for any law that is missing."""


@dataclass(frozen=True)
class CandidateSuperset:
    """`original`, what it may lack, the `network` with all of it, and a kernel in which all sizes are free.

    `after`: element that a candidate adds -> element without which it is not asked for.
    """

    original: Network
    candidates: tuple[Candidate, ...]
    network: Network
    kernel: Kernel
    after: Mapping[str, str]

    @classmethod
    def of(
        cls, network: Network, tunables: tuple[str, ...], period_s: float, record_s: float, at_rest: bool = False
    ) -> CandidateSuperset:
        """Everything that a network lacks altogether.

        Args:
            tunables: what a fit varies besides; a parameter among them is not asked for. period_s: between samples.
            record_s: how long the record is. at_rest: only what shows in steady states.
        """
        sites = sites_of(network)
        slow, after = ((), {}) if at_rest else masses(sites, period_s, record_s)
        first = [*_lacking(network, tunables, slow), *apart(network, sites)]
        full = SharedKernel.of(network, (), first).network
        known = {name for c in first for name in c.changes}
        # A pipe that is missing may miss its wall, too.
        second = [c for c in _lacking(full, tunables) if not c.adds and not known & set(c.changes)]
        if at_rest:
            first, second = ([c for c in some if c.driver not in MOVING] for some in (first, second))
        candidates = (*first, *second)
        shared = SharedKernel.of(network, tunables, candidates)
        return cls(network, candidates, shared.network, shared.kernel, after)

    @cached_property
    def resting(self) -> SteadyStates:
        """The network at rest."""
        return SteadyStates(self.network, self.kernel)

    def model(self, entries: tuple[Entry, ...]) -> Model:
        """The simulation of some of the effects."""
        return Model(self.original, self.network, entries, self.kernel)

    def plain(self, entries: tuple[Entry, ...], values: Array) -> Network:
        """The original network with these effects and no others, at their sizes, and parameter values (p,)."""
        bigger = self.original
        for entry in entries:
            if not any(name in {e.name for e in bigger.elements} for name in entry.candidate.adds):
                bigger = extended(bigger, entry.candidate)
        model = Model(self.original, bigger, entries, self.kernel)
        vector = model.parameters(values[None, :], np.array([[e.size for e in entries]]))[0]
        found = {
            name: float(v)
            for name, v, p in zip(bigger.ids, vector, bigger.parameters.values(), strict=True)
            if not p.same_as and v != p.value
        }
        return bigger.with_values(found)


def unsized(candidate: Candidate, size: float) -> Entry:
    """An effect that is there from the beginning, at a size that nothing speaks for yet."""
    return Entry(CandidateLaw(candidate, None, None), Shape("step"), np.empty(0), size, 0.0, 0.0)


def name_of(candidate: Candidate) -> str:
    """What a candidate is, whatever size it is looked for at."""
    return candidate.id.rpartition("]")[0]


def _lacking(network: Network, tunables: tuple[str, ...], slow: tuple[Candidate, ...] = ()) -> list[Candidate]:
    """What a network lacks altogether, with the masses `slow` in the place of those of the catalogue."""
    # What is there from the beginning was not put in at some time and does not pass; a reading that never changes is
    # left out.
    every = [c for c in catalogue(network) if not c.begins and not c.sticks and not c.passes]
    talks = Counter(name for c in every for name in c.replaces)
    single = [c for c in every if _absent(network, c) and all(talks[name] == 1 for name in c.replaces)]
    single = [*(_noticed(c) for c in single if not c.slow_s), *slow]
    unique = {c.id: c for c in (*single, *together(network, sites_of(network), single))}
    return [c for c in unique.values() if not set(tunables) & set(c.changes)]


def _absent(network: Network, candidate: Candidate) -> bool:
    """Whether it is something that the twin has not at all, rather than a known value in doubt."""
    values = [network.parameters[name].value for name in candidate.changes if name in network.parameters]
    new = bool(candidate.adds or candidate.replaces)
    if candidate.change == "new":
        return new or any(v in (0.0, 1.0) for v in values)
    return new or all(v == 0.0 for v in values)


def _noticed(candidate: Candidate) -> Candidate:
    """An instrument's error only as large as could stay unnoticed; a lag is no error."""
    if candidate.kind not in ("sensor", "actuator") or candidate.driver in MOVING:
        return candidate
    most = UNNOTICED * candidate.typical
    return replace(candidate, lower=max(candidate.lower, -most), upper=min(candidate.upper, most))
