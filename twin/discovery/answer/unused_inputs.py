"""Notes on inputs that no element of a twin uses and that neither the answer nor the alternatives name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin.discovery.diagnosis import Diagnosis
from twin.discovery.effects.catalogue import catalogue
from twin.network import Array, Network


def with_unused(found: Diagnosis, network: Network, inputs: Array) -> Diagnosis:
    """Return a diagnosis with a note on each input (column of `inputs` (N, c)) that neither the twin nor the answer
    uses.
    """
    return replace(found, notes=(*found.notes, *unused(found, network, inputs)))


def unused(found: Diagnosis, network: Network, inputs: Array) -> list[str]:
    """Return a sentence for each such input: that it was tried as the driver of an effect, and what excluded it."""
    used = {column for element in network.elements for column in element.inputs()}
    told = {e.driver for e in found.effects} | {a.driver for a in (*found.indistinguishable, *found.alternatives)}
    # What an actuator does to an input that nothing uses is nothing.
    candidates = [c for c in catalogue(network) if c.kind != "actuator"]
    said = []
    for j, column in enumerate(network.input_columns):
        if column in used or column.startswith("time_of_day"):
            continue
        tried = [c for c in candidates if any(column in table.values() for table in c.adds.values())]
        if told & {c.driver for c in tried}:
            continue
        name = column.rsplit("_", 1)[0] if not tried else tried[0].driver.replace("_", " ")
        if not tried:
            said.append(f"{name} is used by no element, and no effect of the catalogue follows it")
            continue
        what = " or ".join(dict.fromkeys(c.kind.replace("_", " ") for c in tried))
        where = ", ".join(dict.fromkeys(c.where.replace("_", " ") for c in tried))
        said.append(f"{name}, which no element uses, was tried as {what} at {where}: {_why_not(found, inputs[:, j])}")
    return said


def _why_not(found: Diagnosis, values: Array) -> str:
    known = values[np.isfinite(values)]
    if not known.size or np.ptp(known) == 0.0:
        return "it does not move in this record"
    if found.verdict == "adequate":
        return "nothing is left for it to explain"
    if found.alternatives:
        return "it would explain less than what is listed as other explanations"
    return "it would explain next to nothing"
