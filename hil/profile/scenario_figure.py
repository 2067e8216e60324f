"""Figure of a scenario: heat of each ship system over time, and the other set-points."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers.signals import split_column
from hil.profile.scenario import Scenario, dissipation

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Palette of Okabe and Ito (2008), distinguishable without red-green vision, and in grey by the order of lightness.
_WATER = ("#0072B2", "#56B4E9", "#009E73", "#D55E00", "#CC79A7", "#F0E442")
_AIR = ("#999999", "#DDDDDD", "#BBBBBB")
_DRIVES = ("#333333", "#E69F00", "#0072B2", "#CC79A7")


def picture(scenario: Scenario, path: Path, kind: str = "") -> None:
    """Draw `scenario` into `path`; `kind` is svg or png, by default the path's suffix.

    From above: water-cooled systems stacked, W into the loop, with the declared range; air-cooled ones hatched; the
    other set-points.
    """
    import matplotlib
    from matplotlib.figure import Figure

    times, heat = dissipation(scenario)
    hours = times / 3600.0
    water = [index for index, system in enumerate(scenario.system) if system.cooling == "water"]
    air = [index for index, system in enumerate(scenario.system) if system.cooling == "air"]
    rows = [("water", 3.2), *([("air", 1.0)] if air else []), *([("drives", 1.2)] if scenario.setpoints else [])]
    style: dict[Any, Any] = {
        "font.size": 9,
        "svg.hashsalt": scenario.name,
        "axes.spines.top": False,
        "axes.spines.right": False,
    }
    style |= {"hatch.linewidth": 0.6, "svg.fonttype": "path", "font.family": "DejaVu Sans", "text.parse_math": False}
    with matplotlib.rc_context(style):
        figure = Figure(figsize=(9.6, 1.1 + 1.05 * sum(height for _, height in rows)), layout="constrained")
        axes = figure.subplots(
            len(rows), 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": [height for _, height in rows]}
        )[:, 0]
        panels = dict(zip((row for row, _ in rows), axes, strict=True))
        _stack(panels["water"], scenario, hours, heat, water, _WATER, hatch="")
        _range(panels["water"], scenario, hours, heat[water].sum(axis=0))
        if air:
            _stack(panels["air"], scenario, hours, heat, air, _AIR, hatch="////")
            panels["air"].set_ylabel("into the air, W")
        if scenario.setpoints:
            _drives(panels["drives"], scenario)
        axes[0].set_title(f"{scenario.title or scenario.name}: heat dissipated per system", loc="left", pad=10)
        axes[-1].set_xlabel("time, h")
        axes[-1].set_xlim(0, hours[-1])
        axes[-1].set_xticks(np.arange(0, hours[-1] + 0.01, 1))
        metadata: dict[str, Any] = {"Date": None} if (kind or path.suffix[1:]) == "svg" else {}
        figure.savefig(path, format=kind or path.suffix[1:], dpi=140, metadata=metadata)


def _legend(axes: Axes, title: str) -> None:
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(
        handles[::-1],
        labels[::-1],
        title=title,
        loc="upper left",
        bbox_to_anchor=(1.01, 1.04),
        frameon=False,
        alignment="left",
        borderaxespad=0,
    )


def _stack(
    axes: Axes,
    scenario: Scenario,
    hours: np.ndarray,
    heat: np.ndarray,
    members: list[int],
    colours: tuple[str, ...],
    hatch: str,
) -> None:
    # Constant loads are at the bottom, so that a step of a varying one does not move everything above it.
    order = sorted(
        members, key=lambda index: (np.ptp(heat[index][:-1]) > 0, scenario.system[index].windows is not None)
    )
    base = np.zeros(len(hours))
    for place, index in enumerate(order):
        top = base + heat[index]
        axes.fill_between(
            hours,
            base,
            top,
            step="post",
            facecolor=colours[place % len(colours)],
            edgecolor="white" if not hatch else "#555555",
            linewidth=0.3,
            hatch=hatch,
            label=scenario.system[index].name,
        )
        base = top
    axes.set_ylim(0, 1.15 * base.max())
    cooling = scenario.system[members[0]].cooling
    _legend(axes, f"{cooling}-cooled")


def _range(axes: Axes, scenario: Scenario, hours: np.ndarray, loop: np.ndarray) -> None:
    low, high = scenario.heat_range_W
    axes.step(hours, loop, where="post", color="#222222", linewidth=1.1)
    for bound in (low, high):
        axes.axhline(bound, color="#222222", linewidth=0.8, linestyle=(0, (4, 3)))
        axes.annotate(
            f"{bound:.0f} W",
            (hours[-1], bound),
            xytext=(-5, 5),
            textcoords="offset points",
            ha="right",
            color="#222222",
            fontsize=8,
            bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
        )
    axes.set_ylim(0, 1.12 * high)
    axes.set_ylabel("into the loop, W")


def _drives(axes: Axes, scenario: Scenario) -> None:
    hours = scenario.duration / 3600.0
    units = set()
    for place, (column, steps) in enumerate(scenario.setpoints.items()):
        name, unit = split_column(column) or (column, "1")
        units.add(unit)
        axes.step(
            [time / 3600.0 for time, _ in steps] + [hours],
            [value for _, value in steps] + [steps[-1][1]],
            where="post",
            color=_DRIVES[place % len(_DRIVES)],
            linewidth=1.6,
            linestyle="-" if place % 2 == 0 else (0, (5, 1.5)),
            label=name.replace("_", " "),
        )
    axes.margins(y=0.12)
    axes.set_ylabel("set-points, " + ", ".join(sorted(units)))
    axes.grid(axis="y", color="#DDDDDD", linewidth=0.6)
    _legend(axes, "set-points")
