"""Masses that the model does not show, as many to a node and as slow as a record could tell.

The catalogue's time constants are those of loops of litres; a house has walls of days and a borehole sand of weeks. So
here the record gives the grid: from a few of its samples, below which a mass follows as a wire would, to a few of its
lengths, above which every mass only takes heat. A lump has one time constant, what conducts has many, so a second mass
is offered beside a first one (Foster chain; Incropera, Fundamentals of Heat and Mass Transfer, 7th ed., sec. 5.3).
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

from twin.elements.candidates import Candidate, Sites
from twin.elements.hidden_mass import LEAST_S, HiddenMass

LEAST_PERIODS, RECORDS = 4.0, 3.0
"""Time constants that are looked for: samples at least, and times the record's length at most."""
FIRST_S, RATIO = 120.0, math.sqrt(3.0)
"""A time constant of the grid, s, and how far each is from the next."""
TO_A_NODE = 2
"""Masses beside one node, those of the twin file among them."""


def time_constants(period_s: float, record_s: float) -> tuple[float, ...]:
    """The grid for a record of this length with a sample each period, s."""
    first = math.ceil(math.log(max(LEAST_PERIODS * period_s, 2.0 * LEAST_S) / FIRST_S, RATIO) - 1e-9)
    last = math.floor(math.log(RECORDS * record_s / FIRST_S, RATIO) + 1e-9)
    return tuple(FIRST_S * RATIO**k for k in range(first, last + 1))


def masses(sites: Sites, period_s: float, record_s: float) -> tuple[tuple[Candidate, ...], dict[str, str]]:
    """Masses beside each node with every time constant, and which element must be there before one is asked for."""
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
    """What a mass is but for its time constant, which is one more number to be fitted; nothing of all else."""
    if not candidate.slow_s:
        return ()
    return candidate.kind, candidate.where, candidate.unit, *sorted(n.rpartition(".")[2] for n in candidate.changes)


def _named(first: Candidate, name: str, slow_s: float) -> Candidate:
    """A mass with a time constant as an element of this name."""
    assert first.slower is not None
    made = first.slower(slow_s)
    (table,) = made.adds.values()
    changes = {f"{name}.{key.rpartition('.')[2]}": weight for key, weight in made.changes.items()}
    return replace(made, changes=changes, adds={name: table}, slower=partial(_named, first, name))
