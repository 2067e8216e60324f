"""Undeclared changes of a rig: random, with realistic sizes.

A change varies parameters that the twin tracks (then its deviation is known), adds physics that the twin lacks, or is a
sensor fault. Its time course is a step, growing, or intermittent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from twin.calibrators.hiera_unet.data.parameters import FACTOR, LOSS, REACH, SUM
from twin.calibrators.hiera_unet.data.series import STEP_S
from twin.calibrators.hiera_unet.simulated.plants import Family
from twin.discovery.effects.formulas import follow
from twin.elements.heat_source import HeatSource
from twin.network import Array

FROM_THE_START = 0.2
SHAPES = ("step", "ramp", "saturating", "for a time")
SHAPE_SHARES = (0.6, 0.2, 0.08, 0.12)
UNTOLD = ("resistance",)
"""Parameters with little influence beside the flow, which change rarely."""


@dataclass(frozen=True)
class Change:
    """One undeclared change over n steps.

    Attributes:
        what: in words. course: (n,) from 0 to 1. theta: (P,) deviation at full size.
        added: place in the plant's vector -> increment at full size. heat: (n, k) W into the nodes, or None.
        sensor, error: a sensor's number, and the function of its faulty readings (n,), or None.
    """

    what: str
    course: Array
    theta: Array
    added: Mapping[int, float] = field(default_factory=dict)
    heat: Array | None = None
    sensor: int = -1
    error: Callable[[Array], Array] | None = None


def draw(family: Family, plant: Array, rng: np.random.Generator, inputs: Array, hour: float) -> tuple[Change, ...]:
    """Draw between one and three changes for a record with `inputs` (n, c)."""
    kind = rng.choice(("tracked", "structure", "both"), p=(0.45, 0.2, 0.35))
    found: list[Change] = []
    if kind != "structure":
        count = int(rng.choice((1, 2, 3), p=(0.6, 0.25, 0.15)))
        found.append(tracked(family, rng, len(inputs), count))
    if kind != "tracked":
        found.append(untracked(family, plant, rng, inputs, hour))
    return tuple(found)


def untracked(family: Family, plant: Array, rng: np.random.Generator, inputs: Array, hour: float) -> Change:
    """Draw a change outside of the tracked parameters, except for heat where the twin tracks a power."""
    make = _STRUCTURE[int(rng.integers(len(_STRUCTURE)))]
    return make(family, plant, rng, inputs, hour)


def course(rng: np.random.Generator, n: int) -> tuple[Array, str]:
    """Draw the time course of a change: (n,) from 0 to 1, and in words."""
    if rng.uniform() < FROM_THE_START:
        return np.ones(n), "from the start"
    onset = float(rng.uniform(0.08, 0.95)) * n
    steps = np.arange(n) - onset
    shape = str(rng.choice(SHAPES, p=SHAPE_SHARES))
    grows = float(np.exp(rng.uniform(np.log(600.0), np.log(7200.0)))) / STEP_S
    if shape == "ramp":
        return np.clip(steps / grows, 0.0, 1.0), "growing"
    if shape == "saturating":
        return np.where(steps > 0.0, -np.expm1(-np.maximum(steps, 0.0) / (0.5 * grows)), 0.0), "settling in"
    if shape == "for a time":
        return ((steps >= 0.0) & (steps < grows)).astype(np.float64), "for a time"
    return (steps >= 0.0).astype(np.float64), "at once"


def tracked(family: Family, rng: np.random.Generator, n: int, count: int) -> Change:
    """Draw a joint change of parameters that the twin tracks."""
    deviations = family.deviations
    weight = np.array([0.15 if name.endswith(UNTOLD) else 1.0 for name in deviations.ids])
    chosen = rng.choice(len(deviations), size=min(count, len(deviations)), replace=False, p=weight / weight.sum())
    theta = np.zeros(len(deviations))
    for k in chosen:
        theta[k] = size(rng, int(deviations.law[k]))
    shape, words = course(rng, n)
    moved = ", ".join(f"{deviations.ids[k]} {theta[k]:+.2f}" for k in chosen)
    return Change(f"{moved} {words}", shape, theta)


def size(rng: np.random.Generator, law: int) -> float:
    """Draw a deviation: log-uniform in size, so that small and large ones are equally frequent."""
    low, high, positive = {FACTOR: (0.03, REACH, 0.4), LOSS: (0.02, 0.8, 0.8), SUM: (0.02, REACH, 0.8)}[law]
    sign = 1.0 if rng.uniform() < positive else -1.0
    value = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    return sign * (value if law != LOSS or sign > 0.0 else min(value, 0.15))


def _none(family: Family) -> Array:
    return np.zeros(len(family.deviations))


def _source(family: Family, plant: Array, rng: np.random.Generator, inputs: Array, hour: float) -> Change:
    """Draw a heat source of one of several laws. Where the twin tracks a power, the deviation is known."""
    n, nodes = len(inputs), family.network.nodes
    node = int(rng.integers(len(nodes)))
    watts = float(np.exp(rng.uniform(np.log(8.0), np.log(250.0)))) * (1.0 if rng.uniform() < 0.85 else -1.0)
    shape, words = course(rng, n)
    law, name = _law(family, rng, inputs, hour)
    heat: Array = np.zeros((n, len(nodes)))
    heat[:, node] = watts * shape * law
    return Change(f"{watts:+.0f} W at {nodes[node]}, {name}, {words}", shape, _none(family), heat=heat)


def _law(family: Family, rng: np.random.Generator, inputs: Array, hour: float) -> tuple[Array, str]:
    columns, n = family.network.input_columns, len(inputs)
    drives = [j for j, c in enumerate(columns) if c.endswith(("_W", "_pct"))]
    time = np.arange(n) * STEP_S
    name = str(rng.choice(("constant", "driven", "periodic", "daily"), p=(0.45, 0.3, 0.15, 0.1)))
    if name == "driven" and drives:
        j = drives[int(rng.integers(len(drives)))]
        share = inputs[:, j] / max(family.network.nominal_inputs[j], 1e-9)
        exponent = 3.0 if columns[j].endswith("_pct") else 1.0
        return np.maximum(share, 0.0) ** exponent, f"with {columns[j]}"
    if name == "periodic":
        period, duty = rng.uniform(600.0, 7200.0), rng.uniform(0.2, 0.7)
        on: Array = ((time + rng.uniform(0.0, period)) % period < duty * period).astype(np.float64)
        return on, "on and off"
    if name == "daily":
        return np.maximum(np.cos(2.0 * np.pi * (hour + time / 3600.0 - rng.uniform(0.0, 24.0)) / 24.0), 0.0), "daily"
    return np.ones(n), "constant"


_ADDED: tuple[tuple[str, str, float, float, bool], ...] = (
    ("natural_convection", "coefficient", 0.3, 3.0, False),
    ("radiation", "area", 0.1, 1.0, False),
    ("hidden_mass", "capacity", 2000.0, 60000.0, False),
    ("pipe", "volume", 0.2, 2.0, False),
    ("pipe", "loss_hA", 0.5, 6.0, False),
    ("radiator", "fan_exponent", 0.05, 0.5, True),
    ("radiator", "recirculation", 5e-4, 6e-3, False),
    ("radiator", "UA_still", 1.0, 8.0, False),
    ("flow", "factor", 0.02, 0.35, True),
    ("flow", "effectiveness", 0.02, 0.4, True),
    ("heat_source", "factor", 0.01, 0.15, True),
)
"""Kind of element, beginning of its parameter's name, smallest and largest addition, whether it may also shrink."""


def _physics(family: Family, plant: Array, rng: np.random.Generator, inputs: Array, hour: float) -> Change:
    """Draw a change of a parameter of the plant that the twin does not track, or does not have."""
    kinds = {e.name: e.kind for e in family.plant.elements}
    tracked_ids = set(family.deviations.ids)
    places = [
        (k, p, law)
        for law in _ADDED
        for k, p in enumerate(family.plant.parameters.values())
        if kinds[p.element] == law[0] and p.name.startswith(law[1]) and p.id not in tracked_ids and not p.same_as
    ]
    laws = sorted({law for _, _, law in places})
    if not laws:
        return _source(family, plant, rng, inputs, hour)
    chosen = laws[int(rng.integers(len(laws)))]
    alike = [row for row in places if row[2] == chosen]
    k, p, (_, _, low, high, both) = alike[int(rng.integers(len(alike)))]
    amount = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    if both and rng.uniform() < 0.7:
        amount = -amount
    amount = float(np.clip(plant[k] + amount, p.lower, p.upper) - plant[k])
    shape, words = course(rng, len(inputs))
    return Change(f"{p.id} {amount:+.3g} {words}", shape, _none(family), added={k: amount})


def _thermometer(family: Family, plant: Array, rng: np.random.Generator, inputs: Array, hour: float) -> Change:
    """Draw a sensor fault: bias, drift, lag or gain."""
    j = int(rng.integers(len(family.network.sensors)))
    shape, words = course(rng, len(inputs))
    name = str(rng.choice(("bias", "drift", "lag", "gain"), p=(0.4, 0.25, 0.2, 0.15)))
    sign = float(rng.choice((-1.0, 1.0)))
    amount = float(np.exp(rng.uniform(np.log(0.08), np.log(1.5))))
    lag = float(np.exp(rng.uniform(np.log(15.0), np.log(300.0))))
    since = np.maximum(np.arange(len(shape)) - int(np.argmax(shape > 0.0)), 0) * STEP_S / 3600.0

    def error(readings: Array) -> Array:
        if name == "lag":
            late = follow(readings, lag, STEP_S)
            return readings + shape * (late - readings)
        if name == "gain":
            return readings * (1.0 + sign * shape * 0.02 * amount)
        return readings + sign * amount * shape * (since if name == "drift" else 1.0)

    figure = f"{lag:.0f} s" if name == "lag" else f"{sign * amount:+.2f}"
    what = f"{family.network.sensor_names[j]} {name} {figure} {words}"
    return Change(what, shape, _none(family), sensor=j, error=error)


_STRUCTURE = (_source, _source, _physics, _physics, _physics, _thermometer, _thermometer)


def moved(changes: tuple[Change, ...], count: int, n: int) -> Array:
    """Return the deviations (n, P) of the tracked parameters themselves."""
    theta: Array = np.zeros((n, count))
    for change in changes:
        theta += change.course[:, None] * change.theta
    return np.clip(theta, -REACH, REACH)


def heated(changes: tuple[Change, ...], family: Family, n: int) -> Array:
    """Return the heat (n, k), W, into the nodes."""
    heat: Array = np.zeros((n, len(family.network.nodes)))
    for change in changes:
        if change.heat is not None:
            heat += change.heat
    return heat


def equivalent(heat: Array, family: Family) -> Array:
    """Return the deviations (n, P) that are equivalent to heat into the nodes (n, k), where the twin tracks a constant
    power.
    """
    deviations, network = family.deviations, family.network
    theta: Array = np.zeros((len(heat), len(deviations)))
    for k, name in enumerate(deviations.ids):
        element = next(e for e in network.elements if e.name == network.parameters[name].element)
        if deviations.law[k] == SUM and isinstance(element, HeatSource) and not element.driver:
            theta[:, k] = heat[:, network.nodes.index(element.node)] / deviations.scale[k]
    return theta
