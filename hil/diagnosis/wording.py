"""What a diagnosis says, in words: labels, and why its answer should be believed. Made from `diagnosis.json` alone, so
that terminal, page and Rerun say the same."""

from __future__ import annotations

from typing import Any

RARE = 1e-6
"""Probability below which no figure is given: the tail that it is read from is drawn, not observed."""


def short(sensor: str) -> str:
    """A sensor's column as a label: `T_tank_C` -> `tank`."""
    return sensor.removeprefix("T_").removesuffix("_C")


def plain(effect: dict[str, Any]) -> str:
    """`heat source at modules (constant)`."""
    what = f"{effect['kind']} at {effect['where']}".replace("_", " ") if effect["kind"] != "sensor" else ""
    return f"{what or 'sensor ' + effect['where']} ({effect['driver'].replace('_', ' ')})"


def after_label(document: dict[str, Any]) -> str:
    """What the twin held whose errors are called `after`."""
    if document["verdict"] in ("effect found", "ambiguous"):
        return "with the effect"
    tried = any(e["after"] != e["before"] for e in document["error"]["sensors"].values())
    return "with the best effect tried" if tried else "re-tuned"


def grown(document: dict[str, Any]) -> bool:
    """Whether the twin was grown from its file, with nothing known of it when healthy."""
    return str(document.get("method", "")).startswith("growth")


def at_rest(document: dict[str, Any]) -> bool:
    """Whether the record was of steady states, whose times are their numbers."""
    return document.get("method") == "growth at rest"


def beside_answer(document: dict[str, Any]) -> list[dict[str, Any]]:
    """What cannot be told from the answer, without the answer itself, which an ambiguous finding lists too."""
    said = {(e["kind"], e["where"], e["driver"]) for e in document["effects"]}
    return [a for a in document["indistinguishable"] if (a["kind"], a["where"], a["driver"]) not in said]


def reasons(document: dict[str, Any]) -> list[str]:
    """Why the answer should be believed, or what spoke against adopting one: a sentence each."""
    return [text for text in (chance(document), left_out(document)) if text]


def chance(document: dict[str, Any]) -> str:
    """How often noise alone would do as well; "" where nothing was found that a scan could find by chance."""
    found = [e for e in document["effects"] if e.get("p_family_wise") is not None]
    if not found:
        return ""
    worst = max(found, key=lambda e: e["p_family_wise"])
    # Each effect of a growth has a chance of its own; the threshold is the highest of them.
    limit = worst.get("noise_z") if worst.get("noise_z") is not None else document.get("threshold")
    score = f"Noise alone would score {worst['z']:.3g} somewhere in the whole catalogue {often(worst['p_family_wise'])}"
    return score + (f"; one record of noise in a hundred reaches {limit:.1f}." if limit is not None else ".")


def worse(document: dict[str, Any]) -> str:
    """By how much an answer is worse than re-tuning where no fit saw the record, as half a sentence, or ""."""
    from twin.discovery.selection.held_out import WORSE  # it brings the whole search along, which no run needs

    sensors = {k: e for k, e in document["error"]["sensors"].items() if None not in (e["before"], e["after"])}
    before, after = (sum((e[k] / e["noise"]) ** 2 for e in sensors.values()) for k in ("before", "after"))
    if not after > WORSE * max(before, len(sensors)):
        return ""
    name, e = max(sensors.items(), key=lambda item: (item[1]["after"] - item[1]["before"]) / item[1]["noise"])
    return f"{name} is off by {e['after']:.3g} K {after_label(document)} and by {e['before']:.3g} K re-tuned alone"


def often(probability: float) -> str:
    """A probability as an operator reads it."""
    if probability < RARE:
        return "less than once in a million records"
    if probability > 0.1:
        return f"in {100.0 * probability:.0f} of a hundred records"
    return f"once in {float(f'{1.0 / probability:.2g}'):,.0f} records"


def left_out(document: dict[str, Any]) -> str:
    """What blocks of time say that the sizes were not taken from; "" where none was asked."""
    blocks = [b["gain"] for b in document.get("left_out") or () if b["gain"] is not None]
    if not blocks:
        return ""
    off = worse(document)
    if off:
        return (
            f"On the part that no fit saw, {off}: it does not foretell that part, whatever it gains in blocks left out."
        )
    won = sum(gain > 0.0 for gain in blocks)
    what = (
        "the effects foretell"
        if document["verdict"] in ("effect found", "ambiguous")
        else "the best effect tried foretells"
    )
    if len(document["effects"]) == 1:
        what = what.replace("the effects foretell", "the effect foretells")
    parts = "groups of states" if at_rest(document) else "blocks of time"
    many = (
        f"{won} of {len(blocks)} {parts}" if len(blocks) > 1 else f"{won} of the one block of time that could be asked"
    )
    rest = "the other states" if at_rest(document) else "the rest of the record"
    return f"With sizes and tunables solved from {rest}, {what} {many} better than the twin without."
