"""A trained ensemble for cooling-tower cells: its card, its members, and its answers with 90 % intervals.

The card `<name>.json` names the members with their checksums, and for each branch the factors by which the members'
standard deviations become 90 % intervals. The causal branch serves: an answer at a time knows nothing later. The
symmetric branch is that of an offline report.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from twin.calibrators.hiera_unet.model.config import HieraError
from twin.calibrators.hiera_unet.tower.member import load_member
from twin.calibrators.hiera_unet.tower.predict import NETWORKS, outlet_refused, predict, start_sentence
from twin.calibrators.hiera_unet.tower.score import LEVEL, IntervalFactors, MethodPrediction, mixed, targets_of
from twin.calibrators.hiera_unet.tower.table import SUBJECT
from twin.calibrators.hiera_unet.tower.windows import Fleet
from twin.calibrators.hiera_unet.weights.checkpoint import Member
from twin.calibrators.hiera_unet.weights.envelope import place
from twin.regular_file import read_regular
from twin.tower.air import Array

FORMAT = 1
CAUSAL, SYMMETRIC = "causal", "symmetric"
BRANCHES = (CAUSAL, SYMMETRIC)
LEAST = 2
"""Least number of members: the intervals of one alone lack the epistemic part."""
AGAIN = "write it again with `python -m hil.training.tower.ensemble`"


@dataclass(frozen=True)
class EnsembleAnswer:
    """Answer of an ensemble to K windows.

    Attributes
    ----------
    rows
        (K,) cycles.
    found
        Deviations (K, 4) and outlet (K, 120) degC with half widths of their 90 % intervals.
    distance
        (K,) from the training envelope, 1 at its limit, the mean over members.
    attention
        (K, 4, 12) of each query.
    """

    rows: NDArray[np.int64]
    found: MethodPrediction
    distance: Array
    attention: Array


@dataclass(frozen=True)
class TowerEnsemble:
    """Members with the interval factors of each branch.

    Attributes
    ----------
    blind
        Names of the members that the gate against blindness refused.
    digest
        SHA-256 of the card.
    outlet
        Sentence on an outlet that is the start's, "" where it is the network's.
    """

    name: str
    members: tuple[Member, ...]
    factors: Mapping[str, IntervalFactors]
    blind: tuple[str, ...]
    digest: str
    outlet: str = ""

    def ask(self, fleet: Fleet, rows: NDArray[np.int64], branch: str = CAUSAL, size: int = 64) -> EnsembleAnswer:
        """Return the answer to cycles `rows` (K,) in a branch.

        Parameters
        ----------
        size
            Windows of a batch.
        """
        causal = branch == CAUSAL
        parts = [predict(one.network, fleet, rows, size, causal=causal) for one in self.members]
        found, sd, water_sd = mixed(targets_of(fleet, rows, size), parts)
        return EnsembleAnswer(
            rows,
            self.factors[branch].applied(found, sd, water_sd),
            self._distance(fleet, rows, size),
            np.mean([one.attention for one in parts], axis=0),
        )

    def _distance(self, fleet: Fleet, rows: NDArray[np.int64], size: int) -> Array:
        found = []
        for at in range(0, len(rows), size):
            batch = fleet.batch(torch.from_numpy(rows[at : at + size]))
            where = place(batch.x.cpu().numpy(), batch.m.cpu().numpy())
            found.append(np.mean([one.envelope.distance(where) for one in self.members], axis=0))
        return np.concatenate(found)


def factors_of(
    members: Sequence[Member], fleet: Fleet, rows: NDArray[np.int64], size: int = 64
) -> dict[str, IntervalFactors]:
    """Return the interval factors of an ensemble by branch, from windows (K,) with their truth that no training saw.

    Raises
    ------
    HieraError
        The windows show no truth of a quantity.
    """
    t = targets_of(fleet, rows, size)
    found = {}
    for branch in BRANCHES:
        parts = [predict(one.network, fleet, rows, size, causal=branch == CAUSAL) for one in members]
        found[branch] = IntervalFactors.of(t, *mixed(t, parts))
        if not (np.isfinite(found[branch].theta).all() and np.isfinite(found[branch].water)):
            raise HieraError(f"{len(rows)} windows are too few to set 90 % intervals; simulate more stations")
    return found


def card_of(
    name: str,
    members: Mapping[str, Member],
    factors: Mapping[str, IntervalFactors],
    left_out: Mapping[str, str],
    more: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the card of an ensemble as plain data.

    Parameters
    ----------
    name
        Name of the ensemble.
    members
        Members by the name of their weights.
    factors
        Interval factors by branch.
    left_out
        Reason by the name of weights that are no member.
    more
        Further entries of the card.
    """
    return {
        "format": FORMAT,
        "subject": SUBJECT.name,
        "name": name,
        "table": SUBJECT.digest(),
        "members": {file: one.card["weights"]["sha256"] for file, one in members.items()},
        "left_out": dict(left_out),
        "outlet": outlet_of({file: one.card for file, one in members.items()}) or NETWORKS,
        "level": LEVEL,
        "branches": {b: {"theta": [float(v) for v in f.theta], "water": f.water} for b, f in factors.items()},
        **more,
    }


def outlet_of(cards: Mapping[str, Mapping[str, Any]]) -> str:
    """Return a sentence where the outlet of a member is the start's, "" where each is the network's.

    Parameters
    ----------
    cards
        Card of each member by the name of its weights.
    """
    start = {name: bool(card["config"].get("trees")) for name, card in cards.items() if outlet_refused(card)}
    if not start:
        return ""
    return start_sentence(all(start.values()), () if len(start) == len(cards) else list(start))


def judged_again(document: Mapping[str, Any], cards: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return the card of an ensemble by the present rule of the gate.

    Parameters
    ----------
    document
        Card of the ensemble.
    cards
        Card of each trained member by the name of its weights.

    Raises
    ------
    HieraError
        The gate passes other members than those that the factors of the intervals are of.
    """
    names = list(document["members"])
    asked = {n: one for n, one in cards.items() if n in names or n in document.get("left_out", {})}
    if set(names) - set(asked):
        raise HieraError(f"the card of {document['name']} names members whose cards are missing; put them beside it")
    made, _ = passed({n: str(one["refused"]) for n, one in asked.items()})
    if sorted(made) != sorted(names):
        raise HieraError(
            f"the factors of {document['name']} are of {', '.join(names)}, and the gate passes {', '.join(made)}; "
            f"{AGAIN}"
        )
    return {**document, "outlet": outlet_of({n: asked[n] for n in names}) or NETWORKS}


def load_ensemble(card: Path, *, blind_too: bool = False) -> TowerEnsemble:
    """Return the ensemble of a card.

    Parameters
    ----------
    blind_too
        Load members that the gate against blindness refused, for a service that changes nothing.

    Raises
    ------
    HieraError
        The card or a member cannot be read, is missing, was altered, or belongs to another subject, table or format;
        or a member's parameters are blind.
    """
    document, text = _document(card)
    if "members" not in document:
        _refuse_single(card, document, blind_too)
    if document.get("subject") != SUBJECT.name:
        raise HieraError(
            f"{card} is the card of no network for cooling-tower cells; give profiles/trained/tower_small.json or one "
            "that `hil train tower` wrote",
            code="OTHER_SUBJECT",
        )
    if document.get("format") != FORMAT:
        raise HieraError(
            f"the card {card} has format {document.get('format')}, not {FORMAT}; {AGAIN}", code="OTHER_FORMAT"
        )
    if document.get("table") != SUBJECT.digest():
        raise HieraError(
            f"the card {card} belongs to another channel table; train again with `hil train tower`", code="OTHER_TABLE"
        )
    names, factors = _content(card, document)
    members = []
    for name, digest in names.items():
        path = card.parent / name
        if not path.exists():
            raise HieraError(f"the card {card} names {name}, which is missing; put it there", code="MISSING_MEMBER")
        member = load_member(path, blind_too=blind_too)
        if member.card["weights"]["sha256"] != digest:
            raise HieraError(f"{path} is not the member that {card} names; {AGAIN}", code="OTHER_MEMBER")
        members.append(member)
    blind = tuple(n for n, one in zip(names, members, strict=True) if one.card.get("refused"))
    outlet = outlet_of(dict(zip(names, (one.card for one in members), strict=True)))
    digest = hashlib.sha256(text).hexdigest()
    return TowerEnsemble(str(document["name"]), tuple(members), factors, blind, digest, outlet)


def _document(card: Path) -> tuple[dict[str, Any], bytes]:
    try:
        text = read_regular(card)
        return dict(json.loads(text)), text
    except FileNotFoundError as error:
        raise HieraError(f"there is no card {card}; give that of an ensemble", code="MISSING_MEMBER") from error
    except OSError as error:
        raise HieraError(f"the card {card} cannot be read ({error.strerror}); give that of an ensemble") from error
    except (ValueError, TypeError, RecursionError) as error:
        raise HieraError(f"{card} is no card of an ensemble ({error}); give its .json file") from error


def _refuse_single(card: Path, document: Mapping[str, Any], blind_too: bool) -> None:
    """Raise HieraError for the card of one member, or of something else."""
    if document.get("refused") and not blind_too:
        load_member(card.with_suffix(".safetensors"))
        raise HieraError(f"{card}: its gate refused it; give another", code=str(document["refused"]))
    if "weights" in document:
        raise HieraError(
            f"{card} is the card of a single member, which has no interval factors; give that of an ensemble, such as "
            "profiles/trained/tower_small.json",
            code="SINGLE_MEMBER",
        )
    raise HieraError(f"{card} is no card of an ensemble; give its .json file")


def _content(card: Path, document: Mapping[str, Any]) -> tuple[dict[str, str], dict[str, IntervalFactors]]:
    try:
        names = {str(k): str(v) for k, v in document["members"].items()}
        factors = {
            b: IntervalFactors(
                np.array(document["branches"][b]["theta"], dtype=np.float64), float(document["branches"][b]["water"])
            )
            for b in BRANCHES
        }
        str(document["name"])
    except (KeyError, ValueError, TypeError, AttributeError) as error:
        raise HieraError(f"the card {card} lacks members or factors ({error!r}); {AGAIN}") from error
    outside = [name for name in names if Path(name).name != name]
    if outside:
        raise HieraError(f"the card {card} names {outside[0]}, which does not lie beside it; {AGAIN}")
    if len(names) < LEAST:
        raise HieraError(
            f"the card {card} names {len(names)} member{'s' * (len(names) != 1)}, and an ensemble has at least "
            f"{LEAST}; train more with `hil train tower` and other seeds"
        )
    for branch, one in factors.items():
        wanted = (len(SUBJECT.deviations),)
        if one.theta.shape != wanted or not (np.r_[one.theta, one.water] > 0.0).all():
            raise HieraError(
                f"the card {card} has no positive factor for each quantity of the {branch} branch; {AGAIN}"
            )
    return names, factors


def passed(refused: Mapping[str, str]) -> tuple[list[str], dict[str, str]]:
    """Return the members of an ensemble, and the reason of those that are left out.

    Members that the gate passed make the ensemble. With fewer than `LEAST` of them all do, and such an ensemble is
    for the shadow mode alone.

    Parameters
    ----------
    refused
        Code of the gate by member, "" where it passed.
    """
    good = [name for name, code in refused.items() if not code]
    if len(good) < LEAST:
        return list(refused), {}
    return good, {name: code for name, code in refused.items() if code}
