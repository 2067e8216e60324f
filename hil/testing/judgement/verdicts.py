"""Verdicts on limits, and their order: fail before inconclusive before pass."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

Verdict = Literal["pass", "fail", "inconclusive"]
ORDER: tuple[Verdict, ...] = ("pass", "inconclusive", "fail")
"""Verdicts, the best first."""


@dataclass(frozen=True, slots=True)
class Finding:
    """Verdict on one column of a limit, with the measured `value`; `margin` is its distance to the limit.

    `failed_s` are begins and ends of the times at which the limit was broken, s of profile time.
    """

    verdict: Verdict
    text: str
    value: float | None = None
    unit: str = ""
    at_s: float | None = None
    margin: float = 0.0
    failed_s: tuple[tuple[float, float], ...] = ()


def worst(found: Sequence[tuple[Finding, str]]) -> tuple[Finding, str]:
    """Return the worst finding with its column: the worst verdict, then the least margin."""
    return max(found, key=lambda item: (ORDER.index(item[0].verdict), -item[0].margin))


def overall(verdicts: Iterable[Verdict]) -> Verdict:
    """Return the worst of verdicts; inconclusive without any."""
    found = list(verdicts)
    return max(found, key=ORDER.index) if found else "inconclusive"


def shown(value: float, unit: str) -> str:
    """Return a value with its unit as people read it."""
    symbol = {"degC": "°C", "1": ""}.get(unit, unit)
    return f"{value:.4g} {symbol}".rstrip()
