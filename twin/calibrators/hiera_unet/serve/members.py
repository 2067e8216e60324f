"""Trained ensemble loaded for service."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from twin.calibrators.hiera_unet.data.windows import Windows
from twin.calibrators.hiera_unet.model.config import Config, HieraError
from twin.calibrators.hiera_unet.model.heads import evidence_of
from twin.calibrators.hiera_unet.serve.gates import LEAKS
from twin.calibrators.hiera_unet.weights.checkpoint import Identity, Member, load
from twin.calibrators.hiera_unet.weights.conformal import Factors, by_chance
from twin.calibrators.hiera_unet.weights.ensemble import mixed
from twin.calibrators.hiera_unet.weights.envelope import place
from twin.calibrators.hiera_unet.weights.leakage import leakage
from twin.network import Array
from twin.quantiles import NORMAL90
from twin.regular_file import read_regular

FORMAT = 2
"""Format of a card; 2: factors of parameters by their change probability."""
MODE = "online"
LEAST = 2
"""Least number of members: the intervals of one alone lack the epistemic part."""

AGAIN = "have `hil train loop` write it again, with the command of one of its members"


@dataclass(frozen=True)
class Said:
    """Prediction of an ensemble for one window on its causal branch.

    Attributes
    ----------
    theta, theta_sd
        (P,) deviations and standard deviations, aleatoric and epistemic together, calibrated.
    delta, scale
        (120, Y) corrections, and Laplace scales of the members' mixture, K.
    distance
        From the training envelope, 1 at its limit, the mean over members.
    attention
        (Q, 12) for audit.
    """

    theta: Array
    theta_sd: Array
    delta: Array
    scale: Array
    distance: float
    attention: Array


@dataclass(frozen=True)
class Ensemble:
    """Members and their conformal factors: `factors` of outputs, `parameters` by change probability, if known."""

    name: str
    members: tuple[Member, ...]
    factors: Factors
    parameters: Factors | None
    card: dict[str, Any]

    def ask(self, windows: Windows, *, corrected: int | None = None) -> tuple[Said, ...]:
        """Return the predictions for N windows, on the causal branch with all measurements visible.

        Parameters
        ----------
        corrected
            Number of windows, the first ones, with corrections and scales; None for all. Those of the others are empty
                (0, Y).
        """
        count = len(windows.x)
        wanted = count if corrected is None else corrected
        thetas, variances, deltas, scales, distances, attention = [], [], [], [], [], []
        where = place(windows.x, windows.m)
        with torch.inference_mode():
            for member in self.members:
                config = member.network.config
                p = member.network(*_tensors(windows), causal=True, corrected=wanted)
                bounds, tolerances = np.array(config.bounds), np.array(config.tolerances)
                thetas.append(p.theta.double().numpy())
                variances.append(np.exp(p.log_variance.clamp(-12, 6).double().numpy()) * bounds**2)
                deltas.append(p.delta.double().numpy())
                scales.append(np.exp(p.log_scale.clamp(-6, 6).double().numpy()) * tolerances)
                distances.append(member.envelope.distance(where))
                attention.append(p.attention.double().numpy())
        theta, theta_variance = mixed(thetas, variances)
        delta, variance = mixed(deltas, [2.0 * s**2 for s in scales])
        sd, scale = self.calibrated(np.sqrt(theta_variance), windows.meta), np.sqrt(variance / 2.0)
        distance, seen = np.mean(distances, axis=0), np.mean(attention, axis=0)
        none = np.zeros((0, *delta.shape[2:]))
        corrections = [(delta[k], scale[k]) if k < wanted else (none, none) for k in range(count)]
        return tuple(
            Said(theta[k], sd[k], corrections[k][0], corrections[k][1], float(distance[k]), seen[k])
            for k in range(count)
        )

    def calibrated(self, sd: Array, meta: np.ndarray) -> Array:
        """Return standard deviations (N, P) of deviations, `NORMAL90` of which cover 90 % on windows outside of
        training.

        Parameters
        ----------
        sd
            (N, P) of the members' mixture.
        meta
            (N, M), their static numbers.
        """
        if self.parameters is None:
            return sd
        bins = by_chance(chances(self.members[0].network.config, meta, sd.shape[1]))
        return np.asarray(sd * self.parameters.of(bins.reshape(-1)).reshape(sd.shape) / NORMAL90)

    def half_widths(self, said: Said, regime: int) -> Array:
        """Return the half widths (120, Y), K, of the outputs' intervals."""
        return np.asarray(self.factors.of(np.array([regime]))[0] * said.scale)

    def leakage(self, window: Windows) -> float:
        """Return the worst member's dependence of deviations on the noise of a window's last minutes."""
        return max(leakage(m.network, *_tensors(window)) for m in self.members)


def chances(config: Config, meta: np.ndarray, count: int) -> Array:
    """Return the change probabilities (N, P) among the static numbers (N, M); 0 for a network without evidence."""
    evident = evidence_of(config, torch.from_numpy(np.ascontiguousarray(meta)))
    return np.zeros((len(meta), count)) if evident is None else np.asarray(evident.chance.double().numpy())


def load_ensemble(card: Path, identity: Identity) -> Ensemble:
    """Return the ensemble of a card, for the twin and table that `identity` names.

    Raises
    ------
    HieraError
        There is none, or too few members; its factors are not one for each output, and one for parameters; a member is
            missing or altered, belongs elsewhere or is of another configuration, or its parameters leak.
    """
    try:
        document: dict[str, Any] = dict(json.loads(read_regular(card)))
        if document.get("format") != FORMAT:
            raise HieraError(f"the card {card} has format {document.get('format')}, not {FORMAT}; {AGAIN}")
        names: dict[str, str] = dict(document["members"])
        own = document["modes"][MODE]
        factors = Factors.read(own["outputs"])
        parameters = None if own["parameters"] is None else Factors.read(own["parameters"])
    except FileNotFoundError as error:
        raise HieraError(
            f"there is no trained network {card}; train one with `hil train loop` and name its card with --network, or "
            "choose another calibrator"
        ) from error
    except OSError as error:
        raise HieraError(f"the card {card} cannot be read ({error.strerror}); give the card of an ensemble") from error
    except (RecursionError, json.JSONDecodeError, UnicodeDecodeError) as error:
        raise HieraError(f"the card {card} cannot be read ({error}); {AGAIN}") from error
    except KeyError as error:
        raise HieraError(f"the card {card} has no {error}; {AGAIN}") from error
    except HieraError:
        raise
    except (ValueError, TypeError, AttributeError, OverflowError) as error:
        said = "its members or its factors are no tables, texts and numbers"
        raise HieraError(f"the card {card} cannot be read: {said}; {AGAIN}") from error
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


def _check_factors(card: Path, factors: Factors, parameters: Factors | None, identity: Identity) -> None:
    """Check that factors are positive, one for each output and one for parameters, overall and in every bin.

    Raises
    ------
    HieraError
        They are not.
    """
    wanted = {"outputs": (factors, identity.outputs), "parameters": (parameters, ("all parameters",))}
    for what, (found, names) in wanted.items():
        if found is None:
            continue
        everywhere = {what: found.overall} | {f"{what} in bin {b}": own for b, own in found.binned.items()}
        for where, own in everywhere.items():
            if len(own) != len(names) or not all(np.isfinite(f) and f > 0.0 for f in own):
                raise HieraError(
                    f"the card {card} has the factors {', '.join(map(str, own))} for {where}, not a positive one for "
                    f"{'each of ' * (len(names) > 1)}{', '.join(names)}; {AGAIN}"
                )


def _tensors(w: Windows) -> tuple[torch.Tensor, ...]:
    single = (torch.from_numpy(np.ascontiguousarray(a)) for a in (w.x, w.m, w.regime, w.clock, w.meta))
    return tuple(single)
