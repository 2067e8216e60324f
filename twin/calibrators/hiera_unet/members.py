"""A trained ensemble as it is loaded for service."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from twin.calibrators.hiera_unet.checkpoint import Identity, Member, load
from twin.calibrators.hiera_unet.config import HieraError
from twin.calibrators.hiera_unet.conformal import Factors
from twin.calibrators.hiera_unet.ensemble import mixed
from twin.calibrators.hiera_unet.envelope import place
from twin.calibrators.hiera_unet.gates import LEAKS
from twin.calibrators.hiera_unet.leakage import leakage
from twin.calibrators.hiera_unet.windows import Windows
from twin.network import Array

FORMAT = 1
MODE = "online"
LEAST = 2
"""Members: one alone has nobody to differ from, and its intervals lack that part."""

AGAIN = "have `hil train loop` write it again, with the command of one of its members"


@dataclass(frozen=True)
class Said:
    """What an ensemble says of one window on its causal branch.

    Attributes:
        theta, theta_sd: (P,) deviations and standard deviations, aleatoric and epistemic together.
        delta, scale: (120, Y) corrections, and Laplace scales of the members' mixture, K.
        distance: from the training envelope, 1 at its limit, the mean over members. attention: (Q, 12) for audit.
    """

    theta: Array
    theta_sd: Array
    delta: Array
    scale: Array
    distance: float
    attention: Array


@dataclass(frozen=True)
class Ensemble:
    """Members and their conformal factors: `factors` of outputs, `parameters` (P,) with NaN where not known."""

    name: str
    members: tuple[Member, ...]
    factors: Factors
    parameters: Array
    card: dict[str, Any]

    def ask(self, window: Windows) -> Said:
        """About one window (N = 1), on the causal branch with everything measured in sight."""
        thetas, variances, deltas, scales, distances, attention = [], [], [], [], [], []
        where = place(window.x, window.m)
        with torch.inference_mode():
            for member in self.members:
                config = member.network.config
                p = member.network(*_tensors(window), causal=True)
                bounds, tolerances = np.array(config.bounds), np.array(config.tolerances)
                thetas.append(p.theta[0].double().numpy())
                variances.append(np.exp(p.log_variance[0].clamp(-12, 6).double().numpy()) * bounds**2)
                deltas.append(p.delta[0].double().numpy())
                scales.append(np.exp(p.log_scale[0].clamp(-6, 6).double().numpy()) * tolerances)
                distances.append(float(member.envelope.distance(where)[0]))
                attention.append(p.attention[0].double().numpy())
        theta, theta_variance = mixed(thetas, variances)
        delta, variance = mixed(deltas, [2.0 * s**2 for s in scales])
        return Said(
            theta, np.sqrt(theta_variance), delta, np.sqrt(variance / 2.0), float(np.mean(distances)),
            np.mean(attention, axis=0),
        )  # fmt: skip

    def half_widths(self, said: Said, regime: int) -> Array:
        """Half widths (120, Y), K, of the outputs' intervals."""
        return np.asarray(self.factors.of(np.array([regime]))[0] * said.scale)

    def leakage(self, window: Windows) -> float:
        """How far deviations hang on the last moments of a window: the worst member's."""
        return max(leakage(m.network, *_tensors(window)) for m in self.members)


def load_ensemble(card: Path, identity: Identity) -> Ensemble:
    """The ensemble of a card, for the twin and table that `identity` names.

    Raises:
        HieraError: there is none, or too few members; its factors are not one for each output and parameter; a member
            is missing or altered, belongs elsewhere or is of another configuration, or its parameters leak.
    """
    try:
        document: dict[str, Any] = dict(json.loads(card.read_text(encoding="utf-8")))
        if document.get("format") != FORMAT:
            raise HieraError(f"the card {card} has format {document.get('format')}, not {FORMAT}; {AGAIN}")
        names: dict[str, str] = dict(document["members"])
        own = document["modes"][MODE]
        factors = Factors.read(own["outputs"])
        parameters = np.array([np.nan if f is None else f for f in own["parameters"]], dtype=np.float64)
    except FileNotFoundError as error:
        raise HieraError(
            f"there is no trained network {card}; train one with `hil train loop` and name its card with --network, or "
            "choose another calibrator"
        ) from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise HieraError(f"the card {card} cannot be read ({error}); {AGAIN}") from error
    outside = [name for name in names if Path(name).name != name]
    if outside:
        raise HieraError(f"the card {card} names {outside[0]}, which does not lie beside it; train again")
    if len(names) < LEAST:
        raise HieraError(
            f"the card {card} names {len(names)} trained member{'s' * (len(names) != 1)}, and an ensemble has at least "
            f"{LEAST}; train more with `hil train loop` and other seeds"
        )
    members = tuple(load(card.parent / name, identity) for name in names)
    for (name, digest), member in zip(names.items(), members, strict=True):
        if member.card["weights"]["sha256"] != digest:
            raise HieraError(f"the member {name} is not the one that {card} names; train again")
        if not float(member.card.get("leakage", np.inf)) <= LEAKS:
            raise HieraError(f"the member {name} is disqualified: its parameters hang on a record's last moments")
        if member.network.config != members[0].network.config:
            raise HieraError(
                f"the card {card} names members of two configurations, {members[0].network.config.name!r} and, in "
                f"{name}, {member.network.config.name!r}; {AGAIN}"
            )
    _check_factors(card, factors, parameters, identity)
    return Ensemble(str(document["name"]), members, factors, parameters, document)


def _check_factors(card: Path, factors: Factors, parameters: Array, identity: Identity) -> None:
    """Raises HieraError: not one positive factor for each output, overall and in every bin, and for each parameter."""
    outputs = {"outputs": factors.overall} | {f"outputs in bin {b}": own for b, own in factors.binned.items()}
    for what, own in outputs.items():
        if len(own) != len(identity.outputs) or not all(np.isfinite(f) and f > 0.0 for f in own):
            raise HieraError(
                f"the card {card} has the factors {', '.join(map(str, own))} for {what}, not a positive one for each "
                f"of {', '.join(identity.outputs)}; {AGAIN}"
            )
    if len(parameters) != len(identity.parameters) or (np.isinf(parameters) | (parameters <= 0.0)).any():
        raise HieraError(
            f"the card {card} has {len(parameters)} factors for parameters, not a positive one or null for each of "
            f"{', '.join(identity.parameters)}; {AGAIN}"
        )


def _tensors(w: Windows) -> tuple[torch.Tensor, ...]:
    single = (torch.from_numpy(np.ascontiguousarray(a)) for a in (w.x, w.m, w.regime, w.clock, w.meta))
    return tuple(single)
