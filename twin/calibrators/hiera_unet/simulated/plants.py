"""Simulated rigs for training: networks with more physics than the twin, random parameters, each commissioned.

The twin's network is extended by the physics that a lumped twin omits: pipes with walls, hidden masses, radiation,
natural convection, lagging thermometers, recirculated air, and a source of any time course in every volume. Some of it
belongs to a healthy rig, and commissioning compensates for it; some is added later as an undeclared change. All of it
is one network and one compiled kernel, whose parameters select the physics.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.calibrators.hiera_unet.data.parameters import Deviations
from twin.calibrators.hiera_unet.data.series import STEP_S
from twin.calibrators.hiera_unet.simulated.loads import drive
from twin.commissioning import CommissionOptions, commission
from twin.discovery.effects.catalogue import sites_of
from twin.kernel import Kernel
from twin.network import Array, Network, TwinFileError
from twin.revisions import with_elements
from twin.steady import steady_state

NOTHING = 1e-9
"""Size without influence; exactly 0 would leave the element out of the kernel."""
COMMISSION_H = 8.0
OFFSET_K = 0.03
SPIN_UP_STEPS = 240

ParameterLaw = tuple[str, float, float]
"""Distribution: `log` with the sd of a logarithm and its shift; `uniform` from, to; `wide` log-uniform from, to."""

OWN: Mapping[tuple[str, str], ParameterLaw] = {
    ("node", "capacitance"): ("log", 0.3, 0.1),
    ("flow", "factor"): ("uniform", 0.85, 1.15),
    ("flow", "nominal"): ("log", 0.2, 0.0),
    ("flow", "effectiveness"): ("uniform", 0.93, 1.0),
    ("conduction", "resistance"): ("log", 0.5, 0.0),
    ("ambient_loss", "hA"): ("log", 0.5, -0.2),
    ("radiator", "UA_100"): ("log", 0.3, 0.1),
    ("radiator", "fan_exponent"): ("uniform", 0.4, 0.8),
    ("radiator", "flow_exponent"): ("uniform", 0.0, 0.2),
    ("radiator", "UA_still"): ("uniform", 0.1, 4.0),
    ("radiator", "recirculation"): ("wide", 1e-6, 3e-4),
    ("sensor", "lag_s"): ("uniform", 1.0, 9.0),
}
"""Distributions over rigs of the twin's own parameters, by kind and beginning of the name."""
WITH_POWER = (("radiator", "UA_100"), ("flow", "nominal"))
"""Parameters that grow with the rated power of a rig."""
ON_THE_SHEET = (("node", "capacitance"), ("flow", "nominal"))
FITTED: Mapping[tuple[str, str], ParameterLaw] = {("flow", "effectiveness"): ("uniform", 0.5, 1.0)}
"""Wider distributions of parameters that commissioning or tracking adjusts."""
ADDED: Mapping[tuple[str, str], ParameterLaw] = {
    ("natural_convection", "coefficient"): ("wide", 0.01, 0.5),
    ("radiation", "area"): ("wide", 0.005, 0.2),
    ("hidden_mass", "capacity"): ("wide", 100.0, 5000.0),
    ("hidden_mass", "conductance"): ("wide", 5.0, 60.0),
    ("pipe", "volume"): ("wide", 0.03, 0.6),
    ("pipe", "wall_capacity"): ("wide", 50.0, 900.0),
    ("pipe", "wall_hA"): ("wide", 15.0, 80.0),
    ("pipe", "loss_hA"): ("wide", 0.05, 0.6),
}


@dataclass(frozen=True)
class TrainingRig:
    """One rig: its plant, and its commissioned twin.

    Attributes:
        plant: full vector of the plant's network. nominal: (p,) of the commissioned twin.
        offsets: (Y,) K, constant errors of the thermometers. sigma: (Y,) K, noise of a single sample.
        power: its usual load, as a share of the twin's nominal one.
    """

    plant: Array
    nominal: Array
    offsets: Array
    sigma: Array
    power: float


class Family:
    """Family of all rigs around one twin."""

    def __init__(self, network: Network, deviations: Deviations) -> None:
        self.network, self.deviations = network, deviations
        self.plant = surrounded(network)
        names = tuple(p.id for p in self.plant.parameters.values() if not p.same_as)
        self.kernel = Kernel(self.plant, names)
        self._own = self.plant.index(network.ids)
        self._kinds = {e.name: e.kind for e in self.plant.elements}

    def draw(self, rng: np.random.Generator, power: float = 1.0) -> Array:
        """Draw the full vector of a healthy plant, made for `power` times the nominal load."""
        values = self.plant.values.copy()
        added = {e.name for e in self.plant.elements} - {e.name for e in self.network.elements}
        sets = self.network.sets
        fitted = {*self.deviations.ids, *(sets["commission"].members if "commission" in sets else ())}
        for k, p in enumerate(self.plant.parameters.values()):
            laws = ADDED if p.element in added else {**OWN, **FITTED} if p.id in fitted else OWN
            kind = self._kinds[p.element]
            law = next((v for (a, b), v in laws.items() if a == kind and p.name.startswith(b)), None)
            if law is not None and not p.same_as:
                grown = power if (kind, p.name) in WITH_POWER else 1.0
                values[k] = np.clip(_drawn(rng, law, values[k]) * grown, p.lower, p.upper)
        return values

    def sheet(self, plant: Array, rng: np.random.Generator) -> Network:
        """Draw the twin of a data sheet: volumes and nominal flow approximate, all else as shipped."""
        own = dict(zip(self.network.ids, self.nominal_of(plant).tolist(), strict=True))
        known = {}
        for p in self.network.parameters.values():
            if (self._kinds[p.element], p.name) in ON_THE_SHEET and not p.same_as:
                off = float(np.exp(rng.normal(0.0, 0.1))) if p.name == "capacitance" else 1.0
                known[p.id] = float(np.clip(own[p.id] * off, p.lower, p.upper))
        return self.network.with_values(known)

    def nominal_of(self, plant: Array) -> Array:
        """Return the plant's own values (p,) of the twin's parameters."""
        own: Array = plant[self._own]
        return own

    def deviated(self, plant: Array, theta: Array) -> Array:
        """Return the plant with deviations (P,) from its own healthy values."""
        full = plant.copy()
        full[self._own[self.deviations.index]] = self.deviations.values(theta, self.nominal_of(plant))
        return full

    def start(self, plant: Array, inputs: Array, rng: np.random.Generator) -> Array:
        """Draw a full state of the plant in operation: not at rest, but without remains of an earlier load."""
        begin = steady_state(self.network, inputs[0], self.nominal_of(plant))
        begin = begin + rng.normal(0.0, 2.0) + rng.normal(0.0, 0.3, begin.size)
        time = np.arange(SPIN_UP_STEPS, dtype=np.float64) * STEP_S
        drive = np.tile(self.driven(inputs[:1]), (SPIN_UP_STEPS, 1))
        end: Array = self.kernel.trace(plant, begin, time, drive)[1][0]
        return end

    def driven(self, inputs: Array, injected: Array | None = None) -> Array:
        """Return the plant's inputs: those of the twin (n, c) and heat (n, k) W into its nodes."""
        extra = np.zeros((len(inputs), len(self.network.nodes))) if injected is None else injected
        return np.ascontiguousarray(np.hstack([inputs, extra]))

    def readings(self, vectors: list[tuple[int, Array]], state: Array, inputs: Array, injected: Array) -> Array:
        """Return fault-free readings (n, Y), degC, of a plant whose vector changes.

        Args:
            vectors: (first step, full vector), in order, from step 0 on.
        """
        drive, n = self.driven(inputs, injected), len(inputs)
        out = np.empty((n, len(self.network.sensors)))
        edges = [first for first, _ in vectors] + [n - 1]
        for (first, vector), last in zip(vectors, edges[1:], strict=True):
            time = np.arange(first, last + 1, dtype=np.float64) * STEP_S
            rows, end = self.kernel.trace(vector, state, time, drive[first : last + 1])
            out[first : last + 1], state = rows[0], end[0]
        return out

    def rig(self, seed: int) -> TrainingRig:
        """Return a rig, commissioned on a healthy record of its own, sometimes of a narrow range.

        Raises:
            TwinFileError: no rig that can be commissioned was found.
        """
        for attempt in range(8):
            rng = np.random.default_rng([seed, attempt, 17])
            try:
                return self._commissioned(rng)
            except TwinFileError:
                continue
        raise TwinFileError(f"no rig around twin {self.network.name!r} could be commissioned with seed {seed}")

    def _commissioned(self, rng: np.random.Generator) -> TrainingRig:
        power = float(np.exp(rng.normal(0.0, 0.25)))
        plant = self.draw(rng, power)
        n = int(COMMISSION_H * 3600.0 / STEP_S)
        inputs = drive(self.network, rng, n, 8.0, thorough=bool(rng.uniform() < 0.85), power=power)
        vectors = [(0, plant)]
        clean = self.readings(vectors, self.start(plant, inputs, rng), inputs, np.zeros((n, len(self.network.nodes))))
        sigma = np.asarray(self.network.sigma * rng.uniform(0.6, 1.5))
        offsets: Array = rng.uniform(-OFFSET_K, OFFSET_K, (clean.shape[1],))
        measured = clean + offsets + rng.standard_normal(clean.shape) * sigma / np.sqrt(STEP_S)
        time = np.arange(n, dtype=np.float64) * STEP_S
        done = commission(self.sheet(plant, rng), time[::2], inputs[::2], measured[::2], CommissionOptions(starts=1))
        return TrainingRig(plant, done.network.values.copy(), offsets, sigma, power)


def surrounded(network: Network) -> Network:
    """Return the network with all physics that a lumped twin omits, at small sizes.

    Raises:
        TwinFileError: an element does not fit this network.
    """
    sites = sites_of(network)
    having = {(e.kind, node) for e in network.elements for node in (*e.nodes(), getattr(e, "to", ""))}
    tables: dict[str, dict[str, Any]] = {}
    inputs: dict[str, dict[str, Any]] = {}
    for node in network.nodes:
        inputs[_column(node)] = {"nominal": 0.0, "lower": -1e5, "upper": 1e5, "unit": "W"}
        tables[f"inject_{node}"] = {"kind": "heat_source", "node": node, "driver": _column(node), "law": "linear"} | {
            "gain": 1.0
        }
        more: dict[str, dict[str, Any]] = {
            "hidden_mass": {"node": node, "capacity": 500.0, "conductance": 10.0},
        }
        if sites.room:
            more["natural_convection"] = {"node": node, "ambient": sites.room, "coefficient": 0.1}
            more["radiation"] = {"node": node, "ambient": sites.room, "area": 0.02}
        if sites.room and node in sites.before:
            walls = {"wall_capacity": 300.0, "wall_hA": 30.0, "loss_hA": 0.2}
            more["pipe"] = {"to": node, "ambient": sites.room, "volume": 0.2, **walls}
        for kind, table in more.items():
            if (kind, node) not in having:
                tables[f"{kind}_at_{node}"] = {"kind": kind, **table}
    replace: dict[str, dict[str, Any]] = {s.name: {"lag_s": 3.0} for s in network.sensors}
    for element in network.elements:
        if element.kind == "radiator":
            replace[element.name] = {"UA_still": 1.0, "recirculation": 1e-5, "flow_exponent": 0.05}
    return with_elements(network, tables, inputs=inputs, replace=replace)


def _column(node: str) -> str:
    return f"inject_{node}_W"


def _drawn(rng: np.random.Generator, law: ParameterLaw, value: float) -> float:
    name, a, b = law
    if name == "log":
        return value * float(np.exp(rng.normal(b, a)))
    if name == "uniform":
        return float(rng.uniform(a, b))
    return float(np.exp(rng.uniform(np.log(a), np.log(b))))
