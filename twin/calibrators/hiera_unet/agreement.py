"""Whether proposals in a row agree.

They share most of a two-hour record and still differ by what the latest minutes tell. One alone is therefore no
ground to move a parameter: it moves once the next one says the same. Where they contradict one another again and
again, no one set of parameters is behind the record, whatever each of them looks like.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from twin.calibrators.base import from_plain, plain
from twin.calibrators.hiera_unet.gates import Reason
from twin.network import Array

IN_A_ROW = 2
"""Open proposals that have to agree before a parameter moves."""
APART_S = 450.0
"""Time between two proposals from which they are not in a row: one and a half cycles."""
SPAN_S = 7200.0
TURNS = 3
"""Contradictions within `SPAN_S` of which a rig that changes, even there and back, has fewer."""


@dataclass(frozen=True)
class Spoken:
    """What a proposal said: theta, half (P,) deviations and half widths of their intervals; open (P,) bool, by gates
    that look at this proposal alone."""

    time_s: float
    theta: Array
    half: Array
    open: np.ndarray

    def contradicts(self, other: Spoken) -> np.ndarray:
        """Parameters (P,) whose two intervals have nothing in common."""
        return np.abs(self.theta - other.theta) > self.half + other.half

    def plain(self) -> dict[str, Any]:
        """Plain data to go on from."""
        arrays = {key: plain(getattr(self, key)) for key in ("theta", "half")}
        return {"time_s": self.time_s, **arrays, "open": self.open.tolist()}

    @classmethod
    def restored(cls, data: Mapping[str, Any]) -> Spoken:
        """From what `plain` gave."""
        theta, half = (from_plain(data[key]).reshape(-1) for key in ("theta", "half"))
        return cls(data["time_s"], theta, half, np.array(data["open"], dtype=bool))


def lately(spoken: Iterable[Spoken], now_s: float) -> tuple[Spoken, ...]:
    """Those of the last two hours."""
    return tuple(s for s in spoken if now_s - s.time_s < SPAN_S)


def doubts(before: Sequence[Spoken], now: Spoken, ids: tuple[str, ...]) -> tuple[Reason, ...]:
    """Gates that close on what was proposed `before`, latest last; parameters that are not open now are left out."""
    found = []
    turns = sum((a.contradicts(b).astype(int) for a, b in pairwise((*before, now))), np.zeros(len(ids), dtype=int))
    most = int(np.argmax(turns))
    if turns[most] >= TURNS:
        sentence = f"what is proposed of {ids[most]} turned round {turns[most]} times in two hours: rows out of order?"
        found.append(Reason("CONTRADICTORY_EVENT", sentence))
    row = _in_a_row(before, now)
    for k in np.flatnonzero(now.open).tolist():
        if any(s.open[k] and now.contradicts(s)[k] for s in row):
            found.append(Reason("CONTRADICTORY_EVENT", f"{ids[k]} is not what it was five minutes before"))
        elif len(row) < IN_A_ROW - 1 or not all(s.open[k] for s in row):
            found.append(Reason("UNCONFIRMED", f"no proposal before says the same of {ids[k]}: held", ids[k]))
    return tuple(found)


def _in_a_row(before: Sequence[Spoken], now: Spoken) -> tuple[Spoken, ...]:
    """The latest that have to agree with `now`, as far as none is missing between them."""
    row: list[Spoken] = []
    for s in reversed(before[-(IN_A_ROW - 1) :]):
        if (row[-1] if row else now).time_s - s.time_s > APART_S:
            break
        row.append(s)
    return tuple(row)
