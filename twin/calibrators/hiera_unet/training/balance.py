"""Energy balance of the rig as a penalty on corrections: stored power and heat that leaves.

A twin's readings satisfy its balance exactly. Readings corrected by delta satisfy it only without a spurious power:
sum_i C_i d(delta_i)/dt + sum_j g_j delta_j = 0 with g_j the heat that leaves the rig per K of volume j.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twin.calibrators.hiera_unet.data.windows import Windows
from twin.elements.node import Node
from twin.kernel import Kernel
from twin.network import Array, Network
from twin.reference_simulation import right_hand_side

Balance = Callable[[Windows], tuple[Array, Array]]
"""Function from windows to the storage, J/K, and the loss to outside of the rig, W/K, of each output's volume; both (N,
Y)."""


def balance_of(network: Network) -> Balance | None:
    """Return the balance of a network whose volumes have no state but their temperature; None for others.

    A volume without a thermometer is left out, as are all but the first thermometer of one volume.
    """
    k = len(network.nodes)
    if Kernel(network, ()).size > k:
        return None
    rhs = right_hand_side(network)
    nodes = [e for e in network.elements if isinstance(e, Node)]
    capacity = network.index(tuple(f"{n.name}.capacitance" for n in nodes))
    place: list[int | None] = []
    for sensor in network.sensors:
        node = network.nodes.index(sensor.node)
        place.append(None if node in place else node)
    columns = [j for j, node in enumerate(place) if node is not None]
    rows = [node for node in place if node is not None]

    def balance(windows: Windows) -> tuple[Array, Array]:
        storage = np.zeros((len(windows), len(place)))
        exchange = np.zeros_like(storage)
        for i in range(len(windows)):
            p, state = windows.nominal[i], windows.state[i, :k]
            held = np.where(np.isfinite(windows.inputs[i]), windows.inputs[i], network.nominal_inputs)
            u, c = held.mean(0), p[capacity]
            here = np.array(rhs(state, u, p))
            slopes = np.column_stack([np.array(rhs(state + unit, u, p)) - here for unit in np.eye(k)])
            out = -(c[:, None] * slopes).sum(0)
            storage[i, columns], exchange[i, columns] = c[rows], out[rows]
        return storage, exchange

    return balance
