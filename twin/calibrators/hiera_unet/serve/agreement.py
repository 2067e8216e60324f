"""Agreement of successive proposals as a condition for a change of parameters.

Successive proposals share most of a two-hour record and still differ by the evidence of the latest minutes. One alone
therefore changes no parameter; the next one has to agree. On a drifting rig no two proposals agree, and the smaller
their intervals, the sooner they differ. If two in a row both exclude the live twin's value, on the same side, the newer
one is adopted whether they agree or not. If proposals contradict each other in alternating directions, no single set of
parameters explains the record.
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
"""Open proposals that have to agree before a parameter changes."""
APART_S = 1050.0
"""Time between two proposals about a parameter from which they are not consecutive, s: three and a half cycles."""
SPAN_S = 7200.0
TURNS = 3
"""Contradictions within `SPAN_S` with alternating direction; a rig that changes, even to and fro, has fewer. A drift of
any size is one."""


@dataclass(frozen=True)
class Spoken:
    """Proposal in brief: theta, half (P,) deviations and half widths of their intervals; open (P,) bool, by gates that
    depend on this proposal alone.
    """

    time_s: float
    theta: Array
    half: Array
    open: np.ndarray

    def contradicts(self, other: Spoken) -> np.ndarray:
        """Return the parameters (P,) bool of both proposals whose two intervals are disjoint."""
        apart: np.ndarray = np.abs(self.theta - other.theta) > self.half + other.half
        return self.open & other.open & apart

    def beyond(self, theta: Array) -> Array:
        """Return the side (P,) of its interval on which `theta` lies: 1 if `theta` is too low, -1 if too high,
        else 0.
        """
        away = self.theta - theta
        return np.where(np.abs(away) > self.half, np.sign(away), 0.0)

    def plain(self) -> dict[str, Any]:
        """Return plain data for resuming."""
        arrays = {key: to_json(getattr(self, key)) for key in ("theta", "half")}
        return {"time_s": self.time_s, **arrays, "open": self.open.tolist()}

    @classmethod
    def restored(cls, data: Mapping[str, Any]) -> Spoken:
        """Restore from the result of `plain`."""
        theta, half = (from_json(data[key]).reshape(-1) for key in ("theta", "half"))
        return cls(data["time_s"], theta, half, np.array(data["open"], dtype=bool))


def lately(spoken: Iterable[Spoken], now_s: float) -> tuple[Spoken, ...]:
    """Return the proposals of the last two hours."""
    return tuple(s for s in spoken if now_s - s.time_s < SPAN_S)


def doubts(before: Sequence[Spoken], now: Spoken, live: Array, ids: tuple[str, ...]) -> tuple[Reason, ...]:
    """Return the gates that earlier proposals `before`, latest last, close; parameters that are not open now are left
    out.

    Args:
        live: (P,) deviations of the live twin.
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
    """Return the number (P,) of contradictions in alternating directions, the first one included."""
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
    """Return the latest proposals about parameter k that have to agree with `now`, up to the first long interval."""
    row: list[Spoken] = []
    for s in reversed([s for s in before if s.open[k]][-(IN_A_ROW - 1) :]):
        if (row[-1] if row else now).time_s - s.time_s > APART_S:
            break
        row.append(s)
    return tuple(row)
