"""Words of a diagnosis: labels, and the evidence for its answer. They use `diagnosis.json` alone, so that terminal,
page and Rerun agree.
"""

from __future__ import annotations

import math
from typing import Any

RARE = 1e-6
"""Probability below which no figure is given: the tail is extrapolated from the null distribution, not observed."""


def short(sensor: str) -> str:
    """Return the label of a sensor's column: `T_tank_C` -> `tank`."""
    return sensor.removeprefix("T_").removesuffix("_C")


def plain(effect: dict[str, Any]) -> str:
    """Return the label of an effect, as `heat source at modules (constant)`."""
    what = f"{effect['kind']} at {effect['where']}".replace("_", " ") if effect["kind"] != "sensor" else ""
    return f"{what or 'sensor ' + effect['where']} ({effect['driver'].replace('_', ' ')})"


def after_label(document: dict[str, Any]) -> str:
    """Return the label of the twin whose errors are called `after`; an effect of its own course predicts none."""
    predicts = any(e["shape"] != "own course" for e in document["effects"])
    if document["verdict"] in ("effect found", "ambiguous") and predicts:
        return "with the effect"
    tried = any(e["after"] != e["before"] for e in document["error"]["sensors"].values())
    return "with the best effect tried" if tried else "re-tuned"


def grown(document: dict[str, Any]) -> bool:
    """Return True if the twin was grown from its file, without a healthy record."""
    return str(document.get("method", "")).startswith("growth")


def at_rest(document: dict[str, Any]) -> bool:
    """Return True if the record was of steady states, whose times are their numbers."""
    return document.get("method") == "growth at rest"


def ambiguity_group(document: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the explanations that are not distinguishable from the answer, without the answer itself."""
    answers = {(e["kind"], e["where"], e["driver"]) for e in document["effects"]}
    return [a for a in document["indistinguishable"] if (a["kind"], a["where"], a["driver"]) not in answers]


def likeness(document: dict[str, Any], other: dict[str, Any]) -> str:
    """Return how an explanation of the ambiguity group differs from the answer, in words."""
    alone = any((e["kind"], e["where"]) == (other["kind"], other["where"]) for e in document["effects"])
    same = "not distinguishable in this record"
    return f"{same}: the same cause, but for what it follows" if alone else same


def reasons(document: dict[str, Any]) -> list[str]:
    """Return the evidence for the answer, or against adopting one: a sentence each."""
    return [text for text in (chance(document), left_out(document)) if text]


def chance(document: dict[str, Any]) -> str:
    """Return the false-alarm probability as a sentence; "" if nothing was found that a scan could find by chance."""
    found = [e for e in document["effects"] if e.get("p_family_wise") is not None]
    if not found:
        return odds(document)
    worst = max(found, key=lambda e: e["p_family_wise"])
    # Each effect of a growth has its own p-value; the threshold is the highest of them.
    limit = worst.get("noise_z") if worst.get("noise_z") is not None else document.get("threshold")
    score = (
        f"Noise alone would score {worst['z']:.3g} somewhere in the whole catalogue {frequency(worst['p_family_wise'])}"
    )
    return score + (f"; one record of noise in a hundred reaches {limit:.1f}." if limit is not None else ".")


def odds(document: dict[str, Any]) -> str:
    """Return the posterior odds of the answer against no effect as a sentence; "" if nothing was claimed by them."""
    log_odds, needed = document.get("log_odds"), document.get("log_odds_to_claim")
    if log_odds is None or needed is None or log_odds < needed or document["verdict"] == "adequate":
        return ""
    million = math.log(1e6)
    times = "over a million to one" if log_odds > million else f"{float(f'{math.exp(log_odds):.1g}'):,.0f} to one"
    return (
        f"After this record the odds that an effect exists are {times} (natural logarithm {log_odds:.4g}); a claim "
        f"needs {needed:.3g}."
    )


def worse(document: dict[str, Any]) -> str:
    """Return the loss of an answer against re-tuning on the held-out segment, as half a sentence, or ""."""
    from twin.discovery import HELD_OUT_WORSE

    sensors = {k: e for k, e in document["error"]["sensors"].items() if None not in (e["before"], e["after"])}
    before, after = (sum((e[k] / e["noise"]) ** 2 for e in sensors.values()) for k in ("before", "after"))
    if not after > HELD_OUT_WORSE * max(before, len(sensors)):
        return ""
    name, e = max(sensors.items(), key=lambda item: (item[1]["after"] - item[1]["before"]) / item[1]["noise"])
    return f"{name} is off by {e['after']:.3g} K {after_label(document)} and by {e['before']:.3g} K re-tuned alone"


def frequency(probability: float) -> str:
    """Return a probability as a frequency in words."""
    if probability < RARE:
        return "less than once in a million records"
    if probability > 0.1:
        return f"in {100.0 * probability:.0f} of a hundred records"
    return f"once in {float(f'{1.0 / probability:.2g}'):,.0f} records"


def left_out(document: dict[str, Any]) -> str:
    """Return the result of cross-validation as a sentence; "" without folds."""
    blocks = [b["gain"] for b in document.get("left_out") or () if b["gain"] is not None]
    if not blocks:
        return ""
    off, claimed = worse(document), document["verdict"] in ("effect found", "ambiguous")
    if off and claimed:
        return f"On the held-out segment, {off}: that neither supports nor contradicts the answer."
    if off:
        return f"On the held-out segment, {off}: the answer does not predict it, whatever its gain in cross-validation."
    won = sum(gain > 0.0 for gain in blocks)
    subject = "the effects predict" if claimed else "the best effect tried predicts"
    if len(document["effects"]) == 1:
        subject = subject.replace("the effects predict", "the effect predicts")
    parts = "groups of states" if at_rest(document) else "folds"
    many = f"{won} of {len(blocks)} {parts}" if len(blocks) > 1 else f"{won} of the one usable fold"
    rest = "the other states" if at_rest(document) else "the rest of the record"
    return f"With sizes and tunables solved from {rest}, {subject} {many} better than the twin without them."
