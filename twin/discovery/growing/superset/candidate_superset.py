"""Network with every effect of a catalogue at neutral values, so that any set of them is simulated by one kernel.

Compiling a kernel takes longer than a hundred simulations of a short record.
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
from twin.discovery.growing.superset.equivalent_places import family_candidates, untied_losses
from twin.discovery.growing.superset.hidden_masses import masses
from twin.discovery.growing.superset.specialised_kernels import SpecialisedKernels
from twin.discovery.growing.superset.steady_states import SteadyStates
from twin.discovery.refit.model import Model
from twin.discovery.scoring.search import Entry
from twin.elements.candidates import Candidate
from twin.kernel import Kernel
from twin.network import Array, Network

MOVING = (*LATE, "elapsed_time", "time_of_day")
"""Drivers without information in steady states."""
UNNOTICED = 5.0
"""Typical sizes up to which an instrument's error may go unnoticed: 1 K of a thermometer, 15 % of a meter. In a twin
that was never commissioned, larger ones would imitate any missing law."""


@dataclass(frozen=True)
class CandidateSuperset:
    """Network `original`, its candidates, the `network` with all of them, and a kernel in which all sizes are free.

    `after`: element that a candidate adds -> element without which the candidate is not tried.
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
        """Return the superset of all effects that a network has no element for.

        Args:
            tunables: parameters that a fit varies too, which are no candidates. period_s: between samples.
            record_s: length of the record. at_rest: only effects that show in steady states.
        """
        sites = sites_of(network)
        slow, after = ((), {}) if at_rest else masses(sites, period_s, record_s)
        first = [*_lacking(network, tunables, slow), *untied_losses(network, sites)]
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
        """Return the steady states of the network."""
        return SteadyStates(self.network, self.kernel)

    @cached_property
    def specialised(self) -> SpecialisedKernels:
        """Return the kernels of parts of the network."""
        return SpecialisedKernels(self.original, self.network, self.candidates, self.kernel.lane_ids)

    def model(self, entries: tuple[Entry, ...]) -> Model:
        """Return the model of some of the effects."""
        return Model(self.original, self.network, entries, self.kernel)

    def plain(self, entries: tuple[Entry, ...], values: Array) -> Network:
        """Return the original network with these effects alone, at their sizes, and parameter values (p,)."""
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
    """Return an effect that is present from the beginning, at an arbitrary size."""
    return Entry(CandidateLaw(candidate, None, None), Shape("step"), np.empty(0), size, 0.0, 0.0)


def name_of(candidate: Candidate) -> str:
    """Return the identity of a candidate, independent of its size."""
    return candidate.id.rpartition("]")[0]


def _lacking(network: Network, tunables: tuple[str, ...], slow: tuple[Candidate, ...] = ()) -> list[Candidate]:
    """Return the candidates that a network has no element for, with the masses `slow` in place of those of the
    catalogue.
    """
    # What is there from the beginning was not put in at some time and does not pass; a reading that never changes is
    # left out.
    every = [c for c in catalogue(network) if not (c.begins or c.has_level or c.is_event)]
    talks = Counter(name for c in every for name in c.replaces)
    single = [c for c in every if _absent(network, c) and all(talks[name] == 1 for name in c.replaces)]
    single = [*(_noticed(c) for c in single if not c.slow_s), *slow]
    unique = {c.id: c for c in (*single, *family_candidates(network, sites_of(network), single))}
    return [c for c in unique.values() if not set(tunables) & set(c.changes)]


def _absent(network: Network, candidate: Candidate) -> bool:
    """Return True for a candidate that the twin has no element for, as opposed to an uncertain parameter."""
    values = [network.parameters[name].value for name in candidate.changes if name in network.parameters]
    new = bool(candidate.adds or candidate.replaces)
    if candidate.change == "new":
        return new or any(v in (0.0, 1.0) for v in values)
    return new or all(v == 0.0 for v in values)


def _noticed(candidate: Candidate) -> Candidate:
    """Return an instrument error limited to a size that may go unnoticed; lags are not limited."""
    if candidate.kind not in ("sensor", "actuator") or candidate.driver in MOVING:
        return candidate
    most = UNNOTICED * candidate.typical
    return replace(candidate, lower=max(candidate.lower, -most), upper=min(candidate.upper, most))
