"""Figures of an explanation as SVG: shares of the explanations by round, and set-points of each experiment."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

from drivers.signals import split_column
from hil.diagnosis import FIGURE_STYLE
from hil.explain.explanation import Experiment, Explanation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Palette of Okabe and Ito (2008), distinguishable without red-green vision.
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442")
OTHERS = "#c3c9cf"
_WIDTH_IN = 10.4


def pictures(explanation: Explanation) -> dict[str, str]:
    """Return the figures by name: `beliefs`, and `experiment-<round>` for each round with steps of its own."""
    import matplotlib as mpl

    with mpl.rc_context({**FIGURE_STYLE, "svg.hashsalt": "explanation"}):
        found = {"beliefs": _beliefs(explanation)} if any(one.beliefs for one in explanation.rounds) else {}
        for one in explanation.rounds:
            if one.ran is not None and one.ran.steps:
                found[f"experiment-{one.number}"] = _experiment(one.ran)
    return found


def _beliefs(explanation: Explanation) -> str:
    """Draw one bar a round, divided by the shares of the explanations."""
    rounds = explanation.rounds
    labels = list(dict.fromkeys(belief.label for one in rounds for belief in one.beliefs))
    figure = _figure(0.9 + 0.42 * len(rounds))
    axes = figure.subplots()
    for row, one in enumerate(rounds):
        left = 0.0
        for belief in one.beliefs:
            share = min(max(belief.share or 0.0, 0.0), max(1.0 - left, 0.0))
            index = labels.index(belief.label)
            colour = COLOURS[index] if index < len(COLOURS) else OTHERS
            axes.barh(row, share, left=left, height=0.62, color=colour, edgecolor="white")
            left += share
    axes.set_yticks(range(len(rounds)), [f"round {one.number}: {one.verdict}" for one in rounds])
    axes.invert_yaxis()
    axes.set_xlim(0.0, 1.0)
    axes.set_xlabel("posterior share")
    axes.grid(axis="y", visible=False)
    handles = [_patch(colour, label) for colour, label in zip(COLOURS, labels, strict=False)]
    handles += [_patch(OTHERS, "others")] if len(labels) > len(COLOURS) else []
    figure.legend(handles=handles, loc="outside lower left", ncols=3)
    return _svg(figure)


def _experiment(experiment: Experiment) -> str:
    """Draw each set-point over the time of the experiment."""
    steps = experiment.steps
    columns = [column for column in steps[0] if column != "time_s"]
    figure = _figure(0.5 + 0.9 * len(columns))
    rows = figure.subplots(len(columns), 1, sharex=True, squeeze=False)[:, 0]
    for axes, column, colour in zip(rows, columns, COLOURS * len(columns), strict=False):
        name, unit = split_column(column) or (column, "")
        axes.step([s["time_s"] / 3600.0 for s in steps], [s[column] for s in steps], where="post", color=colour)
        axes.set_ylabel(f"{name.replace('_', ' ')}\n{unit}")
        axes.margins(y=0.15)
    rows[-1].set_xlabel("time, h")
    return _svg(figure)


def _patch(colour: str, label: str) -> Any:
    from matplotlib.patches import Patch

    return Patch(facecolor=colour, edgecolor="none", label=label)


def _figure(height_in: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(_WIDTH_IN, height_in), layout="constrained")


def _svg(figure: Figure) -> str:
    out = io.StringIO()
    figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    return out.getvalue()
