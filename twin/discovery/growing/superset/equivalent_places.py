"""Equivalent places: one effect of one size at all of them is simpler than one at each.

Numbered nodes (`heater_1`, `heater_2`) make a family. Candidates that differ only in their member are added once more
for the whole family. If the twin file itself ties members to one parameter, each may deviate from the others.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from typing import Any

from twin.elements.ambient_loss import AmbientLoss
from twin.elements.candidates import Candidate, Sites
from twin.network import Network


def family_candidates(network: Network, sites: Sites, candidates: Iterable[Candidate]) -> tuple[Candidate, ...]:
    """Return candidates for whole families, made of those for their members."""
    single = [c for c in candidates if not c.replaces]
    found = []
    for place, nodes in sites.groups.items():
        alike: dict[Any, dict[str, Candidate]] = defaultdict(dict)
        for candidate in single:
            node = _node_of(network, candidate)
            if node in nodes and candidate.kind != "heat_source":
                alike[_form(candidate, node)].setdefault(node, candidate)
        for members in alike.values():
            if set(members) == set(nodes) and not _tied(network, members.values()):
                found.append(_one_for_all(place, tuple(members[node] for node in nodes)))
    return tuple(found)


def untied_losses(network: Network, sites: Sites) -> tuple[Candidate, ...]:
    """Return further losses of single places that the twin ties to others by one conductance.

    Without them a deviation of one place would be explained by a loss that grows with temperature, which exists singly.
    """
    losses = [e for e in sites.having(AmbientLoss.kind) if len(e.nodes()) > 1]
    taken = {e.name for e in network.elements}
    return tuple(
        Candidate(
            "heat_loss",
            sites.places[node],
            "temperature_difference",
            "new",
            {f"{name}.hA": 1.0},
            "W/K",
            1.0,
            0.0,
            60.0,
            "loses {value} more to the room than what is built like it",
            adds={name: {"kind": AmbientLoss.kind, "node": node, "ambient": loss.ambient}},
        )
        for loss in losses
        for node in loss.nodes()
        if (name := f"further_loss_of_{node}") not in taken
    )


def _one_for_all(place: str, members: tuple[Candidate, ...]) -> Candidate:
    first = members[0]
    changes = {name: weight for c in members for name, weight in c.changes.items()}
    adds = {name: table for c in members for name, table in c.adds.items()}
    lower, upper = max(c.lower for c in members), min(c.upper for c in members)
    slower = partial(_slower, place, members) if first.slower is not None else None
    return replace(first, where=place, changes=changes, adds=adds, lower=lower, upper=upper, slower=slower)


def _slower(place: str, members: tuple[Candidate, ...], slow_s: float) -> Candidate:
    return _one_for_all(place, tuple(m.slower(slow_s) for m in members if m.slower is not None))


def _node_of(network: Network, candidate: Candidate) -> str:
    """Return the one node of a candidate, "" if it has none or several."""
    nodes = {str(v) for table in candidate.adds.values() for k, v in table.items() if k in ("node", "to", "from")}
    if not candidate.adds:
        names = {name.rsplit(".", 1)[0] for name in candidate.changes}
        nodes = {node for e in network.elements if e.name in names for node in e.nodes()}
    return nodes.pop() if len(nodes) == 1 else ""


def _form(candidate: Candidate, node: str) -> Any:
    """Return a candidate's form, independent of its place."""
    tables = tuple(
        tuple(sorted((k, str(v)) for k, v in table.items() if v != node)) for table in candidate.adds.values()
    )
    changes = tuple((name.rsplit(".", 1)[1], weight) for name, weight in candidate.changes.items())
    return candidate.kind, candidate.driver, candidate.unit, candidate.typical, candidate.inverse, tables, changes


def _tied(network: Network, members: Iterable[Candidate]) -> bool:
    """Return True if the members share an element or a parameter already."""
    names = [name for c in members for name in c.changes]
    held = [network.parameters[name].same_as for name in names if name in network.parameters]
    return len(set(names)) < len(names) or any(held)
