"""Style of the figures of a diagnosis: colours, fonts, marks of onsets and of the held-out segment."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hil.diagnosis.store import Findings
from hil.diagnosis.wording import at_rest

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Palette of Okabe and Ito (2008), distinguishable without red-green vision.
ORANGE, SKY, GREEN, BLUE, RED, GREY, DARK = "#E69F00", "#56B4E9", "#009E73", "#0072B2", "#D55E00", "#8a9099", "#30343a"
BAND = "#cfd6dd"
_WIDTH = 10.4
SHORT_S = 7200.0
"""Longest record in s with its times in minutes."""
STYLE: dict[str, Any] = {
    "font.size": 9,
    "font.family": "DejaVu Sans",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.alpha": 0.25,
    "legend.frameon": False,
    "svg.fonttype": "path",
    "text.parse_math": False,  # A $ in a user's name is a $.
}


def figure_of(height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(_WIDTH, height), layout="constrained")


def axis_of(findings: Findings) -> tuple[float, str]:
    """Return the unit of the time axis in s, and its label; steady states are plotted by their numbers."""
    if at_rest(findings.document):
        return 1.0, "number of the steady state"
    return (3600.0, "time, h") if findings.curves.time_s[-1] > SHORT_S else (60.0, "time, min")


def marks(axes: Axes, findings: Findings) -> None:
    """Mark onsets as dashed lines, and shade the held-out segment."""
    unit, _ = axis_of(findings)
    low, high = (s / unit for s in findings.document["error"]["held_out_s"])
    begin, end = findings.curves.time_s[[0, -1]] / unit
    if at_rest(findings.document):
        axes.set_xlim(begin - 0.5, end + 0.5)
        return
    axes.axvspan(low, high, facecolor="#f1f3f5", edgecolor="none", zorder=0)
    for effect in findings.document["effects"]:
        onset = effect["onset_s"] / unit
        if onset > begin + 1e-6:
            axes.axvline(onset, color=DARK, linewidth=1.0, linestyle=(0, (4, 3)))
    axes.set_xlim(begin, max(high, end))


def marks_legend(findings: Findings) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    begin = findings.curves.time_s[0]
    found: list[Any] = []
    if any(e["onset_s"] > begin + 1e-6 for e in findings.document["effects"]):
        found.append(Line2D([], [], color=DARK, linewidth=1.0, linestyle=(0, (4, 3)), label="onset"))
    if not at_rest(findings.document):
        found.append(Patch(facecolor="#e6e9ec", edgecolor="none", label="held out of the fit"))
    return found


def log_axis(axes: Axes) -> None:
    """Set a log axis of at least a decade with plain numbers."""
    from matplotlib.ticker import LogLocator, NullLocator

    axes.set_xscale("log")
    low, high = axes.get_xlim()
    widen = max(np.sqrt(10.0 / (high / low)), 1.1)
    for each in axes.get_shared_x_axes().get_siblings(axes):
        each.set_xlim(low / widen, high * widen)
        each.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0) if high / low > 30.0 else (1.0, 2.0, 5.0)))
        each.xaxis.set_major_formatter("{x:g}")
        each.xaxis.set_minor_locator(NullLocator())


def few_decades(reach: float) -> Any:
    """Return ticks at a few powers of ten on both sides of zero, for values up to `reach`."""
    from matplotlib.ticker import FixedLocator

    top = int(np.floor(np.log10(reach)))
    each = [10.0**k for k in range(1, top + 1, max((top + 1) // 3, 1))]
    return FixedLocator([-x for x in reversed(each)] + [0.0] + each)


def no_ticks() -> Any:
    """Return a locator without minor ticks."""
    from matplotlib.ticker import NullLocator

    return NullLocator()
