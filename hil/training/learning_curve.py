"""Learning curves of a training as a figure next to its card."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any


def draw(curves: Sequence[dict[str, Any]], path: Path, title: str) -> Path:
    """Write a PNG: losses over steps, errors on unseen windows, learning rate.

    Parameters
    ----------
    curves
        One entry a look, with ``step``, ``loss``, ``rate``, ``parts`` and ``unseen`` (metrics).
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    from twin.calibrators.hiera_unet.training.score import average

    figure = Figure(figsize=(11, 3.6), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    steps = [c["step"] for c in curves]
    left.plot(steps, [c["loss"] for c in curves], label="all", color="black")
    for name in ("data", "parameter", "balance", "laplace"):
        known = [(c["step"], c["parts"][name]) for c in curves if name in c["parts"]]
        if known:
            left.plot(*zip(*known, strict=True), label=name, linewidth=1)
    left.set(title="loss", xlabel="step")
    left.legend(frameon=False, fontsize=8)
    seen = [(c["step"], c["unseen"]) for c in curves if c.get("unseen")]
    at = [step for step, _ in seen]
    if seen:
        middle.axhline(average(seen[-1][1]["mae_before"]), color="0.6", label="commissioned twin")
        middle.axhline(average(seen[-1][1]["mae_evidence"]), color="0.6", linestyle="--", label="Gauss-Newton evidence")
        middle.plot(at, [average(u["mae"]) for _, u in seen], color="C0", label="calibrated, target hidden")
        right.axhline(average(seen[-1][1]["theta_mae_evidence"]), color="0.6", label="Gauss-Newton evidence")
        right.plot(at, [average(u["theta_mae"]) for _, u in seen], color="C3", label="network")
    middle.set(title="error on held-out windows, K", xlabel="step", ylim=(0, None))
    right.set(title="parameter error on held-out windows", xlabel="step", ylim=(0, None))
    for axes in (middle, right):
        axes.legend(frameon=False, fontsize=8)
    for axes in (left, middle, right):
        axes.spines[["top", "right"]].set_visible(False)
    figure.suptitle(title, fontsize=10)
    figure.savefig(path, dpi=110)
    return path
