"""Plots of a page that zoom without a network: curves as data, drawn by the script of `hil.report.plot_script`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.files import Html, element, joined, plot_data
from hil.report.limit_lines import LimitLine
from hil.report.statistics import TimeUnit

MOST_POINTS = 4000
"""Most points of a curve: a plot shows the least and the greatest value of each piece of it."""
PLOT_STYLE = """
canvas { width: 100%; height: 220px; touch-action: pan-y; cursor: crosshair }
.plotbox canvas { color: #30343a; outline-color: #d8dce0; caret-color: #5b636b; border-top-color: #b3261e }
@media screen and (prefers-color-scheme: dark) {
.plotbox canvas { color: #d9dee4; outline-color: #3a4149; caret-color: #9aa4ae; border-top-color: #ff8a80 }
}
h3 { font-size: 1rem; margin-bottom: .2rem } .plotbox p { min-height: 1.3em; margin: .2rem 0 }
"""
"""Style of the plots, beside that of their page."""
SECONDS = TimeUnit("s", 1.0)
HINT = "Drag to zoom, turn the wheel, double-click for all."


@dataclass(frozen=True, slots=True)
class ZoomCurve:
    """Curve of a plot: values (n,) at `time_s` (n,), NaN for a gap."""

    name: str
    colour: str
    time_s: NDArray[np.float64]
    values: NDArray[np.float64]


def zoom_plot(
    title: str,
    curves: Sequence[ZoomCurve],
    end_s: float,
    unit: TimeUnit = SECONDS,
    limits: Sequence[LimitLine] = (),
) -> Html:
    """Return a heading and a plot of curves over time; the page needs `SCRIPT` and `PLOT_STYLE`.

    Parameters
    ----------
    title, curves
        Heading, and curves with times in s.
    end_s
        End of the axis, s; it begins at 0.
    unit
        Unit of the axis and of readings of the time.
    limits
        Lines across the curves.
    """
    series = []
    for curve in curves:
        time_s, values = thinned(curve.time_s, curve.values)
        y = [float(f"{value:.6g}") if np.isfinite(value) else None for value in values.tolist()]
        series.append({"name": curve.name, "colour": curve.colour, "x": (time_s / unit.seconds).tolist(), "y": y})
    data: dict[str, Any] = {
        "title": title,
        "unit": unit.symbol,
        "range": [0.0, max(end_s / unit.seconds, 1e-9)],
        "series": series,
    }
    data["limits"] = [
        {
            "name": line.name,
            "colour": line.colour,
            "levels": line.levels,
            "x": [line.from_s / unit.seconds, line.to_s / unit.seconds],
            "failed": [[begin / unit.seconds, end / unit.seconds] for begin, end in line.failed_s],
        }
        for line in limits
    ]
    return joined([element("h3", title), plot_data(data)])


def thinned(
    time_s: NDArray[np.float64], values: NDArray[np.float64], most: int = MOST_POINTS
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return times (m,) and values (m,) of at most `most` points of a curve (n,): least and greatest of each piece.

    A piece with a missing value also keeps that, as a gap.
    """
    if len(time_s) <= most:
        return time_s, values
    pieces = np.array_split(np.arange(len(time_s)), most // 3 - 1)  # three points of each, and the two ends
    begin = np.array([piece[0] for piece in pieces])[:, None]
    end = np.array([piece[-1] for piece in pieces])[:, None]
    at = np.minimum(begin + np.arange(len(pieces[0])), end)  # a shorter piece repeats its last row
    x = values[at]
    known = np.isfinite(x)
    some = known.any(axis=1)
    least = np.where(np.isnan(x), np.inf, x).argmin(axis=1)
    greatest = np.where(np.isnan(x), -np.inf, x).argmax(axis=1)
    gap = known.argmin(axis=1)
    first = begin[:, 0]
    rows = np.unique(
        np.concatenate(
            [
                [0, len(time_s) - 1],
                (first + least)[some],
                (first + greatest)[some],
                (first + gap)[~known.all(axis=1)],
            ]
        )
    )
    return time_s[rows], values[rows]
