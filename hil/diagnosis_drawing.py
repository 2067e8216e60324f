"""What the pictures of a diagnosis share: colours, style, the marks of onsets and of the held-out part."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hil.diagnosis_store import Findings

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's palette: told apart without red-green vision.
ORANGE, SKY, GREEN, BLUE, RED, GREY, DARK = "#E69F00", "#56B4E9", "#009E73", "#0072B2", "#D55E00", "#8a9099", "#30343a"
BAND = "#cfd6dd"
_WIDTH = 10.4
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
}


def figure_of(height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(_WIDTH, height), layout="constrained")


def marks(axes: Axes, findings: Findings) -> None:
    """Onsets as dashed lines, the held-out part shaded."""
    low, high = (s / 3600.0 for s in findings.document["error"]["held_out_s"])
    axes.axvspan(low, high, facecolor="#f1f3f5", edgecolor="none", zorder=0)
    begin = findings.curves.time_s[0] / 3600.0
    for effect in findings.document["effects"]:
        onset = effect["onset_s"] / 3600.0
        if onset > begin + 1e-6:
            axes.axvline(onset, color=DARK, linewidth=1.0, linestyle=(0, (4, 3)))
    axes.set_xlim(begin, max(high, findings.curves.time_s[-1] / 3600.0))


def marks_legend(findings: Findings) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    begin = findings.curves.time_s[0]
    found: list[Any] = []
    if any(e["onset_s"] > begin for e in findings.document["effects"]):
        found.append(Line2D([], [], color=DARK, linewidth=1.0, linestyle=(0, (4, 3)), label="onset"))
    found.append(Patch(facecolor="#e6e9ec", edgecolor="none", label="held out of the fit"))
    return found
