"""Trained network on disk: weights as safetensors, and a card in JSON with their identity and origin.

A card names the configuration, the structure of the twin and the channel table that the weights belong to; anything
else is refused before any computation.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from twin.calibrators.hiera_unet.model.config import Config, HieraError
from twin.calibrators.hiera_unet.model.network import HieraUNet
from twin.calibrators.hiera_unet.weights.envelope import Envelope
from twin.regular_file import MOST_WEIGHTS, read_regular

TOWER_CELL = "tower_cell"
"""`Identity.twin` of weights for cells of cooling towers, whose twins all have one structure."""
FORMAT = 3
"""Format of a checkpoint. 2: evidence holds the sparse posterior, and heads correct it. 3: each group's first block has
the common form, and half kernels have the oldest step first."""

EXACT = ("trees.", "middle", "spread")
"""Prefixes of constants that are no weights and keep 32 bits."""


@dataclass(frozen=True)
class Identity:
    """Identity of the twin and table that weights belong to.

    `twin`: digest of the twin's structure, independent of its values. `table`: of the channels. `parameters`,
    `outputs`: ids and sensors, in order.
    """

    twin: str
    table: str
    parameters: tuple[str, ...]
    outputs: tuple[str, ...]


@dataclass(frozen=True)
class Member:
    """Trained network with its identity and card.

    Attributes:
        card: all other content of the JSON file, as plain data: seed, data, curves, metrics, command.
    """

    network: HieraUNet
    identity: Identity
    envelope: Envelope
    card: dict[str, Any] = field(default_factory=dict)


def save(member: Member, path: Path, *, half: bool = True) -> Path:
    """Write `path` (.safetensors) and its card (.json) beside it; return the path of the card.

    Args:
        half: weights as 16-bit floats, half the size.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    kind = torch.float16 if half else torch.float32
    tensors = {
        f"network.{k}": v.detach().cpu().to(torch.float32 if k.startswith(EXACT) else kind).contiguous()
        for k, v in member.network.state_dict().items()
    }
    tensors["envelope.mean"] = torch.from_numpy(member.envelope.mean.astype(np.float32))
    tensors["envelope.precision"] = torch.from_numpy(member.envelope.precision.astype(np.float32))
    save_file(tensors, path)
    identity = member.identity
    document = {
        "format": FORMAT,
        "config": member.network.config.document(),
        "weights": {"sha256": _digest(path), "count": member.network.count(), "bits": 16 if half else 32},
        "twin": identity.twin,
        "table": identity.table,
        "parameters": list(identity.parameters),
        "outputs": list(identity.outputs),
        "envelope_limit": member.envelope.limit,
        **member.card,
    }
    card = path.with_suffix(".json")
    card.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return card


def load(path: Path, identity: Identity | None = None, config: Config | None = None) -> Member:
    """Return the network of `path`, on the CPU in single precision.

    Args:
        identity: required twin and table. config: required configuration; None skips the check.

    Raises:
        HieraError: no such file, a card that does not fit its weights, or a network of another configuration, twin or
            channel table.
    """
    card = path.with_suffix(".json")
    document = _document(card)
    try:
        found = Identity(document["twin"], document["table"], tuple(document["parameters"]), tuple(document["outputs"]))
        own = Config.of(document["config"])
        digest, limit = document["weights"]["sha256"], float(document["envelope_limit"])
    except (ValueError, KeyError, TypeError) as error:
        raise HieraError(f"model card {card} cannot be read ({error}); train again") from error
    _refuse_others(path, found, own, identity, config)
    if not path.exists():
        raise HieraError(
            f"the weights {path} of model card {card} are missing; put them beside the card", code="MISSING_MEMBER"
        )
    try:
        found_digest = _digest(path)
    except OSError as error:
        raise HieraError(f"the weights {path} cannot be read ({error.strerror}); train again") from error
    if found_digest != digest:
        raise HieraError(
            f"the weights {path} are not those of model card {card}: their checksum differs; train again",
            code="OTHER_MEMBER",
        )
    try:
        tensors = load_file(path)
        network = HieraUNet(own)
        weights = {k.removeprefix("network."): v.float() for k, v in tensors.items() if k.startswith("network.")}
        network.load_state_dict(weights)
        hull = Envelope(
            tensors["envelope.mean"].double().numpy(), tensors["envelope.precision"].double().numpy(), limit
        )
    except (SafetensorError, RuntimeError, KeyError) as error:
        raise HieraError(
            f"the weights {path} do not fit model card {card}: they are of another configuration than {own.name!r} "
            "there; train again"
        ) from error
    return Member(network.eval(), found, hull, document)


def _document(card: Path) -> dict[str, Any]:
    try:
        document: dict[str, Any] = dict(json.loads(read_regular(card)))
    except FileNotFoundError as error:
        raise HieraError(
            f"there is no model card {card}; train a network with `hil train`", code="MISSING_MEMBER"
        ) from error
    except OSError as error:
        raise HieraError(f"model card {card} cannot be read ({error.strerror}); give a model card") from error
    except (ValueError, TypeError, RecursionError) as error:
        raise HieraError(f"model card {card} cannot be read ({error}); train again") from error
    if document.get("format") != FORMAT:
        raise HieraError(
            f"model card {card} has format {document.get('format')}, not {FORMAT}: its network is of another version; "
            "train again",
            code="OTHER_FORMAT",
        )
    return document


def _refuse_others(path: Path, found: Identity, own: Config, identity: Identity | None, config: Config | None) -> None:
    if config is not None and own != config:
        raise HieraError(
            f"the weights {path} are of configuration {own.name!r} with other sizes than the {config.name!r} one asked "
            "for; choose that configuration or train again"
        )
    if identity is None:
        return
    if found.twin != identity.twin or found.outputs != identity.outputs:
        other = "elements" if found.outputs == identity.outputs else f"sensors, {', '.join(found.outputs)}"
        raise HieraError(
            f"the weights {path} were trained for a twin of another structure, with other {other}; `hil train loop` "
            "trains for the shipped loop's structure alone and `hil train tower` for cooling-tower cells, so choose "
            "weights of this structure or another calibrator, such as least_squares",
            code="OTHER_SUBJECT" if TOWER_CELL in (found.twin, identity.twin) else "OTHER_TWIN",
        )
    if found.table != identity.table:
        raise HieraError(
            f"the weights {path} were trained with another channel table; train again with `hil train`",
            code="OTHER_TABLE",
        )
    if found.parameters != identity.parameters:
        raise HieraError(
            f"the weights {path} tell {', '.join(found.parameters)}, not {', '.join(identity.parameters)}; calibrate "
            "those, as `hil train` trains for no others",
            code="OTHER_PARAMETERS",
        )


def _digest(path: Path) -> str:
    return hashlib.sha256(read_regular(path, MOST_WEIGHTS)).hexdigest()


def keep(state: dict[str, Any], path: Path) -> None:
    """Write the state of a training for resuming; the file appears whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.name}.part")
    torch.save(state, unfinished)
    unfinished.replace(path)


def kept(path: Path) -> dict[str, Any]:
    """Return the state that `keep` wrote; it holds tensors and plain data only, nothing in it is executed.

    Raises:
        HieraError: it cannot be read.
    """
    try:
        state: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # whatever unpickling a damaged file raises
        raise HieraError(f"{path} cannot be read; remove it to begin the training anew") from error
    return state
