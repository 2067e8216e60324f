"""Equations of a network for tools that need functions: affine coefficients, right sides over arrays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from twin import Array, Network
from twin.kernel.generated_code import define_functions
from twin.network.reference_source import python_source

Rhs = Callable[[Any, Any, Any], list[Any]]


def right_side_of(network: Network, exp: Callable[..., Any], log: Callable[..., Any], largest: Any) -> Rhs:
    """Return ``rhs(T, u, p) -> dT/dt`` with the given functions in place of math's, for arrays, tensors and tracers."""
    given = {"exp": exp, "log": log, "max": largest}
    rhs: Rhs = define_functions(python_source(network), f"<right side of {network.name}>", given)["rhs"]
    return rhs


def vector_of(network: Network, ids: tuple[str, ...], particles: Any) -> list[Any]:
    """Return the parameters of a right side: numbers that all particles share, columns (P,) for `ids`."""
    vector: list[Any] = network.values.tolist()
    for i in network.index(ids):
        vector[int(i)] = particles[:, int(i)]
    return vector


def affine(network: Network, ids: tuple[str, ...], particles: Array, inputs: Array) -> tuple[Array, Array]:
    """Return A (P, k, k) in 1/s and b (P, k) in K/s of dT/dt = A T + b, at one row of inputs (c,)."""
    rhs = right_side_of(network, np.exp, np.log, np.maximum)
    vector, k, count = vector_of(network, ids, particles), len(network.nodes), len(particles)

    def at(temperatures: Array) -> Array:
        return np.stack([np.broadcast_to(np.asarray(x), count) for x in rhs(temperatures, inputs, vector)], axis=1)

    b = at(np.zeros(k))
    return np.stack([at(row) - b for row in np.eye(k)], axis=2), b


def runs(inputs: Array) -> list[tuple[int, int]]:
    """Return segments [first, stop) of sample intervals with constant inputs (n, c); they end at n - 1."""
    changes = np.flatnonzero((np.diff(inputs, axis=0) != 0.0).any(axis=1)) + 1
    edges = [0, *(int(i) for i in changes if i < len(inputs) - 1), len(inputs) - 1]
    return list(zip(edges[:-1], edges[1:], strict=True))


def sensor_rows(network: Network) -> list[int]:
    """Return the node that each sensor reads; the peers have no other kind of sensor."""
    return [network.nodes.index(s.node) for s in network.sensors]
