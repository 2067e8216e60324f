"""Nominal figures of a rig from its commissioned twin, which make channels dimensionless, and the static tokens."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from twin.calibrators.hiera_unet.data.parameters import rated_power
from twin.elements.flow import WATER_DENSITY, Flow
from twin.network import Array, Network

USUAL_RISE_K, USUAL_CAPACITY_RATE = 10.0, 250.0
ROOM_C = 20.0


@dataclass(frozen=True)
class Figures:
    """Nominal figures of a commissioned twin.

    Attributes:
        power_W: rated. flow_L_per_min, capacity_rate_W_per_K: at full speed. drop_K: rated power over the latter.
        rejection_W_per_K, loss_W_per_K: at full speed, and to the room in addition. rise_K: rated power over both.
        room, room_C: input with the room's temperature, and its nominal value. noise_K: of one thermometer.
        capacity_J_per_K: (k,) of the nodes. sensor_of: (k,) first sensor of each node, -1 without one.
    """

    power_W: float
    flow_L_per_min: float
    capacity_rate_W_per_K: float
    rejection_W_per_K: float
    loss_W_per_K: float
    room: str
    room_C: float
    noise_K: float
    capacity_J_per_K: Array
    sensor_of: tuple[int, ...]

    @property
    def drop_K(self) -> float:
        return self.power_W / self.capacity_rate_W_per_K

    @property
    def rise_K(self) -> float:
        out = self.rejection_W_per_K + self.loss_W_per_K
        return self.power_W / out if out > 0.0 else USUAL_RISE_K

    @classmethod
    def of(cls, network: Network, values: Array | None = None) -> Figures:
        """Return the figures of a twin with the full vector `values` (p,), its own by default."""
        full = network.values if values is None else values
        at = dict(zip(network.ids, full.tolist(), strict=True))
        flow = next((e for e in network.elements if isinstance(e, Flow)), None)
        litres = at[f"{flow.name}.nominal"] * at[f"{flow.name}.factor"] if flow else 0.0
        rate = litres / 60.0 * WATER_DENSITY * at[f"{flow.name}.cp"] if flow else USUAL_CAPACITY_RATE
        room = next((c for c in network.input_columns if c.startswith("T_amb")), "")
        read = [s.node for s in network.sensors]
        return cls(
            power_W=rated_power(network),
            flow_L_per_min=litres or 1.0,
            capacity_rate_W_per_K=max(rate, 1e-3),
            rejection_W_per_K=sum(v for name, v in at.items() if name.endswith(".UA_100")),
            loss_W_per_K=sum(v for name, v in at.items() if name.endswith(".hA")),
            room=room,
            room_C=network.inputs[room].nominal if room else ROOM_C,
            noise_K=float(np.median([at[f"{s.name}.sigma"] for s in network.sensors])),
            capacity_J_per_K=np.array([at[f"{node}.capacitance"] for node in network.nodes]),
            sensor_of=tuple(read.index(node) if node in read else -1 for node in network.nodes),
        )

    def token(self, network: Network, what: tuple[str, ...]) -> float:
        """Return one static token: a dimensionless figure on a logarithmic scale."""
        name, *of = what
        return float(_TOKENS[name](self, network, *of))


def _time_constant(f: Figures, network: Network, node: str) -> float:
    seconds = f.capacity_J_per_K[network.nodes.index(node)] / f.capacity_rate_W_per_K
    return 0.5 * float(np.log(max(seconds, 1e-3) / 60.0))


_TOKENS: dict[str, Callable[..., float]] = {
    "power_over_flow": lambda f, _: float(np.log(f.drop_K / 2.7)),
    "rejection_over_flow": lambda f, _: float(np.log(max(f.rejection_W_per_K, 1e-3) / f.capacity_rate_W_per_K / 0.23)),
    "loss_over_flow": lambda f, _: 0.5 * float(np.log(max(f.loss_W_per_K, 1e-2) / f.capacity_rate_W_per_K / 0.02)),
    "time_constant": _time_constant,
}
