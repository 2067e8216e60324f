"""Whether proposals in a row agree.

They share most of a two-hour record and still differ by what the latest minutes tell. One alone is therefore no
ground to move a parameter: it moves once the next one says the same. A rig that drifts is never twice the same, and the
surer proposals are, the sooner they differ. So where two in a row both exclude what the live twin has, on the same
side, the newer one is taken on whether they agree or not: whatever is true, what the twin has is not. Where proposals
turn round again and again, no one set of parameters is behind the record, whatever each of them looks like.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from twin.calibrators.base import from_json, to_json
from twin.calibrators.hiera_unet.serve.gates import Reason
from twin.network import Array

IN_A_ROW = 2
"""Open proposals that have to agree before a parameter moves."""
APART_S = 1050.0
"""Time between two proposals that speak of a parameter from which they are not in a row: three and a half cycles."""
SPAN_S = 7200.0
TURNS = 3
"""Contradictions within `SPAN_S`, each the other way than the one before it, of which a rig that changes, even there
and back, has fewer. A drift, however far, is one."""


@dataclass(frozen=True)
class Spoken:
    """What a proposal said: theta, half (P,) deviations and half widths of their intervals; open (P,) bool, by gates
    that look at this proposal alone."""

    time_s: float
    theta: Array
    half: Array
    open: np.ndarray

    def contradicts(self, other: Spoken) -> np.ndarray:
        """Parameters (P,) that both speak of, and whose two intervals have nothing in common."""
        apart: np.ndarray = np.abs(self.theta - other.theta) > self.half + other.half
        return self.open & other.open & apart

    def beyond(self, theta: Array) -> Array:
        """Side (P,) of its interval on which it leaves `theta` behind: 1 where that is too low, -1 too high, else 0."""
        away = self.theta - theta
        return np.where(np.abs(away) > self.half, np.sign(away), 0.0)

    def plain(self) -> dict[str, Any]:
        """Plain data to go on from."""
        arrays = {key: to_json(getattr(self, key)) for key in ("theta", "half")}
        return {"time_s": self.time_s, **arrays, "open": self.open.tolist()}

    @classmethod
    def restored(cls, data: Mapping[str, Any]) -> Spoken:
        """From what `plain` gave."""
        theta, half = (from_json(data[key]).reshape(-1) for key in ("theta", "half"))
        return cls(data["time_s"], theta, half, np.array(data["open"], dtype=bool))


def lately(spoken: Iterable[Spoken], now_s: float) -> tuple[Spoken, ...]:
    """Those of the last two hours."""
    return tuple(s for s in spoken if now_s - s.time_s < SPAN_S)


def doubts(before: Sequence[Spoken], now: Spoken, live: Array, ids: tuple[str, ...]) -> tuple[Reason, ...]:
    """Gates that close on what was proposed `before`, latest last; parameters that are not open now are left out.

    Args:
        live: (P,) deviations that the live twin has.
    """
    found = []
    turned = turns((*before, now))
    most = int(np.argmax(turned))
    if turned[most] >= TURNS:
        sentence = f"what is proposed of {ids[most]} turned round {turned[most]} times in two hours: rows out of order?"
        found.append(Reason("CONTRADICTORY_EVENT", sentence))
    for k in np.flatnonzero(now.open).tolist():
        row = _in_a_row(before, now, k)
        sides = {float(s.beyond(live)[k]) for s in (*row, now)}
        if len(row) < IN_A_ROW - 1:
            found.append(Reason("UNCONFIRMED", f"no proposal before says the same of {ids[k]}: held", ids[k]))
        elif any(now.contradicts(s)[k] for s in row) and sides not in ({1.0}, {-1.0}):
            found.append(Reason("CONTRADICTORY_EVENT", f"{ids[k]} is not what it was five minutes before"))
    return tuple(found)


def turns(spoken: Sequence[Spoken]) -> np.ndarray:
    """How often (P,) what is proposed was contradicted the other way than the time before, the first time included."""
    count = np.zeros(len(spoken[-1].theta), dtype=int)
    for k in range(len(count)):
        latest = 0.0
        for a, b in pairwise(s for s in spoken if s.open[k]):
            way = float(np.sign(b.theta[k] - a.theta[k]))
            if a.contradicts(b)[k] and way != latest:
                count[k] += 1
                latest = way
    return count


def _in_a_row(before: Sequence[Spoken], now: Spoken, k: int) -> tuple[Spoken, ...]:
    """The latest that speak of parameter k and have to agree with `now`, as far as none is too far from the next."""
    row: list[Spoken] = []
    for s in reversed([s for s in before if s.open[k]][-(IN_A_ROW - 1) :]):
        if (row[-1] if row else now).time_s - s.time_s > APART_S:
            break
        row.append(s)
    return tuple(row)
