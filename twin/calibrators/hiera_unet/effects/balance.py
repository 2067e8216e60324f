"""Energy balance of a twin in windows of ten minutes, one every five: the power at each node that the twin lacks.

With measured temperatures T and inputs u the twin's own formulas give the heat Q_i(T, u) into each node. What is left,

    p_i = C_i dT_i/dt - Q_i(T, u),

is the power that the twin lacks there. Over a window it is weighted by w(t) = sin^2(pi (t - a) / L), and the derivative
is moved onto the weight, so that no reading is differentiated:

    p_i = (-int w' C_i T_i dt - int w Q_i dt) / int w dt.

Source: modulating functions (Shinbrot, Trans. ASME 79 (1957) 547). Windows overlap by half and their weights add up to
one, so a sum over windows is the balance of the whole time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.calibrators.hiera_unet.model.config import HieraError
from twin.discovery.effects.formulas import Formulas
from twin.elements.flow import Flow
from twin.elements.sensor import Sensor
from twin.network import Array, Network

WINDOW_S, EVERY_S = 600.0, 300.0
"""Length of a window, and the time from one to the next, s."""
GRID_S = 5.0
"""Step, s, to which faster samples are averaged."""
MOST_MISSING = 0.2
"""Share of missing readings or inputs from which a window is void."""
KINDS = (
    "heat_source",
    "heat_loss",
    "thermal_mass",
    "sensor",
    "room",
    "flow",
    "bypass",
    "heat_rejection",
    "coupling",
    "actuator",
)
UNITS = {"heat_source": "W", "heat_loss": "W/K", "thermal_mass": "J/K", "sensor": "K", "room": "K"}
"""Unit of a hypothesis's size; shares of the commissioned value where none is named."""
NAMED = {"room": "sensor", "bypass": "flow"}
"""Kind in the words of a diagnosis, where it differs."""
_STEP_K, _SHARE = 0.5, 0.05


@dataclass(frozen=True)
class Hypothesis:
    """Possible place of an effect: its kind (of `KINDS`) and its place in the words of a diagnosis."""

    kind: str
    where: str

    @property
    def named(self) -> str:
        """Return the kind in the words of a diagnosis."""
        return NAMED.get(self.kind, self.kind)

    @property
    def unit(self) -> str:
        """Return the unit of its size."""
        return UNITS.get(self.kind, "1")


@dataclass(frozen=True)
class Figures:
    """Figures of K windows of one record, N nodes and H hypotheses.

    Attributes
    ----------
    end_s
        End of each window (K,), s of the record.
    power
        Power at each node that the twin lacks (K, N), W.
    direction
        Power at each node that each hypothesis adds at size 1 (K, H, N).
    kick
        Further energy at each node when a hypothesis begins at size 1 (H, N), J: a step of a reading.
    levels
        Inputs, averaged over each window (K, c).
    rates
        Change of inputs and of node temperatures within a window (K, c + N), per `WINDOW_S`.
    valid
        Windows with enough samples (K,).
    """

    end_s: Array
    power: Array
    direction: Array
    kick: Array
    levels: Array
    rates: Array
    valid: np.ndarray


class Balance:
    """Energy balance of one twin; raises HieraError for a twin with a node without a thermometer.

    Attributes
    ----------
    hypotheses
        Places and kinds of effects, in the order of every array.
    """

    def __init__(self, network: Network) -> None:
        self.network = network
        self._formulas = Formulas(network)
        self._capacity = network.values[network.index([f"{n}.capacitance" for n in network.nodes])]
        self._sensors = [
            (j, s.name, network.nodes.index(s.node)) for j, s in enumerate(network.instruments) if isinstance(s, Sensor)
        ]
        self._readings = [[j for j, _, k in self._sensors if k == node] for node in range(len(network.nodes))]
        without = [n for n, mine in zip(network.nodes, self._readings, strict=True) if not mine]
        if without:
            raise HieraError(
                f"twin {network.name!r} has no thermometer at {', '.join(without)}; the network of effects needs "
                "one at each node",
                code="OTHER_TWIN",
            )
        self._room = network.input_columns.index(network.room) if network.room else None
        self._heaters = [
            j for j, c in enumerate(network.input_columns) if network.inputs[c].unit == "W" or c.endswith("_W")
        ]
        self._changes = self._parameter_changes()
        self.hypotheses = tuple(self._named())

    def _parameter_changes(self) -> list[tuple[str, str, str]]:
        """Return kind, place and parameter of each hypothesis that changes a parameter by a share."""
        found: list[tuple[str, str, str]] = []
        ids = set(self.network.ids)
        for element in self.network.elements:
            if isinstance(element, Flow):
                found.append(("flow", "loop", f"{element.name}.factor"))
                found += [
                    ("bypass", node, name)
                    for node in self.network.nodes
                    if (name := f"{element.name}.effectiveness_{node}") in ids
                ]
            for name, kind in (("UA_100", "heat_rejection"), ("resistance", "coupling")):
                if f"{element.name}.{name}" in ids and element.nodes():
                    found.append((kind, element.nodes()[0], f"{element.name}.{name}"))
        return found

    def _named(self) -> list[Hypothesis]:
        nodes = self.network.nodes
        found = [Hypothesis(kind, node) for kind in ("heat_source", "heat_loss", "thermal_mass") for node in nodes]
        found += [Hypothesis("sensor", name) for _, name, _ in self._sensors]
        found += [Hypothesis("room", self.network.room)] if self.network.room else []
        found += [Hypothesis(kind, where) for kind, where, _ in self._changes]
        return found + [Hypothesis("actuator", self.network.input_columns[j].rsplit("_", 1)[0]) for j in self._heaters]

    def figures(self, time_s: Array, inputs: Array, measured: Array, begin_s: float | None = None) -> Figures:
        """Return the figures of a record's windows; each depends on the samples before its end alone.

        Parameters
        ----------
        time_s
            Time of the samples (n,), s, increasing.
        inputs, measured
            Inputs (n, c) and readings (n, m), degC, in the network's order; NaN where missing.
        begin_s
            Begin of the first window, at most the first time; that by default.

        Raises
        ------
        HieraError
            The record is shorter than a window.
        """
        begin = float(time_s[0]) if begin_s is None else begin_s
        t, u, y, seen = _on_grid(time_s, inputs, measured, begin)
        starts = np.arange(begin, time_s[-1] - WINDOW_S + 1e-6, EVERY_S)
        if not len(starts):
            raise HieraError(f"the record has {time_s[-1] - time_s[0]:g} s; give at least {WINDOW_S:g} s")
        temperature = np.stack([y[:, mine].mean(axis=1) for mine in self._readings], axis=1)
        average, rate, share = _windowed(t, seen, starts, self._columns(t, u, temperature))
        k, n, c = len(starts), len(self.network.nodes), u.shape[1]
        tilt = rate[:, :n]
        heat, rest = average[:, n : 2 * n], average[:, 2 * n : -c]
        moved = rest.reshape(k, -1, n)
        room = average[:, [-c + self._room]] if self._room is not None else 0.0
        excess = average[:, :n] - room
        eye = np.eye(n)
        direction = np.concatenate(
            [np.broadcast_to(eye, (k, n, n)), -eye * excess[:, :, None], -eye * tilt[:, :, None], moved], axis=1
        )
        kick = np.zeros((len(self.hypotheses), n))
        for h, (_, _, node) in enumerate(self._sensors):
            kick[3 * n + h, node] = self._capacity[node]
        return Figures(
            starts + WINDOW_S,
            self._capacity * tilt - heat,
            direction,
            kick,
            average[:, -c:],
            WINDOW_S * np.concatenate([rate[:, -c:], tilt], axis=1),
            share >= 1.0 - MOST_MISSING,
        )

    def _columns(self, t: Array, u: Array, temperature: Array) -> Array:
        """Return temperatures, heats, changes of the heats by each hypothesis, and inputs, side by side."""
        step = float(t[1] - t[0])
        values = self.network.values

        def heats(at: Array = temperature, inputs: Array = u, parameters: Array = values) -> Array:
            return self._formulas.heats(at, inputs, parameters, step)

        base = heats()
        found = [temperature, base]
        for _, _, node in self._sensors:
            moved = temperature.copy()
            moved[:, node] += _STEP_K
            found.append((base - heats(moved)) / _STEP_K)
        if self._room is not None:
            inputs = u.copy()
            inputs[:, self._room] += _STEP_K
            found.append((base - heats(inputs=inputs)) / _STEP_K)
        for _, _, name in self._changes:
            k = int(self.network.index([name])[0])
            parameters = values.copy()
            parameters[k] *= 1.0 - _SHARE
            found.append((base - heats(parameters=parameters)) / _SHARE)
        for j in self._heaters:
            inputs = u.copy()
            inputs[:, j] *= 1.0 + _SHARE
            found.append((heats(inputs=inputs) - base) / _SHARE)
        return np.concatenate([*found, u], axis=1)


def _on_grid(time_s: Array, inputs: Array, measured: Array, begin: float) -> tuple[Array, Array, Array, Array]:
    """Return times (g,), inputs, readings on an even grid, and the share of finite samples (g,); gaps hold the last."""
    period = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 1.0
    step = max(int(GRID_S / period), 1) * period
    place = np.floor((time_s - begin) / step + 1e-6).astype(np.intp)
    count = int(place[-1]) + 1
    both = np.concatenate([inputs, measured], axis=1)
    finite = np.isfinite(both)
    number = np.stack([np.bincount(place, finite[:, j], count) for j in range(both.shape[1])], axis=1)
    total = np.stack(
        [np.bincount(place, np.where(finite[:, j], both[:, j], 0.0), count) for j in range(both.shape[1])], axis=1
    )
    mean = np.where(number > 0, total / np.maximum(number, 1), np.nan)
    seen = (number > 0).mean(axis=1)
    for j in range(mean.shape[1]):
        mean[:, j] = _held(mean[:, j])
    c = inputs.shape[1]
    t = np.asarray(begin + (np.arange(count) + 0.5) * step, dtype=np.float64)
    return t, mean[:, :c], mean[:, c:], seen


def _held(values: Array) -> Array:
    bad = ~np.isfinite(values)
    if not bad.any():
        return values
    last = np.maximum.accumulate(np.where(bad, -1, np.arange(len(values))))
    first = values[~bad][0] if (~bad).any() else 0.0
    return np.where(last >= 0, values[np.maximum(last, 0)], first)


def _windowed(t: Array, seen: Array, starts: Array, columns: Array) -> tuple[Array, Array, Array]:
    """Return weighted averages and rates of columns (K, q), and the share of samples that were there (K,)."""
    average, rate, share = [], [], []
    for start in starts:
        a, b = np.searchsorted(t, (start, start + WINDOW_S))
        angle = np.pi * (t[a:b] - start) / WINDOW_S
        weight = np.sin(angle) ** 2
        slope = np.pi / WINDOW_S * np.sin(2.0 * angle)
        total = weight.sum()
        average.append(weight @ columns[a:b] / total)
        rate.append(-(slope - slope.mean()) @ columns[a:b] / total)
        share.append(seen[a:b].mean())
    return np.array(average), np.array(rate), np.array(share)
