"""Trained network of effects on disk: weights as safetensors, a card in JSON with threshold, intervals and origin."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from twin.calibrators.hiera_unet.effects.balance import EVERY_S, KINDS, WINDOW_S, Hypothesis
from twin.calibrators.hiera_unet.effects.courses import Course, place_sums
from twin.calibrators.hiera_unet.effects.memory import LAGS
from twin.calibrators.hiera_unet.effects.network import LEAST_SCALE, EffectsConfig, EffectsNetwork
from twin.calibrators.hiera_unet.effects.scores import Scores
from twin.calibrators.hiera_unet.effects.tokens import WIDTH, tokens
from twin.calibrators.hiera_unet.model.config import HieraError
from twin.network import Array
from twin.regular_file import MOST_WEIGHTS, read_regular

SUBJECT = "effects"
FORMAT = 1
TABLE = {"windows_s": [WINDOW_S, EVERY_S], "onsets": list(LAGS), "kinds": list(KINDS), "width": WIDTH}
"""Table of the tokens; weights of another table are refused."""
FACTOR = 2.3
"""90 % interval of Laplace's distribution over its scale, before calibration."""


@dataclass(frozen=True)
class EffectsMember:
    """Trained network with its calibration.

    Attributes
    ----------
    threshold
        Statistic of a course above which there is a warning.
    since_factor, size_factor
        Half widths of the 90 % intervals over the network's own scales.
    card
        All other content of the card, plain data.
    """

    network: EffectsNetwork
    threshold: float = 0.0
    since_factor: float = FACTOR
    size_factor: float = FACTOR
    card: Mapping[str, Any] = field(default_factory=dict)

    def course(self, scores: Scores, hypotheses: Sequence[Hypothesis]) -> Course:
        """Return the course of the warning over all windows of a record."""
        with torch.inference_mode():
            one = torch.from_numpy(tokens(scores, hypotheses))[None]
            answers = self.network(one, torch.ones(1, len(hypotheses), dtype=torch.bool))
        odds = answers.log_odds[0].double().numpy()
        # Odds of a place are the sum over the kinds there.
        top = odds.max(axis=1, keepdims=True)
        sums, places = place_sums(np.exp(odds - top), hypotheses)
        best = sums.argmax(axis=1)
        rows = np.arange(len(odds))
        there = np.array([[h.where == place for h in hypotheses] for place in places])[best]
        named = np.where(there, odds, -np.inf).argmax(axis=1)
        pick = (rows, named)
        weight = answers.weight[0].double().numpy()[pick]
        error = np.sqrt(scores.past[:, None] / scores.information[pick])
        size = (weight * scores.size[pick]).sum(axis=1)
        spread = (weight * error).sum(axis=1) + 0.02 * np.abs(size)
        reach = self.size_factor * spread * _scale(answers.size_scale[0].double().numpy()[pick])
        since = answers.since[0].double().numpy()[pick]
        wide = self.since_factor * _scale(answers.since_scale[0].double().numpy()[pick])
        return Course(
            top[:, 0] + np.log(sums[rows, best]),
            named,
            size,
            size - reach,
            size + reach,
            EVERY_S * np.exp(since),
            EVERY_S * np.exp(since - wide),
            EVERY_S * np.exp(since + wide),
        )


def _scale(log_scale: Array) -> Array:
    found: Array = np.exp(np.clip(log_scale, LEAST_SCALE, 8.0))
    return found


def save_effects(member: EffectsMember, path: Path) -> Path:
    """Write `path` (.safetensors) and its card (.json) beside it; return the path of the card."""
    path.parent.mkdir(parents=True, exist_ok=True)
    save_file({k: v.detach().cpu().contiguous() for k, v in member.network.state_dict().items()}, path)
    document = {
        "subject": SUBJECT,
        "format": FORMAT,
        "table": TABLE,
        "config": member.network.config.document(),
        "weights": {"sha256": _digest(path), "count": member.network.count()},
        "threshold": member.threshold,
        "since_factor": member.since_factor,
        "size_factor": member.size_factor,
        **member.card,
    }
    card = path.with_suffix(".json")
    card.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return card


def load_effects(path: Path) -> EffectsMember:
    """Return the network of `path` (.safetensors).

    Raises
    ------
    HieraError
        A file is missing or damaged, or the network is of another subject, format or table.
    """
    card = path.with_suffix(".json")
    train = "train it with `hil bench effects --train`"
    try:
        document: dict[str, Any] = dict(json.loads(read_regular(card)))
    except FileNotFoundError as error:
        raise HieraError(f"there is no model card {card}; {train}", code="MISSING_MEMBER") from error
    except (OSError, ValueError, TypeError, RecursionError) as error:
        raise HieraError(f"model card {card} cannot be read ({error}); {train}") from error
    if document.get("subject") != SUBJECT:
        raise HieraError(
            f"model card {card} is not of a network of effects; give one that `hil bench effects --train` wrote",
            code="OTHER_SUBJECT",
        )
    if document.get("format") != FORMAT:
        raise HieraError(
            f"model card {card} has format {document.get('format')}, not {FORMAT}; {train}", code="OTHER_FORMAT"
        )
    if document.get("table") != TABLE:
        raise HieraError(
            f"the weights of model card {card} were trained with other tokens; {train}", code="OTHER_TABLE"
        )
    try:
        network = EffectsNetwork(EffectsConfig(**document["config"]))
        if _digest(path) != document["weights"]["sha256"]:
            raise HieraError(
                f"the weights {path} are not those of model card {card}: their checksum differs; {train}",
                code="OTHER_MEMBER",
            )
        network.load_state_dict(load_file(path))
        threshold, since, size = (float(document[name]) for name in ("threshold", "since_factor", "size_factor"))
    except HieraError:
        raise
    except FileNotFoundError as error:
        raise HieraError(f"the weights {path} are missing; put them beside {card}", code="MISSING_MEMBER") from error
    except (OSError, SafetensorError, RuntimeError, KeyError, TypeError, ValueError) as error:
        raise HieraError(f"the weights {path} do not fit model card {card} ({error}); {train}") from error
    return EffectsMember(network.eval(), threshold, since, size, document)


def _digest(path: Path) -> str:
    return hashlib.sha256(read_regular(path, MOST_WEIGHTS)).hexdigest()
