"""Thermal masses that the model lacks, at each node and with each time constant that a record can identify.

The catalogue's time constants are those of loops of litres; a house has walls of days and a borehole sand of weeks. The
record therefore gives the grid. It begins at a few samples, below which a mass follows its node without delay, and ends
at a few record lengths, above which every mass is a mere heat sink. A lump has one time constant and a conducting body
many, so a second mass is tried beside a first one (Foster chain; Incropera, Fundamentals of Heat and Mass Transfer, 7th
ed., sec. 5.3).
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

from twin.elements.candidates import Candidate, Sites
from twin.elements.hidden_mass import LEAST_S, HiddenMass

LEAST_PERIODS, RECORDS = 4.0, 3.0
"""Least time constant in samples, and largest in record lengths."""
FIRST_S, RATIO = 120.0, math.sqrt(3.0)
"""First time constant of the grid, s, and the ratio of neighbours."""
TO_A_NODE = 2
"""Masses at one node, those of the twin file included."""


def time_constants(period_s: float, record_s: float) -> tuple[float, ...]:
    """Return the grid of time constants, s, for a record of this length with a sample each period, s."""
    first = math.ceil(math.log(max(LEAST_PERIODS * period_s, 2.0 * LEAST_S) / FIRST_S, RATIO) - 1e-9)
    last = math.floor(math.log(RECORDS * record_s / FIRST_S, RATIO) + 1e-9)
    return tuple(FIRST_S * RATIO**k for k in range(first, last + 1))


def masses(sites: Sites, period_s: float, record_s: float) -> tuple[tuple[Candidate, ...], dict[str, str]]:
    """Return masses at each node with every time constant, and the element on which a second mass depends."""
    taken = {e.name for e in sites.elements}
    found: list[Candidate] = []
    after: dict[str, str] = {}
    for node in sites.nodes:
        alone = replace(sites, nodes=(node,), elements=())
        first = next(c for c in HiddenMass.missing_candidates(alone) if not c.begins)
        before = ""
        for _ in range(TO_A_NODE - sum(e.node == node for e in sites.having(HiddenMass.kind))):
            (usual,) = first.adds
            name = next(n for k in range(1, 99) if (n := f"{usual}_{k}" if k > 1 else usual) not in taken)
            taken.add(name)
            found += [_named(first, name, tau) for tau in time_constants(period_s, record_s)]
            if before:
                after[name] = before
            before = name
    return tuple(found), after


def kin(candidate: Candidate) -> tuple[str, ...]:
    """Return the identity of a mass without its time constant, which is a further fitted number; () for other
    candidates.
    """
    if not candidate.slow_s:
        return ()
    return candidate.kind, candidate.where, candidate.unit, *sorted(n.rpartition(".")[2] for n in candidate.changes)


def _named(first: Candidate, name: str, slow_s: float) -> Candidate:
    """Return a mass with a time constant as an element of this name."""
    assert first.slower is not None
    made = first.slower(slow_s)
    (table,) = made.adds.values()
    changes = {f"{name}.{key.rpartition('.')[2]}": weight for key, weight in made.changes.items()}
    return replace(made, changes=changes, adds={name: table}, slower=partial(_named, first, name))
