"""Examples to learn from: tokens of a record, and the right answer in each window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.calibrators.hiera_unet.effects.balance import EVERY_S, Figures, Hypothesis
from twin.calibrators.hiera_unet.effects.memory import LAGS, Memory
from twin.calibrators.hiera_unet.effects.scores import window_scores
from twin.calibrators.hiera_unet.effects.tokens import tokens
from twin.network import Array

SEEN = 3.0
"""Score of the effect itself, in the last `LAGS[-1]` windows, from which a window has to show it."""
UNKNOWN = 1e9
"""Size, in any unit, that stands for one that the window does not show."""
_RATE = LAGS.index(4)


@dataclass(frozen=True)
class Example:
    """Tokens and answers of one record.

    Attributes
    ----------
    tokens
        (K, H, WIDTH).
    place, kind
        Hypotheses at the right place, and of the right kind there (H,); none for a record without effect.
    state
        0 no effect, 1 an effect that shows, 2 one that need not (K,).
    since
        Windows since the onset (K,).
    size, sized
        True size (K,), NaN where unknown, and the hypotheses that it belongs to (H,).
    fitted, error
        Fitted sizes and their standard deviations (K, H, M).
    onset
        Window of the onset; the number of windows for a record without effect.
    """

    tokens: Array
    place: np.ndarray
    kind: np.ndarray
    state: np.ndarray
    since: Array
    size: Array
    sized: np.ndarray
    fitted: Array
    error: Array
    onset: int


@dataclass(frozen=True)
class Effect:
    """Truth about the effect of a record: places, answers (kind, place), onset in s, sizes (K,) of a kind."""

    places: tuple[str, ...]
    answers: tuple[tuple[str, str], ...]
    acts_s: float
    size: Array
    sized_kind: str


def example(
    figures: Figures, calm: Figures, memory: Memory, hypotheses: Sequence[Hypothesis], effect: Effect | None
) -> Example:
    """Return the example of a record; `calm` holds the same windows without the effect, of the same noise."""
    scores = window_scores(figures, memory)
    k = len(figures.end_s)
    place = np.zeros(len(hypotheses), dtype=bool)
    kind, sized = place.copy(), place.copy()
    state = np.zeros(k, dtype=np.int64)
    since, size, onset = np.zeros(k), np.full(k, np.nan), k
    if effect is not None:
        place = np.array([h.where in effect.places for h in hypotheses])
        kind = np.array([(h.named, h.where) in effect.answers for h in hypotheses])
        sized = place & np.array([h.kind == effect.sized_kind for h in hypotheses])
        since = np.maximum(figures.end_s - effect.acts_s, 0.0) / EVERY_S
        acting = since > 0.0
        onset = int(np.argmax(acting)) if acting.any() else k
        state = np.where(acting, np.where(own_scores(figures, calm, memory) >= SEEN, 1, 2), 0)
        size = effect.size
    error = np.sqrt(scores.past[:, None, None] / np.maximum(scores.information, 1.0 / UNKNOWN**2))
    fitted = np.clip(scores.size, -UNKNOWN, UNKNOWN)
    return Example(tokens(scores, hypotheses), place, kind, state, since, size, sized, fitted, error, onset)


def own_scores(figures: Figures, calm: Figures, memory: Memory) -> Array:
    """Return the score of the effect itself (K,): its change of the power over the healthy covariance."""
    _, _, growth = memory.read(figures)
    change = (figures.power - calm.power) / np.sqrt(growth)
    square = np.einsum("kn,nm,km->k", change, np.linalg.inv(memory.rate[_RATE]), change)
    total = np.concatenate([[0.0], np.cumsum(square)])
    first = np.maximum(np.arange(len(square)) + 1 - LAGS[-1], 0)
    found: Array = np.sqrt(np.maximum(total[1:] - total[first], 0.0))
    return found


def cropped(one: Example, most: int) -> Example:
    """Return at most so many windows of an example, a third of them before the onset, in single precision."""
    windows = len(one.state)
    first = int(np.clip(min(one.onset, windows) - most // 3, 0, max(windows - most, 0)))
    part = slice(first, first + most)
    return replace(
        one,
        tokens=one.tokens[part].astype(np.float16),
        state=one.state[part],
        since=one.since[part],
        size=one.size[part],
        fitted=one.fitted[part].astype(np.float32),
        error=one.error[part].astype(np.float32),
        onset=one.onset - first,
    )
