"""Inputs of a record outside the range of the healthy record, where the healthy rig is unknown."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from twin.discovery.diagnosis import Diagnosis
from twin.discovery.healthy.basis import Columns
from twin.network import InputSpec, Network

BEYOND = 0.5
"""Share of an input's healthy range by which it must exceed that range for a note."""
STEADY = 0.05
"""Share of its declared range that counts as the healthy range of an input that hardly moved."""
BRIEF = (2.0, 98.0)
"""Percentiles that bound an input's range, without short excursions."""


def with_range_notes(found: Diagnosis, network: Network, record: Columns, healthy: Columns | None) -> Diagnosis:
    """Return a diagnosis that claims an effect with a note on each input far beyond its healthy range."""
    if healthy is None or found.verdict == "adequate":
        return found
    return replace(found, notes=(*found.notes, *range_notes(network, record, healthy)))


def range_notes(network: Network, record: Columns, healthy: Columns) -> list[str]:
    """Return a sentence for each input of the record far beyond its range in the healthy record."""
    said = []
    for column, spec, j, limits in _ranges(network, healthy):
        here = record.inputs[np.isfinite(record.inputs[:, j]), j]
        if not here.size:
            continue
        least, most = np.percentile(here, BRIEF)
        below, above = least < limits.least, most > limits.most
        if not below and not above:
            continue
        name, unit = column.rsplit("_", 1)[0], f" {spec.unit}" if spec.unit not in ("", "1") else ""
        was = _between(limits.low, limits.high)
        now = (
            _between(least, most) if below and above else f"up to {_said(most)}" if above else f"down to {_said(least)}"
        )
        said.append(
            f"{name} was {was}{unit} in the healthy record and {now}{unit} here: what only shows there may always have "
            "been so"
        )
    return said


class _Limits(NamedTuple):
    """Range of an input in health, and the limits beyond which it is far from it."""

    low: float
    high: float
    least: float
    most: float


def _ranges(network: Network, healthy: Columns) -> Iterator[tuple[str, InputSpec, int, _Limits]]:
    """Yield each input but the time of day, its column and its limits.

    A temperature acts by its difference from those of the rig, whose range in health counts as its own.
    """
    spans = [np.ptp(np.percentile(y[np.isfinite(y)], BRIEF)) for y in healthy.measured.T if np.isfinite(y).any()]
    of_rig = float(max(spans, default=0.0))
    for j, (column, spec) in enumerate(network.inputs.items()):
        then = healthy.inputs[np.isfinite(healthy.inputs[:, j]), j]
        if column.startswith("time_of_day") or not then.size:
            continue
        low, high = (float(x) for x in np.percentile(then, BRIEF))
        room = BEYOND * max(high - low, STEADY * _width(spec), of_rig if column.endswith("_C") else 0.0)
        yield column, spec, j, _Limits(low, high, low - room, high + room)


def _width(spec: InputSpec) -> float:
    width = spec.upper - spec.lower
    return width if np.isfinite(width) else abs(spec.nominal)


def _between(low: float, high: float) -> str:
    return _said(low) if _said(low) == _said(high) else f"{_said(low)} to {_said(high)}"


def _said(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"
