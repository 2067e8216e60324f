"""Open laws: any recorded input or temperature as driver, in each of the `forms`, at each of the `sites`.

A law is a site, a driver and a form. The same evidence weighs it as a named one, from a smaller prior.

A fit brings the heat of a law into the nodes of a shared kernel, and adds an error of reading to what is simulated.
Laws of a flow and of a loss are fitted as elements that follow a column with the law's values. A law that follows the
temperature of a node is evaluated on measured temperatures, and fitted as an element that follows the twin's.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from twin.discovery.effects.laws import CandidateLaw
from twin.discovery.effects.open_laws.forms import Values, course_of_node, values_of, values_of_nodes
from twin.discovery.effects.open_laws.sites import OpenSite, sites_of
from twin.discovery.records.grid import Grid
from twin.elements import KINDS
from twin.elements.candidates import Candidate
from twin.elements.law_forms import FORMS
from twin.network import Array, Network
from twin.revisions.law_adoption import adopt_law

FOLLOW_NODES = ("flow",)
"""Kinds of sites at which something may follow the temperature of a node. Measured temperatures hold what an effect did
to them, so that heat seems to follow those that it raised."""


class OpenLaw(CandidateLaw):
    """Law at a site; its response is computed on request, as there are hundreds of laws."""

    site: OpenSite
    values: Array

    def __init__(self, candidate: Candidate, site: OpenSite, values: Array) -> None:
        for name, value in (("candidate", candidate), ("site", site), ("values", values)):
            object.__setattr__(self, name, value)

    @property
    def heat(self) -> Array | None:
        """Return the heat (n, k) into the nodes, W."""
        return None if self.site.heat is None else self.site.heat * self.values[:, None]

    @property
    def reading(self) -> Array | None:
        """Return the change of the readings (n, m), K."""
        return None if self.site.reading is None else self.site.reading * self.values[:, None]


def open_laws(network: Network, grid: Grid, named: Sequence[CandidateLaw], known: Array) -> list[OpenLaw]:
    """Return the laws of any input and temperature at every site that are not among the named ones.

    Args:
        known: (n, k) degC of the nodes, as the laws are evaluated on them.
    """
    taken = {(law.candidate.kind, law.candidate.where, law.candidate.driver) for law in named}
    every = [(v, v.at(grid.time, grid.inputs)) for v in values_of(network, grid)]
    of_nodes = [(v, course_of_node(network, v, known)) for v in values_of_nodes(network, known)]
    constant = Values("constant", "constant", {"size": 1.0}, None, 1.0, "")
    found = []
    for site in sites_of(network, named):
        solid = site.heat is not None and site.reading is not None
        if solid or site.kind == "heat_transfer":
            candidate = candidate_of(network, site, constant)
            found.append(OpenLaw(candidate, site, np.ones(len(grid.time))))
        for values, course in every:
            if solid and values.form != "linear":
                continue
            if not solid and values.form == "linear" and (site.kind, site.where, values.driver) in taken:
                continue
            found.append(OpenLaw(candidate_of(network, site, values), site, course))
        if site.kind in FOLLOW_NODES and not solid:
            found += [OpenLaw(candidate_of(network, site, values), site, course) for values, course in of_nodes]
    return found


def law_on_record(network: Network, law: OpenLaw, candidate: Candidate, grid: Grid, known: Array) -> OpenLaw:
    """Return the law of a candidate at the site of another law, for a record `grid` with temperatures `known`."""
    if candidate.follows is not None:
        return OpenLaw(candidate, law.site, candidate.follows(grid.time, grid.inputs))
    parameters = dict(candidate.adopts)
    form, node = str(parameters.pop("form")), str(parameters.pop("of"))
    del parameters["site"]
    values = Values(candidate.driver, form, {FORMS[form][0]: 1.0, **parameters}, None, 1.0, "", node)
    return OpenLaw(candidate, law.site, course_of_node(network, values, known))


def laws_of(
    network: Network, candidates: Iterable[Candidate], opened: Sequence[OpenLaw], grid: Grid, known: Array
) -> list[OpenLaw]:
    """Return the laws of open candidates at the sites of `opened`, all open laws of the record; others are left out."""
    sites = {law.site.column: law for law in opened} | {law.site.name: law for law in opened}
    return [
        law_on_record(network, sites[at], c, grid, known)
        for c in candidates
        if (at := c.column or str(c.adopts.get("site", ""))) in sites
    ]


def candidate_of(network: Network, site: OpenSite, values: Values) -> Candidate:
    """Return the candidate of a law at a site."""
    scale, unit = max(values.scale, 1.0e-12), _unit(network, site, values)
    says = f"{site.says} {values.says}".rstrip()
    if unit == "W/W" and values.form == "linear":
        says = site.says.replace("{value}", f"{{value}} of {values.driver.replace('_', ' ')}")
    candidate = Candidate(
        site.kind,
        site.where,
        values.driver,
        "new",
        site.changes,
        unit,
        site.typical / scale,
        site.lower / scale,
        site.upper / scale,
        says,
        adds=site.tables,
        shapes=("step",),
    )
    if values.of:
        return _of_a_temperature(candidate, site, values)
    return replace(
        candidate,
        column=site.column,
        follows=values.at,
        injects=site.injects,
        reads=site.reads,
        adopts={"form": values.form, "column": values.column, **values.parameters},
    )


def _of_a_temperature(candidate: Candidate, site: OpenSite, values: Values) -> Candidate:
    """Return a candidate with elements that follow a node's temperature, in place of a column."""
    strength = FORMS[values.form][0]
    others = {key: value for key, value in values.parameters.items() if key != strength}
    law = {"of": values.of, "form": values.form, **others}
    return replace(
        candidate,
        changes={f"{key.rsplit('.', 1)[0]}.{strength}": weight for key, weight in site.changes.items()},
        adds={name: {**{k: v for k, v in t.items() if k != "driver"}, **law} for name, t in site.tables.items()},
        adopts={"site": site.name, **law},
    )


def _unit(network: Network, site: OpenSite, values: Values) -> str:
    """Return the unit of the strength of a law, as its element has it."""
    table = next(iter(site.tables.values()))
    places = tuple((key, value) for key, value in table.items() if key not in ("kind", "driver", "form"))
    driver = "" if values.column is None else network.input_columns[values.column]
    unit = _unit_of(str(table["kind"]), places, driver, values.of, values.form)
    return site.unit if unit == "1" else unit


@functools.lru_cache(maxsize=1024)
def _unit_of(kind: str, places: tuple[tuple[str, Any], ...], driver: str, of: str, form: str) -> str:
    """Return the unit of the strength of a law that an element of a kind has, which hundreds of laws share."""
    of_kind = KINDS[kind]
    law: dict[str, Any] = {of_kind.places()[key].name: value for key, value in places}
    law |= ({"driver": driver} if driver else {}) | ({"of": of} if of else {})
    specs = of_kind(name="law", form=form, **law).parameter_specs()  # type: ignore[call-arg]
    return next(spec.unit for spec in specs if spec.name == FORMS[form][0])


def adopted(network: Network, candidate: Candidate, size: float) -> Network:
    """Return the network with the elements of an open law at a size, following the column of the record itself."""
    law = dict(candidate.adopts)
    form, column = law.pop("form"), law.pop("column")
    strength = FORMS[form][0]
    for name, table in candidate.adds.items():
        if f"{name}.gain" not in candidate.changes:
            continue  # an actuator, which adoption brings with it
        site = {key: str(value) for key, value in table.items() if key not in ("driver", "form")}
        weight = candidate.changes[f"{name}.gain"]
        parameters = {**law, strength: size * weight * law[strength]}
        driver = {} if column is None else {"driver": network.input_columns[column]}
        network = adopt_law(network, {**site, **driver, "form": form}, parameters)
    return network
