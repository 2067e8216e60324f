"""Picture of a cell's calibration over time: outlet error and four deviations with their 90 % bands.

The truth of a simulated station, inspections, maintenance and the changes that the calibration found are drawn where
they are given.
"""

from __future__ import annotations

import csv
import datetime
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.files import replacing
from hil.tower.calibration.truth import TruthColumns
from hil.tower.station import seconds
from twin.tower.calibration import NORMAL

TITLES = {
    "fill": "fill, share of clean",
    "air": "air, share of clean",
    "uniformity": "uniformity, share of clean",
    "bias": "bias of the outlet thermometer, K",
}
FOUND = "calibration"
"""Source of an event that nobody entered and the calibration found; drawn in grey."""
GREY = "#777777"
BLUE, BAND, DARK, ORANGE, GREEN, PINK = "#0072B2", "#bcd7ea", "#30343a", "#E69F00", "#009E73", "#CC79A7"
CAPTION = 160
"""Letters in a line of the caption: as many fit into the width of the picture."""
POINTS = 600
"""Points of a curve: a picture of 1100 pixels shows no more."""


def draw_cell(
    calibrated: TruthColumns,
    path: Path,
    *,
    cell: int,
    truth: TruthColumns | None = None,
    labels: Path | None = None,
    events: Sequence[Mapping[str, Any]] = (),
    network: TruthColumns | None = None,
    remarks: Sequence[str] = (),
) -> None:
    """Draw the calibration of a cell into `path` (.png or .svg), with the curves of a network that was asked.

    Parameters
    ----------
    calibrated
        Columns of the calibration, by day.
    path
        Picture to write.
    cell
        Number of the cell.
    truth
        True deviations of a simulated station, or None.
    labels
        File of tests of the fill, or None.
    events
        Events as in `events.json` of a calibration; those that may move a deviation are marked.
    remarks
        Sentences on contradictions, for the caption.

    Raises
    ------
    OSError
        A file cannot be read or written.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 9.0), layout="constrained")
    axes = figure.subplots(5, 1, sharex=True)
    time = calibrated["time"]
    _outlet(axes[0], calibrated, truth, network)
    for axis, (name, title) in zip(axes[1:], TITLES.items(), strict=True):
        _band(axis, time, calibrated, name)
        if network is not None:
            at, low = _thinned(network["time"], network[f"{name}_lo"])
            high = _thinned(network["time"], network[f"{name}_hi"])[1]
            for edge in (low, high):
                axis.plot(at, edge, color=PINK, linewidth=0.6, linestyle=":")
            axis.plot(
                *_thinned(network["time"], network[name]), color=PINK, linewidth=1.0, label="network, 90 % dotted"
            )
        if truth is not None:
            axis.plot(*_thinned(truth["time"], truth[name]), color=DARK, linewidth=1.2, linestyle="--", label="truth")
        axis.set_title(title, loc="left", fontsize=9)
    if labels is not None:
        _labels(dict(zip(TITLES, axes[1:], strict=True)), labels, cell)
        axes[1].plot([], [], color=ORANGE, linewidth=2.5, label="inspection or measurement")
    first, last = time[0], time[-1]
    for event in events:
        moment = np.datetime64(int(seconds(event["time"]) * 1e3), "ms")
        moved = event["parameters"]
        if event["cell"] not in (0, cell) or not moved or not first <= moment <= last:
            continue
        colour, height = (GREY, 0.02) if event["source"] == FOUND else (GREEN, 1.0)
        for axis, name in zip(axes[1:], TITLES, strict=True):
            if name in moved:
                axis.axvline(moment, color=colour, linewidth=1.0, linestyle=":")
                axis.annotate(
                    event["kind"].replace("_", " "),
                    (moment, height),
                    xycoords=("data", "axes fraction"),
                    fontsize=7,
                    color=colour,
                )
    axes[0].legend(loc="upper right", fontsize=8, frameon=False, ncols=3)
    # Above the axis, since the band has the colour of its own legend.
    axes[1].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False, ncols=4)
    for axis in axes:
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
    caption = [f"Cell {cell}: calibration with 90 % intervals", *(textwrap.fill(one, CAPTION) for one in remarks)]
    figure.suptitle("\n".join(caption), fontsize=11 if len(caption) == 1 else 8)
    with replacing(path) as unfinished:
        figure.savefig(unfinished, dpi=100, format=path.suffix.lstrip(".") or "png")


def _outlet(
    axis: Any, calibrated: TruthColumns, truth: TruthColumns | None, network: TruthColumns | None = None
) -> None:
    """Draw the errors of the outlet against the truth; without one the correction that was made."""
    if truth is None:
        correction = calibrated["t_out"] - calibrated["t_out_commissioned"]
        axis.plot(*_thinned(calibrated["time"], correction), color=BLUE, linewidth=0.9, label="correction")
        if network is not None:
            correction = network["t_out"] - network["t_out_commissioned"]
            axis.plot(*_thinned(network["time"], correction), color=PINK, linewidth=0.9, label="network")
        axis.set_title("outlet: calibrated minus commissioned, K", loc="left", fontsize=9)
        return
    _, mine, its = np.intersect1d(calibrated["time"], truth["time"], return_indices=True)
    for name, colour, label in (("t_out_commissioned", ORANGE, "as commissioned"), ("t_out", BLUE, "calibrated")):
        error = np.where(truth["running"][its], calibrated[name][mine] - truth["t_out"][its], np.nan)
        axis.plot(*_thinned(calibrated["time"][mine], error), color=colour, linewidth=0.9, label=label)
    if network is not None:
        _, mine, its = np.intersect1d(network["time"], truth["time"], return_indices=True)
        error = np.where(truth["running"][its], network["t_out"][mine] - truth["t_out"][its], np.nan)
        axis.plot(*_thinned(network["time"][mine], error), color=PINK, linewidth=0.9, label="network")
    axis.set_title("outlet: error against the truth, K", loc="left", fontsize=9)


def _band(axis: Any, time: NDArray[Any], columns: Mapping[str, NDArray[Any]], name: str) -> None:
    at, low = _thinned(time, columns[f"{name}_lo"])
    axis.fill_between(at, low, _thinned(time, columns[f"{name}_hi"])[1], color=BAND, linewidth=0.0, label="90 %")
    axis.plot(*_thinned(time, columns[name]), color=BLUE, linewidth=1.2, label="calibrated")


def _thinned(time: NDArray[Any], values: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return means of equal parts, at most `POINTS`; a part without a number stays empty."""
    size = max(-(-len(values) // POINTS), 1)
    count = len(values) // size
    parts = np.asarray(values[: count * size], dtype=np.float64).reshape(count, size)
    known = np.isfinite(parts)
    total = np.where(known, parts, 0.0).sum(axis=1)
    mean = np.where(known.any(axis=1), total / np.maximum(known.sum(axis=1), 1), np.nan)
    return time[: count * size : size], mean


def _labels(axes: Mapping[str, Any], path: Path, cell: int) -> None:
    """Draw points and intervals of inspections, traverses and reference thermometers."""
    with path.open(newline="", encoding="utf-8-sig") as file:
        for row in csv.DictReader(file):
            axis = axes.get(row.get("parameter", ""))
            if axis is None or row.get("cell") != str(cell):
                continue
            moment = datetime.datetime.fromisoformat(row["time"].replace("Z", "+00:00")).replace(tzinfo=None)
            if row["kind"] == "point":
                value, spread = float(row["value"]), NORMAL * float(row["sd"])
                low, high = value - spread, value + spread
            else:
                low, high = float(row["lo"]), float(row["hi"])
            axis.plot([moment, moment], [low, high], color=ORANGE, linewidth=2.5, solid_capstyle="butt")
