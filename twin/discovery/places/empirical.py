"""Empirical curve in place of a cause: heat at a place as a function of one known variable, offered but never adopted
silently.

If no known effect explains a record, the missing heat at the likeliest node is fitted on the fitting segment, by linear
interpolation between knots of one variable (Kristensen, Madsen & Jorgensen, Comput. Chem. Eng. 28 (2004) 1431, steps b
to d). It is offered only if it improves the free run on the held-out segment.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.discovery.diagnosis import Course, SensorError
from twin.discovery.records.grid import Grid, centred
from twin.elements.candidates import free_name
from twin.elements.empirical_heat import FARTHEST_KNOT, KNOTS, MOST_HEAT_W
from twin.kernel import Kernel
from twin.network import Array, Network
from twin.revisions import with_elements
from twin.segments import simulate_segments

if TYPE_CHECKING:
    from twin.discovery.evidence.finding import Finding
    from twin.discovery.healthy.basis import Basis

BETTER = 0.8
"""Share of the re-tuned twin's squared held-out error below which a curve is offered."""
_LEAST_SPREAD = 0.02
"""Spread of a variable, over its largest value, below which no curve over it is identifiable."""


@dataclass(frozen=True)
class Empirical:
    """Curve on offer: heat `heats` (5,) W at `node` at the `knots` (5,) of `variable`.

    `network` is the twin with it; `errors`: sensor -> RMSE in K of ten-second means over the held-out segment, re-tuned
    alone and with the curve.
    """

    node: str
    variable: str
    knots: tuple[float, ...]
    heats: tuple[float, ...]
    network: Network
    errors: Mapping[str, tuple[float, float]]
    says: str

    def document(self) -> dict[str, Any]:
        """Return its part of `diagnosis.json`."""
        return {
            "where": self.node,
            "follows": self.variable,
            "says": self.says,
            "curve": [[float(f"{x:.5g}"), float(f"{q:.4g}")] for x, q in zip(self.knots, self.heats, strict=True)],
            "held_out_K": {n: {"before": round(b, 4), "after": round(a, 4)} for n, (b, a) in self.errors.items()},
        }


@dataclass(frozen=True)
class TooMuchHeat:
    """Missing heat beyond any possible effect: the record contradicts the twin. `says` is a sentence for the user."""

    says: str


def offer(
    finding: Finding, known: Basis, grid: Grid, split: int, found: tuple[Course, ...], errors: dict[str, SensorError]
) -> Empirical | TooMuchHeat | None:
    """Return the best curve of the missing heat at the likeliest node; None if none improves the held-out segment.

    Args:
        grid: the whole record, held out from bin `split` on. errors: of the twin re-tuned alone.
    """
    if not found or found[0].signature != "energy":
        return None
    network, score_test = known.probe.network, finding.score_test
    node = next((c.site for c in found if c.site in network.nodes), "")
    if not node:
        return None
    k = network.nodes.index(node)
    best: tuple[float, str, Array, Array, Array] | None = None
    for name, values in _variables(network, grid, node).items():
        blocks = score_test.block_means(values[: score_test.edges[-1]])
        low, high = float(np.nanmin(blocks)), float(np.nanmax(blocks))
        if not high - low > _LEAST_SPREAD * max(abs(low), abs(high), 1e-9):
            continue
        knots = np.linspace(low, high, KNOTS)
        vectors = np.zeros((KNOTS, score_test.sites, score_test.b))
        vectors[:, k] = _hats(np.nan_to_num(blocks, nan=low), knots)
        fitted = score_test.estimate(vectors)
        score = fitted.gain - KNOTS * math.log(score_test.count)
        if best is None or score > best[0]:
            best = (score, name, knots, fitted.sizes, score_test.moved(vectors, fitted.sizes))
    if best is None or best[0] <= 0.0:
        return None
    _, name, knots, heats, moved = best
    most = float(np.abs(heats).max())
    if most > MOST_HEAT_W:
        at_node = (network.sensor_columns[sensor.name] for sensor in network.sensors if sensor.node == name)
        named = ", ".join(next(at_node, (name,)))
        return TooMuchHeat(
            f"the record contradicts the twin beyond what any effect can hold: as a curve of {name}, {most:.3g} W are "
            f"missing at {node}, and an effect holds {MOST_HEAT_W:g} W at most; is {named} in the unit of its name?"
        )
    if np.abs(knots).max() > FARTHEST_KNOT:
        return None
    bigger = _with_curve(network, known, node, name, knots, heats, moved)
    state = known.probe.first_state(grid)
    state[: len(finding.state)] = finding.state + moved[known.probe.q :]
    run = simulate_segments(Kernel(bigger, ()), bigger.values[None], state[None], grid.time, grid.inputs, grid.begins)
    read = centred(run[0], grid.centre)
    late = grid.measured[split:] - read[split:]
    after = np.sqrt(np.nansum(late**2, axis=0) / np.maximum(np.isfinite(late).sum(axis=0), 1))
    pairs = {n: (errors[n].means[1], float(after[j])) for j, n in enumerate(network.sensor_names) if n in errors}
    sigma = dict(zip(network.sensor_names, network.sigma.tolist(), strict=True))
    before_all = sum((b / sigma[n]) ** 2 for n, (b, _) in pairs.items())
    after_all = sum((a / sigma[n]) ** 2 for n, (_, a) in pairs.items())
    if not after_all < BETTER * before_all:
        return None
    worst = max(pairs, key=lambda n: pairs[n][0] / sigma[n])
    says = (
        f"as a curve of {name} the heat at {node} ({heats.min():.3g} to {heats.max():.3g} W) brings {worst} from "
        f"{pairs[worst][0]:.2g} K, re-tuned, to {pairs[worst][1]:.2g} K on the held-out segment"
    )
    return Empirical(node, name, tuple(knots.tolist()), tuple(heats.tolist()), bigger, pairs, says)


def _variables(network: Network, grid: Grid, node: str) -> dict[str, Array]:
    """Return the variables (n,) that the heat may follow: every input, and the node's own temperature if it is
    measured.
    """
    out = {column: grid.inputs[:, j] for j, column in enumerate(network.input_columns)}
    for j, sensor in enumerate(network.sensors):
        if sensor.node == node:
            out[node] = grid.measured[:, j]
    return out


def _hats(values: Array, knots: Array) -> Array:
    """Return the weights (knots, b) of linear interpolation between knots."""
    return np.stack([np.interp(values, knots, row) for row in np.eye(len(knots))])


def _with_curve(
    network: Network, known: Basis, node: str, variable: str, knots: Array, heats: Array, moved: Array
) -> Network:
    place = {"of": variable} if variable in network.nodes else {"driver": variable}
    numbers = {f"x_{i + 1}": float(x) for i, x in enumerate(knots)} | {
        f"q_{i + 1}": float(q) for i, q in enumerate(heats)
    }
    table = {"kind": "empirical_heat", "node": node, **place, **{n: {"value": v} for n, v in numbers.items()}}
    scaling = known.probe.scaling
    z = scaling.to_z(network.values[scaling.index]) + moved[: known.probe.q]
    values = np.clip(scaling.to_values(z), scaling.lower, scaling.upper)
    own = {i: float(v) for i, v in zip(scaling.ids, values, strict=True) if not network.parameters[i].same_as}
    name = free_name(f"unexplained_at_{node}", network.elements)
    return with_elements(network.with_values(own), {name: table})
