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
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#D55E00")
_WIDTH_IN = 10.4


def pictures(explanation: Explanation) -> dict[str, str]:
    """Return the figures by name: `beliefs`, and `experiment-<round>` for each round with steps of its own."""
    import matplotlib as mpl

    style: dict[Any, Any] = {**FIGURE_STYLE, "svg.hashsalt": "explanation"}
    with mpl.rc_context(style):
        found = {"beliefs": _beliefs(explanation)} if any(one.beliefs for one in explanation.rounds) else {}
        for one in explanation.rounds:
            if one.ran is not None and one.ran.steps:
                found[f"experiment-{one.number}"] = _experiment(one.ran)
    return found


def _beliefs(explanation: Explanation) -> str:
    """Draw the share of each explanation, one bar a round: with several effects the shares do not add up to 1."""
    rounds = explanation.rounds
    labels = list(dict.fromkeys(belief.label for one in rounds for belief in one.beliefs))
    height = 0.8 / len(rounds)
    figure = _figure(0.9 + 0.2 * len(labels) * (1 + len(rounds)))
    axes = figure.subplots()
    for number, one in enumerate(rounds):
        shares = {belief.label: belief.share or 0.0 for belief in one.beliefs}
        rows = [row + height * (number - 0.5 * (len(rounds) - 1)) for row in range(len(labels))]
        # Earlier rounds are paler.
        shade = (number + 1.0) / len(rounds)
        label = f"round {one.number}: {one.verdict}"
        bars = [shares.get(name, 0.0) for name in labels]
        axes.barh(rows, bars, height=0.9 * height, color=COLOURS[0], alpha=0.25 + 0.75 * shade**2, label=label)
    axes.set_yticks(range(len(labels)), labels)
    axes.invert_yaxis()
    axes.set_xlim(0.0, 1.0)
    axes.set_xlabel("posterior share")
    axes.grid(axis="y", visible=False)
    figure.legend(loc="outside lower left", ncols=4)
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


def _figure(height_in: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(_WIDTH_IN, height_in), layout="constrained")


def _svg(figure: Figure) -> str:
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    out = io.StringIO()
    # `savefig` does the same, but draws everything once more before.
    FigureCanvasSVG(figure).print_svg(out, metadata={"Date": None, "Creator": None})
    return out.getvalue()
