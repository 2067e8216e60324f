"""Laws without a name: any recorded input or temperature as driver, in several forms, at every site of a network.

A site is a place where something may act with a value of one unit: heat into a node or out of one into another, heat
into the solid part of a node that its thermometer reads, a share of a flow, a conductance to the room, an error of a
reading. Its response per unit is that of the named law there. A law
is a site, a driver and a form; it is weighed by the same evidence as a named one, from a smaller prior.

A fit brings the heat of a law into the nodes of a shared kernel, and adds an error of reading to what is simulated.
Laws of a flow and of a loss are fitted as elements that follow a column with the law's values. A law that follows the
temperature of a node is evaluated on measured temperatures, and fitted as an element that follows the twin's.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from twin.discovery.effects.laws import CandidateLaw
from twin.discovery.records.grid import Grid
from twin.elements import KINDS
from twin.elements.base import STAMP
from twin.elements.candidates import Candidate
from twin.elements.law_forms import FORMS
from twin.laws import law_values
from twin.network import Array, Network
from twin.revisions.law_adoption import adopt_law

MOST_LEVELS = 8
"""Levels of a column up to which a threshold is sought between each two; beyond, at quartiles."""
LAGS_S = (900.0, 3600.0)
"""Time constants with which an effect may follow its driver, s: those of a volume and of a room."""
SOLID_K_PER_W = tuple(float(f"{0.003 * 1.5**i:.3g}") for i in range(7))
"""Temperatures of a solid part above that of its water for each watt that enters it, K/W: those of 330 to 30 W/K
between the two, so close together that the next one is off by a fifth at most."""
LEAST_SPREAD = 1.0e-3
"""Standard deviation of a column, as a share of its largest magnitude, below which nothing can follow it."""
FOLLOW_NODES = ("flow",)
"""Kinds of sites at which something may follow the temperature of a node. Measured temperatures hold what an effect did
to them, so that heat seems to follow those that it raised."""
NAMES = {"heater_power_W": "heater_power", "pump_speed_pct": "pump_speed", "fan_speed_pct": "fan_speed"}


@dataclass(frozen=True)
class OpenSite:
    """A place of an open law.

    Attributes:
        name: of its column. kind, where: in a diagnosis's words. tables: elements that act there, following the column.
        changes: parameter -> weight. unit: of a value; `typical`, `lower`, `upper` in it.
        heat, reading: response (n, k) W or (n, m) K per unit; None where it is none. says: with {value}.
        injects, reads: nodes and sensors on which a value of 1 acts, where that is all that it does.
    """

    name: str
    kind: str
    where: str
    tables: Mapping[str, Mapping[str, Any]]
    changes: Mapping[str, float]
    unit: str
    typical: float
    lower: float
    upper: float
    heat: Array | None
    reading: Array | None
    says: str

    injects: Mapping[str, float] = field(default_factory=dict)
    reads: Mapping[str, float] = field(default_factory=dict)

    @property
    def column(self) -> str:
        """Return the name of the column that the site's elements follow."""
        return f"open_{self.name}"


@dataclass(frozen=True)
class Values:
    """Values of a form for a driver, one for a unit of its strength.

    Attributes:
        driver: in a diagnosis's words. form, parameters: as in `twin.elements.law_forms`, the strength 1.
        column: index of the input that is followed, or None. scale: largest magnitude of the values.
        says: what it follows, in words. of: node whose temperature is followed instead of an input, or "".
    """

    driver: str
    form: str
    parameters: Mapping[str, float]
    column: int | None
    scale: float
    says: str
    of: str = ""

    def at(self, time_s: Array, inputs: Array) -> Array:
        """Return the values (n,) for stamps (n,) s and inputs (n, c)."""
        x = None if self.column is None else inputs[:, self.column]
        return law_values(self.form, "always", self.parameters, x, time_s)


class OpenLaw(CandidateLaw):
    """A law at a site; its response is made when it is asked for, as there are hundreds of them."""

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
    of_nodes = [(v, _of_node(network, v, known)) for v in _values_of_nodes(network, known)]
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
    return OpenLaw(candidate, law.site, _of_node(network, values, known))


def _of_node(network: Network, values: Values, known: Array) -> Array:
    x = known[:, network.nodes.index(values.of)]
    # Neither form depends on the length of a sample.
    return law_values(values.form, "always", values.parameters, x, np.arange(float(len(x))))


def _values_of_nodes(network: Network, known: Array) -> Iterator[Values]:
    """Yield the forms that an effect may have as a function of the temperatures that are read."""
    for node in dict.fromkeys(s.node for s in network.sensors):
        x = known[:, network.nodes.index(node)]
        low, middle, high = (float(v) for v in np.quantile(x, (0.25, 0.5, 0.75)))
        if not high - low > LEAST_SPREAD * max(abs(high), 1.0e-9):
            continue
        scale = float(np.abs(x - middle).max())
        at = f"the temperature of {node}"
        linear = {"gain": 1.0, "reference": middle}
        yield Values(
            "temperature", "linear", linear, None, scale, f"in proportion to {at} above {middle:.4g} degC", node
        )
        for level in (low, middle, high):
            switched = {"size": 1.0, "on": level, "off": level}
            yield Values("temperature", "threshold", switched, None, 1.0, f"while {at} is above {level:.4g} degC", node)


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
    kind = KINDS[str(table["kind"])]
    places = {kind.places()[key].name: value for key, value in table.items() if key not in ("kind", "driver", "form")}
    driver = {} if values.column is None else {"driver": network.input_columns[values.column]}
    driver |= {"of": values.of} if values.of else {}
    law: dict[str, Any] = {**places, **driver, "form": values.form}
    element = kind(name="law", **law)
    strength = FORMS[values.form][0]
    unit = next(spec.unit for spec in element.parameter_specs() if spec.name == strength)
    return site.unit if unit == "1" else unit


def values_of(network: Network, grid: Grid) -> Iterator[Values]:
    """Yield the forms that an effect may have as a function of the inputs of a record."""
    for j, column in enumerate(network.input_columns):
        x = grid.inputs[:, j]
        spread, largest = float(np.std(x)), float(np.abs(x).max())
        if column.startswith("time_of_day") or column == STAMP or spread <= LEAST_SPREAD * max(largest, 1e-9):
            continue
        stem, _, unit = column.rpartition("_")
        driver = NAMES.get(column, "temperature" if unit == "C" else stem or column)
        spoken = (stem or column).replace("_", " ")
        of = partial(Values, driver, column=j)
        low, high = float(x.min()), float(x.max())
        references = (low, high, float(np.median(x))) if unit == "C" else (0.0,)
        for reference in references:
            scale = float(np.abs(x - reference).max())
            above = f" above {reference:.4g}" if reference else ""
            yield of(
                "linear",
                parameters={"gain": 1.0, "reference": reference},
                scale=scale,
                says=f"in proportion to {spoken}{above}",
            )
        if unit == "pct":
            yield of(
                "power",
                parameters={"size": 1.0, "reference": 0.0, "scale": 100.0, "exponent": 2.0},
                scale=1.0,
                says=f"with the square of {spoken}",
            )
        for lag in LAGS_S:
            reference = references[-1] if unit == "C" else 0.0
            scale = float(np.abs(x - reference).max())
            yield of(
                "memory",
                parameters={"gain": 1.0, "reference": reference, "lag_s": lag},
                scale=scale,
                says=f"following {spoken} within {lag / 60:.0f} min",
            )
        for level in _levels(x):
            yield of(
                "threshold",
                parameters={"size": 1.0, "on": level, "off": level},
                scale=1.0,
                says=f"while {spoken} is above {level:.4g}",
            )


def _levels(x: Array) -> list[float]:
    levels = np.unique(np.round(x, 6))
    if len(levels) <= MOST_LEVELS:
        return [float(v) for v in 0.5 * (levels[1:] + levels[:-1])]
    return [float(v) for v in np.unique(np.quantile(x, (0.25, 0.5, 0.75)))]


def sites_of(network: Network, named: Sequence[CandidateLaw]) -> list[OpenSite]:
    """Return the sites of a network, with the responses of the named laws there."""
    found: dict[str, OpenSite] = {}
    for law in named:
        c = law.candidate
        if c.shapes == () or c.begins:
            continue
        site: OpenSite | None = None
        if c.kind == "heat_source" and c.driver == "constant" and law.heat is not None:
            site = _heat_site(network, law)
        elif c.kind == "sensor" and c.driver == "constant" and law.reading is not None:
            site = _reading_site(network, law)
        elif c.kind == "flow" and c.driver == "constant" and c.where == "loop":
            site = _flow_site(network, law)
        elif c.kind == "heat_loss" and c.driver == "temperature_difference":
            site = _loss_site(network, law)
        if site is not None:
            found.setdefault(site.name, site)
    for site in [*_transfers(network, named), *_solids(network, list(found.values()))]:
        found.setdefault(site.name, site)
    return list(found.values())


def _plain(text: str) -> str:
    return "".join(ch if ch.isalnum() else "_" for ch in text)


def _heat_site(network: Network, law: CandidateLaw) -> OpenSite:
    assert law.heat is not None
    c = law.candidate
    weight = np.abs(law.heat).max(axis=0)
    name = f"heat_{_plain(c.where)}"
    nodes = [(network.nodes[k], float(w / weight.sum())) for k, w in enumerate(weight) if w > 0.0]
    response = law.heat / max(float(law.heat.sum(axis=1).max()), 1e-12)
    tables = {
        f"{name}_{node}": {"kind": "law_heat", "node": node, "driver": f"open_{name}", "form": "linear"}
        for node, _ in nodes
    }
    changes = {f"{name}_{node}.gain": share for node, share in nodes}
    return OpenSite(
        name,
        "heat_source",
        c.where,
        tables,
        changes,
        "W",
        20.0,
        -2000.0,
        2000.0,
        response,
        None,
        "gives off {value}",
        injects=dict(nodes),
    )


def _reading_site(network: Network, law: CandidateLaw) -> OpenSite | None:
    c = law.candidate
    names = [key.split(".")[0] for key in c.changes]
    if any(n not in network.sensor_names for n in names):
        return None
    name = f"read_{_plain(c.where)}"
    tables = {
        f"{name}_{s}": {"kind": "law_reading", "sensor": s, "driver": f"open_{name}", "form": "linear"} for s in names
    }
    changes = {f"{name}_{s}.gain": 1.0 for s in names}
    return OpenSite(
        name,
        "sensor",
        c.where,
        tables,
        changes,
        "K",
        0.2,
        -20.0,
        20.0,
        None,
        law.reading,
        "reads {value} too high",
        reads=dict.fromkeys(names, 1.0),
    )


def _flow_site(network: Network, law: CandidateLaw) -> OpenSite | None:
    c = law.candidate
    (key, *others) = c.changes
    element, parameter = key.split(".")
    if others or parameter != "factor" or law.heat is None:
        return None
    factor = network.parameters[key].value
    name = f"flow_{_plain(element)}"
    tables = {name: {"kind": "law_flow", "flow": element, "driver": f"open_{name}", "form": "linear"}}
    return OpenSite(
        name,
        "flow",
        c.where,
        tables,
        {f"{name}.gain": 1.0},
        "of the flow",
        0.03,
        -0.8,
        1.0,
        law.heat * factor,
        None,
        "carries {value} more",
    )


def _loss_site(network: Network, law: CandidateLaw) -> OpenSite | None:
    c = law.candidate
    room = next((col for col in network.input_columns if col.startswith("T_amb")), "")
    if law.heat is None or not room:
        return None
    active = np.flatnonzero(np.abs(law.heat).max(axis=0) > 0.0)
    if len(active) != 1:
        return None
    node = network.nodes[int(active[0])]
    name = f"loss_{_plain(node)}"
    tables = {
        name: {"kind": "law_conductance", "node": node, "ambient": room, "driver": f"open_{name}", "form": "linear"}
    }
    return OpenSite(
        name,
        "heat_loss",
        c.where,
        tables,
        {f"{name}.gain": 1.0},
        "W/K",
        1.0,
        -60.0,
        60.0,
        law.heat,
        None,
        "loses {value} more to the room",
    )


def _solids(network: Network, sites: Sequence[OpenSite]) -> Iterator[OpenSite]:
    """Yield heat into the solid part of a volume that its thermometer reads: the water shows all of the heat, and the
    thermometer what the solid is warmer by besides."""
    for site in sites:
        if site.kind != "heat_source" or site.heat is None or len(site.injects) != 1:
            continue
        (node,) = site.injects
        sensors = [s.name for s in network.sensors if s.node == node]
        if not sensors:
            continue
        reading = np.zeros((len(site.heat), len(network.sensors)))
        reading[:, [network.sensor_names.index(s) for s in sensors]] = 1.0
        for above in SOLID_K_PER_W:
            name = f"solid_{_plain(site.where)}_{round(1e5 * above)}"
            heat = f"{name}_heat"
            column = f"open_{name}"
            tables: dict[str, dict[str, Any]] = {
                heat: {"kind": "law_heat", "node": node, "driver": column, "form": "linear"}
            }
            tables |= {
                f"{name}_{s}": {"kind": "law_reading", "sensor": s, "driver": column, "form": "linear"} for s in sensors
            }
            changes = {f"{heat}.gain": 1.0} | {f"{name}_{s}.gain": above for s in sensors}
            yield OpenSite(
                name,
                "heat_source",
                site.where,
                tables,
                changes,
                "W",
                site.typical,
                site.lower,
                site.upper,
                site.heat,
                above * reading,
                "gives off {value} into its solid part",
                injects={node: 1.0},
                reads=dict.fromkeys(sensors, above),
            )


def _transfers(network: Network, named: Sequence[CandidateLaw]) -> Iterator[OpenSite]:
    """Yield heat that is taken from one node that is read and given to another."""
    count = next((len(law.heat) for law in named if law.heat is not None), 0)
    read = list(dict.fromkeys(s.node for s in network.sensors))
    for a, b in itertools.combinations(read, 2):
        heat = np.zeros((count, len(network.nodes)))
        heat[:, network.nodes.index(a)], heat[:, network.nodes.index(b)] = 1.0, -1.0
        name = f"transfer_{_plain(a)}_{_plain(b)}"
        tables = {name: {"kind": "law_heat", "node": a, "source": b, "driver": f"open_{name}", "form": "linear"}}
        yield OpenSite(
            name,
            "heat_transfer",
            a,
            tables,
            {f"{name}.gain": 1.0},
            "W",
            20.0,
            -2000.0,
            2000.0,
            heat,
            None,
            f"receives {{value}} from {b}",
            injects={a: 1.0, b: -1.0},
        )


def adopted(network: Network, candidate: Candidate, size: float) -> Network:
    """Return the network with the elements of an open law at a size, following the column of the record itself."""
    law = dict(candidate.adopts)
    form, column = law.pop("form"), law.pop("column")
    strength = FORMS[form][0]
    for name, table in candidate.adds.items():
        site = {key: str(value) for key, value in table.items() if key not in ("driver", "form")}
        weight = candidate.changes[f"{name}.gain"]
        parameters = {**law, strength: size * weight * law[strength]}
        driver = {} if column is None else {"driver": network.input_columns[column]}
        network = adopt_law(network, {**site, **driver, "form": form}, parameters)
    return network
