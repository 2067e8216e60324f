"""Figures of a diagnosis as SVG: residuals, unknown inputs, evidence, explanations, errors, parameters."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.diagnosis.page.figure_style import (
    BAND,
    BLUE,
    DARK,
    GREY,
    ORANGE,
    RED,
    SKY,
    STYLE,
    axis_of,
    few_decades,
    figure_of,
    log_axis,
    marks,
    marks_legend,
    no_ticks,
)
from hil.diagnosis.store import Findings, Unknown
from hil.diagnosis.wording import after_label, ambiguity_group, at_rest, grown, plain, short

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST_TUNABLES = 18
_MOST_OTHERS = 9
_LEAST_K = 1e-4


def pictures(findings: Findings) -> dict[str, str]:
    """Return SVG text by name, for the figures that the diagnosis has data for."""
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    makers = {
        "residuals": _residuals,
        "unknowns": _unknowns,
        "blocks": _blocks,
        "ladder": _ladder,
        "others": _others,
        "errors": _errors,
        "tunables": _tunables,
    }
    drawn = {}
    for name, make in makers.items():
        style: dict[Any, Any] = {**STYLE, "svg.hashsalt": name}
        with matplotlib.rc_context(style):
            figure = make(findings)
            if figure is not None:
                buffer = io.StringIO()
                # `savefig` does the same, but draws everything once more before.
                FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None, "Creator": None})
                drawn[name] = buffer.getvalue()
    return drawn


def _residuals(findings: Findings) -> Figure | None:
    """Draw measured minus twin over time, per sensor, before and after the effects."""
    curves, label = findings.curves, after_label(findings.document)
    sensors = list(curves.residual)
    unit, along = axis_of(findings)
    times, points = curves.time_s / unit, _points(findings)
    band_label = "noise (±2σ)" if grown(findings.document) else "healthy (±2σ)"
    figure = figure_of(1.5 * len(sensors) + 0.9)
    grid = figure.subplots(len(sensors), 2, sharex=True, squeeze=False, gridspec_kw={"width_ratios": [1.25, 1.0]})
    for row, sensor in zip(grid, sensors, strict=True):
        band = 2.0 * curves.band[sensor]
        for axes in row:
            marks(axes, findings)
            axes.axhspan(-band, band, facecolor=BAND, edgecolor="none", label=band_label, zorder=1)
            axes.axhline(0.0, color=DARK, linewidth=0.6)
        row[0].plot(times, curves.residual[sensor], color=RED, linewidth=1.3, label="baseline twin", **points)
        row[0].plot(times, curves.after[sensor], color=BLUE, linewidth=1.3, label=label, **points)
        row[1].plot(times, curves.after[sensor], color=BLUE, linewidth=1.1, **points)
        good = curves.after[sensor][np.isfinite(curves.after[sensor])]
        reach = 1.15 * max(1.5 * band, float(np.abs(good).max()) if good.size else 0.0)
        row[1].set_ylim(-reach, reach)
        row[0].set_ylabel(f"{short(sensor)}, K")
    grid[0, 0].set_title("measured − twin")
    grid[0, 1].set_title(f"{label}, enlarged")
    for axes in grid[-1]:
        axes.set_xlabel(along)
    handles, _ = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles=[*handles, *marks_legend(findings)], loc="outside upper center", ncols=6)
    return figure


def _points(findings: Findings) -> dict[str, Any]:
    """Return the style of steady states as points without lines."""
    return {"marker": "o", "markersize": 3.5, "linestyle": "none"} if at_rest(findings.document) else {}


def _unknowns(findings: Findings) -> Figure | None:
    """Draw the unknown quantity at each place that alone would explain the record."""
    unknowns = findings.curves.unknowns
    if not unknowns:
        return None
    unit, along = axis_of(findings)
    rows = -(-len(unknowns) // 2)
    figure = figure_of(1.5 * rows + 0.9)
    grid = figure.subplots(rows, 2, sharex=True, squeeze=False)
    likeliest = unknowns[0] if findings.document["effects"] else None
    for axes, one in zip(grid.flat, unknowns, strict=False):
        _unknown(axes, findings, one, findings.curves.time_s / unit, one is likeliest)
    for axes in grid.flat[len(unknowns) :]:
        axes.set_visible(False)
    for axes in (grid[-1, 0], grid[-1 - len(unknowns) % 2, 1]):
        axes.set_xlabel(along)
        axes.tick_params(labelbottom=True)
    figure.legend(handles=_legend_unknown(findings), loc="outside upper center", ncols=5)
    return figure


def _legend_unknown(findings: Findings) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    return [
        Line2D([], [], color=BLUE, linewidth=1.6, label="likeliest place"),
        Line2D([], [], color=GREY, linewidth=1.3, label="other place"),
        Patch(facecolor=BAND, edgecolor="none", label="±2σ"),
        *marks_legend(findings),
    ]


def _unknown(axes: Axes, findings: Findings, unknown: Unknown, hours: np.ndarray, best: bool) -> None:
    """Draw the course of one unknown quantity with its band of two standard deviations."""
    marks(axes, findings)
    colour = BLUE if best else GREY
    low, high = unknown.mean - 2.0 * unknown.sd, unknown.mean + 2.0 * unknown.sd
    axes.fill_between(hours, low, high, facecolor=SKY if best else BAND, edgecolor="none", alpha=0.45 if best else 0.8)
    axes.plot(hours, unknown.mean, color=colour, linewidth=1.6 if best else 1.2)
    axes.axhline(0.0, color=DARK, linewidth=0.6)
    behind = findings.curves.unknowns[0].log_evidence - unknown.log_evidence
    note = "explains the record best" if behind == 0.0 else f"log evidence {behind:,.0f} lower"
    power = unknown.unit == "W"
    site = (unknown.site if power else short(unknown.site)).replace("_", " ")
    unit = unknown.unit if len(unknown.unit) < 8 else "share"
    axes.set_ylabel(unit)
    what = f"power at {site}" if power else f"error of {site}" if unknown.unit == "K" else site
    axes.set_title(what, fontsize=9, pad=3.0)
    axes.set_title(note, loc="right", fontsize=8, fontweight="normal", color=DARK, pad=3.0)
    spread = float(np.median(unknown.sd)) if unknown.sd.size else 0.0
    bottom, top = float(unknown.mean.min()) - 2.2 * spread, float(unknown.mean.max()) + 2.2 * spread
    room = 0.25 * (max(top, 0.0) - min(bottom, 0.0))
    axes.set_ylim(min(bottom, -0.2 * room), max(top, 0.0) + room)


def _blocks(findings: Findings) -> Figure | None:
    """Draw the gain of the effects in each cross-validation fold."""
    blocks = [b for b in findings.document.get("left_out") or () if b["gain"] is not None]
    if not blocks:
        return None
    figure = figure_of(2.0)
    axes = figure.subplots()
    marks(axes, findings)
    gains = np.array([b["gain"] for b in blocks])
    unit, along = axis_of(findings)
    low, high = (np.array([b[key] for b in blocks]) / unit for key in ("first_s", "last_s"))
    colours = [BLUE if g > 0.0 else RED for g in gains]
    wide = high - low + 0.7 if at_rest(findings.document) else 0.97 * (high - low)
    axes.bar(0.5 * (low + high), gains, width=wide, color=colours, zorder=2)
    axes.axhline(0.0, color=DARK, linewidth=0.6)
    reach = float(np.abs(gains).max())
    if reach > 30.0 * max(float(np.abs(gains).min()), 10.0):
        axes.set_yscale("symlog", linthresh=10.0)
        axes.yaxis.set_major_locator(few_decades(reach))
        axes.yaxis.set_minor_locator(no_ticks())
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set_ylim(-12.0 * reach if gains.min() < -10.0 else min(-3.0, 3.0 * gains.min()), 12.0 * reach)
    else:
        axes.set_ylim(min(0.0, 1.5 * gains.min()) - 0.02 * reach, 1.35 * max(gains.max(), 0.0) + 0.02 * reach)
    for x, gain in zip(0.5 * (low + high), gains, strict=True):
        axes.annotate(
            f"{gain:+,.0f}",
            (x, gain),
            xytext=(0, 3 if gain > 0.0 else -3),
            textcoords="offset points",
            ha="center",
            va="bottom" if gain > 0.0 else "top",
            fontsize=9 if len(gains) < 8 else 8,
            bbox={"boxstyle": "round,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
        )
    axes.set_ylabel("gain in the fold")
    axes.set_xlabel(along)
    return figure


def _ladder(findings: Findings) -> Figure | None:
    """Draw the remaining misfit with each added effect, and the score of the best next one."""
    rungs = findings.document["ladder"]
    if not rungs:
        return None
    figure = figure_of(0.5 * len(rungs) + 1.3)
    left, right = figure.subplots(1, 2, sharey=True)
    names = [_folded(r["twin"].replace("_", " ").replace(" + ", "\n+ ")) for r in rungs]
    places = np.arange(len(rungs))[::-1]
    colours = [RED, *([BLUE] * (len(rungs) - 1))]
    _bars(left, places, [r["misfit"] for r in rungs], colours, "{:.3g}")
    _bars(right, places, [r["best_next_z"] for r in rungs], colours, "{:.3g}")
    left.set_yticks(places, names)
    left.axvline(1.0, color=DARK, linewidth=1.0, linestyle=":")
    left.set_xlabel("remaining misfit (chi² per block and sensor; dotted: 1, noise alone)")
    limit = findings.document.get("threshold")
    if limit is not None:
        right.axvline(limit, color=DARK, linewidth=1.0, linestyle=":")
    below = f" (dotted: threshold {limit:.1f})" if limit is not None else ""
    right.set_xlabel(f"score z of the best next effect{below}")
    for axes in (left, right):
        axes.grid(axis="y", visible=False)
        axes.xaxis.label.set_size(8)
    return figure


def _folded(text: str, width: int = 34) -> str:
    import textwrap

    return "\n".join("\n".join(textwrap.wrap(line, width)) for line in text.splitlines())


def _bars(axes: Axes, places: np.ndarray, values: list[float | None], colours: list[str], form: str) -> None:
    """Draw horizontal bars on a log axis, each with its value."""
    shown = np.array([max(v if v is not None else 0.0, 1e-3) for v in values])
    low, high = (
        10.0 ** np.floor(np.log10(min(shown.min(), 0.9))),
        10.0 ** np.ceil(np.log10(max(shown.max(), 2.0)) + 0.5),
    )
    axes.barh(places, shown - low, left=low, height=0.55, color=colours)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlim(low, high)
    for place, x, value in zip(places, shown, values, strict=True):
        text = "none" if value is None else form.format(value)
        axes.annotate(text, (x, place), xytext=(4, 0), textcoords="offset points", va="center", fontsize=9)


def _others(findings: Findings) -> Figure | None:
    """Draw the confidence of the answer and of its alternatives, with the reasons for rejection."""
    document = findings.document
    rows: list[tuple[str, float, str, str]] = []
    for e in document["effects"]:
        role = (
            "the answer"
            if document["verdict"] != "unexplained"
            else "place of the unknown input; no effect has this form"
        )
        rows.append((plain(e), float(e["confidence"] or 0.0), role, BLUE))
    for a in ambiguity_group(document):
        rows.append(
            (plain(a), float(a["confidence"] or 0.0), "not distinguishable from the answer in this record", ORANGE)
        )
    for a in document["alternatives"][: max(_MOST_OTHERS - len(rows), 3)]:
        rows.append((plain(a), float(a["confidence"] or 0.0), a["why_not"], GREY))
    if not rows:
        return None
    figure = figure_of(0.33 * len(rows) + 0.8)
    axes = figure.subplots()
    places = np.arange(len(rows))[::-1]
    axes.barh(places, [100.0 * r[1] for r in rows], height=0.6, color=[r[3] for r in rows])
    axes.set_yticks(places, [r[0] for r in rows])
    axes.set_xlim(0.0, 200.0)
    axes.set_xticks(range(0, 101, 20))
    axes.grid(axis="y", visible=False)
    axes.set_xlabel("confidence, %", loc="left")
    for place, (_, share, why, _) in zip(places, rows, strict=True):
        percent = f"{100.0 * share:.0f} %" if share >= 0.005 or share == 0.0 else "< 1 %"
        axes.annotate(
            f"{percent}   {why}",
            (100.0 * share, place),
            xytext=(5, 0),
            textcoords="offset points",
            va="center",
            fontsize=8.5,
        )
    return figure


def _errors(findings: Findings) -> Figure | None:
    """Draw the held-out errors of each sensor: baseline twin, re-tuned, with the effects, and noise."""
    sensors = findings.document["error"]["sensors"]
    if not sensors:
        return None
    last = after_label(findings.document)
    kinds = [
        ("stale", "baseline twin", RED, "D"),
        ("before", "re-tuned", ORANGE, "s"),
        ("after", last, BLUE, "o"),
        ("noise", "noise", DARK, "|"),
    ]
    if last == "re-tuned":
        kinds = [kinds[0], kinds[2], kinds[3]]
    figure = figure_of(0.42 * len(sensors) + 1.5)
    raw, means = figure.subplots(1, 2, sharey=True, sharex=True)
    means.set_visible(not at_rest(findings.document))
    places = np.arange(len(sensors))[::-1]
    for axes, title in (
        (raw, "steady states" if at_rest(findings.document) else "every sample"),
        (means, "means of ten seconds"),
    ):
        for key, label, colour, marker in kinds:
            cells = [e if axes is raw else e["ten_second_means"] for e in sensors.values()]
            values = np.array([_number(c.get(key)) for c in cells])
            if not np.isfinite(values).any():
                continue
            big = 150.0 if marker == "|" else 46.0
            axes.scatter(values, places, s=big, color=colour, marker=marker, label=label, zorder=3, linewidths=1.6)
        for place, cell in zip(places, cells, strict=True):
            reach = [cell[key] for key, *_ in kinds if cell.get(key) is not None and key != "noise"]
            if reach:
                low, high = _number(min(reach)), _number(max(reach))
                axes.hlines(place, low, high, color=BAND, linewidth=2.0, zorder=1)
        axes.set_title(title)
        axes.set_xlabel("RMSE, K (log)")
        axes.set_ylim(-0.6, len(sensors) - 0.4)
    log_axis(raw)
    raw.set_yticks(places, [short(name) for name in sensors])
    figure.legend(*raw.get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure


def _number(value: float | None) -> float:
    return float("nan") if value is None else max(float(value), _LEAST_K)


def _tunables(findings: Findings) -> Figure | None:
    """Draw the changes of the tunables, in standard deviations of commissioning."""
    moved = [m for m in findings.document["tunables_moved"] if m["before_sd"] is not None and m["after_sd"] is not None]
    if not moved:
        return None
    moved.sort(key=lambda m: -max(abs(m["before_sd"]), abs(m["after_sd"])))
    left_out = len(moved) - _MOST_TUNABLES
    moved = moved[:_MOST_TUNABLES]
    figure = figure_of(0.3 * len(moved) + 1.3)
    axes = figure.subplots()
    places = np.arange(len(moved))[::-1]
    before, after = (np.array([m[key] for m in moved]) for key in ("before_sd", "after_sd"))
    origin_label = "prior" if grown(findings.document) else "as commissioned"
    axes.axvspan(-2.0, 2.0, facecolor=BAND, edgecolor="none", alpha=0.6, label=f"{origin_label}, ±2 sd")
    axes.axvline(0.0, color=DARK, linewidth=0.6)
    axes.scatter(before, places, s=46, color=ORANGE, marker="s", label="re-tuned alone", zorder=3)
    if after_label(findings.document) != "re-tuned":
        axes.hlines(places, before, after, color=GREY, linewidth=1.2, zorder=1)
        axes.scatter(after, places, s=46, color=BLUE, marker="o", label=after_label(findings.document), zorder=3)
    axes.set_yticks(places, [m["parameter"] for m in moved])
    reach = max(float(np.abs([before, after]).max()) * 1.3, 4.0)
    if reach > 12.0:
        axes.set_xscale("symlog", linthresh=4.0)
        ticks = [t for t in (2, 4, 10, 20, 50, 100, 200, 500, 1000) if t <= reach]
        axes.set_xticks([-t for t in reversed(ticks)] + [0] + ticks)
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_locator(no_ticks())
    axes.set_xlim(-reach, reach)
    more = f"; {left_out} with smaller changes are in the table" if left_out > 0 else ""
    origin = (
        "the twin file, in standard deviations"
        if grown(findings.document)
        else "commissioning, in its standard deviations"
    )
    axes.set_xlabel(f"change from {origin}{more}")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure
