"""Terms of a training's loss: their shares, and their gradients in the encoder and in the two heads."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

PLACES = ("encoder", "parameter_head", "output_head")


@dataclass(frozen=True)
class LossTerm:
    """Weighted term of a loss: its value, its share of the sum of all absolute values, and its gradient's norm in the
    encoder, in the parameter head and in the output head.
    """

    name: str
    value: float
    share: float
    gradients: tuple[float, ...]


def weighed(network: Any, batches: Iterable[Mapping[str, Any]]) -> list[LossTerm]:
    """Return the terms of a loss, each the mean over batches.

    Parameters
    ----------
    network
        Network with `encoder`, `parameter_head` and `output_head`.
    batches
        Weighted terms of each batch by name, which depend on the network's weights.
    """
    values: dict[str, list[float]] = {}
    norms: dict[str, list[list[float]]] = {}
    for terms in batches:
        for name, term in terms.items():
            values.setdefault(name, []).append(float(term.detach()))
            network.zero_grad(set_to_none=True)
            if term.requires_grad:
                term.backward(retain_graph=True)
            norms.setdefault(name, []).append([_norm(getattr(network, place)) for place in PLACES])
    network.zero_grad(set_to_none=True)
    sizes = {name: abs(float(np.mean(v))) for name, v in values.items()}
    total = max(sum(sizes.values()), 1e-30)
    return [
        LossTerm(name, float(np.mean(v)), sizes[name] / total, tuple(np.mean(norms[name], axis=0).tolist()))
        for name, v in values.items()
    ]


def _norm(module: Any) -> float:
    return float(sum(float((p.grad**2).sum()) for p in module.parameters() if p.grad is not None) ** 0.5)


def share_of(terms: Iterable[LossTerm], names: Iterable[str]) -> float:
    """Return the summed share of the named terms."""
    wanted = set(names)
    return sum(term.share for term in terms if term.name in wanted)


def gradient_of(terms: Iterable[LossTerm], names: Iterable[str], place: str = "encoder") -> float:
    """Return the summed gradient norms of the named terms at a place."""
    wanted = set(names)
    return sum(term.gradients[PLACES.index(place)] for term in terms if term.name in wanted)
