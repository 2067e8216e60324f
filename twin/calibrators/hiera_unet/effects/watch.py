"""Watch of a record that goes on: samples in, one answer every five minutes out."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch

from twin.calibrators.hiera_unet.effects.balance import EVERY_S, WINDOW_S, Balance, Figures
from twin.calibrators.hiera_unet.effects.member import EffectsMember
from twin.calibrators.hiera_unet.effects.memory import learn
from twin.calibrators.hiera_unet.effects.scores import window_scores
from twin.network import Array, Network

MOST_WINDOWS = 288
"""Windows that are looked back upon: a day."""


@dataclass(frozen=True)
class EffectAnswer:
    """Answer at the end of a window.

    Attributes
    ----------
    end_s
        End of the window, s of the record.
    warned
        True if the statistic exceeds the threshold.
    kind, where
        Likeliest effect, in the words of a diagnosis.
    size, interval90
        Size in `unit` with its 90 % interval.
    since_s, since_interval90_s
        Onset, s of the record.
    """

    end_s: float
    warned: bool
    kind: str
    where: str
    size: float
    interval90: tuple[float, float]
    unit: str
    since_s: float
    since_interval90_s: tuple[float, float]


class EffectsWatch:
    """Watch of one rig.

    Parameters
    ----------
    network
        The commissioned twin, with a thermometer at each node.
    healthy
        Windows of its healthy record (`Balance.figures`).
    member
        The trained network.

    Raises
    ------
    HieraError
        The twin has a node without a thermometer, or the healthy record is too short.
    """

    def __init__(self, network: Network, healthy: Figures, member: EffectsMember) -> None:
        self.balance = Balance(network)
        self._memory = learn(healthy)
        self._member = member
        self._figures: Figures | None = None
        self._rest: tuple[Array, Array, Array] | None = None
        self._begin: float | None = None

    def push(self, time_s: Array, inputs: Array, measured: Array) -> tuple[EffectAnswer, ...]:
        """Take samples in order; return an answer for each window that they complete.

        Parameters
        ----------
        time_s
            Time (n,), s, increasing. Samples that were given before are left out.
        inputs, measured
            Inputs (n, c) and readings (n, m) in the network's order; NaN where missing.
        """
        if self._rest is not None:
            new = time_s > self._rest[0][-1]
            both = zip(self._rest, (time_s[new], inputs[new], measured[new]), strict=True)
            time_s, inputs, measured = (np.concatenate(pair) for pair in both)
        if not len(time_s):
            return ()
        self._rest = time_s, inputs, measured
        begin = float(time_s[0]) if self._begin is None else self._begin
        if time_s[-1] - begin < WINDOW_S:
            return ()
        new_figures = self.balance.figures(time_s, inputs, measured, begin)
        count = len(new_figures.end_s)
        self._figures = _joined(self._figures, new_figures)
        self._begin = begin + count * EVERY_S
        late = time_s >= self._begin - 1e-6
        self._rest = time_s[late], inputs[late], measured[late]
        return self._answers(count)

    def _answers(self, count: int) -> tuple[EffectAnswer, ...]:
        assert self._figures is not None
        hypotheses = self.balance.hypotheses
        course = self._member.course(window_scores(self._figures, self._memory), hypotheses)
        found = []
        for k in range(len(course.statistic) - count, len(course.statistic)):
            end = float(self._figures.end_s[k])
            named = hypotheses[int(course.hypothesis[k])]
            found.append(
                EffectAnswer(
                    end,
                    bool(course.statistic[k] > self._member.threshold and self._figures.valid[k]),
                    named.named,
                    named.where,
                    float(course.size[k]),
                    (float(course.size_low[k]), float(course.size_high[k])),
                    named.unit,
                    end - float(course.since_s[k]),
                    (end - float(course.since_high_s[k]), end - float(course.since_low_s[k])),
                )
            )
        return tuple(found)


def _joined(before: Figures | None, new: Figures) -> Figures:
    """Return both sets of windows, the latest `MOST_WINDOWS` of them."""
    if before is None:
        return new
    values = {
        name: np.concatenate([getattr(before, name), getattr(new, name)])[-MOST_WINDOWS:]
        for name in ("end_s", "power", "direction", "levels", "rates", "valid")
    }
    return replace(new, **values)


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Limit torch to one thread, and restore its number afterwards."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
