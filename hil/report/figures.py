"""Figures of a report: twins against measurements, every other signal by unit, set-points and read-backs."""

from __future__ import annotations

import io
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.files import Html, element, image, joined
from hil.journal import Header, JournalSamples
from hil.report.actuators import pair_actuators
from hil.report.limit_lines import LimitLine, levels_in_reach, of_columns
from hil.report.statistics import TimeUnit, good_values, symbol
from hil.report.zoom import HINT, ZoomCurve, zoom_plot

MEASURED, STATIC = "#30343a", "#e07b1f"
TRACKED = ("#1f77c9", "#2a9d6f", "#8a4fbf", "#b03a5b")
_OTHERS = ("#a8322a", "#1f77c9", "#2a9d6f", "#b8860b", "#8a4fbf", "#0f8b8d", "#b03a5b", "#6b705c", "#e07b1f", "#30343a")
_MOST_CURVES = 8
"""Most curves of a plot: fewer than there are colours, and their names fit beside it."""
_LONGEST_LABEL = 40
"""Most characters of a name beside a figure, a third of its width; the tables have the whole name."""
_MOST_POINTS = 4000
"""Most points of a curve: a figure of 1200 pixels shows no more."""
_DPI = 110
"""Resolution of a figure, dots an inch: 11 inches are 1210 pixels."""
_GRID_ALPHA = 0.25
_PAD_IN, _TIME_AXIS_IN, _LEFT_IN = 0.1, 0.5, 0.7
"""Margins of a figure in inches: beside texts and between rows, below the last row for the labels of the time axis, and
for labels on the left until they are measured.
"""
_MEAN_OVER_S = 300.0
"""Longest averaging time of residuals in s; a run shorter than 100 minutes has means over a twentieth."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Curve:
    label: str
    values: Floats
    colour: str
    width: float = 0.9
    above: int = 2
    dashed: bool = False


@dataclass(frozen=True, slots=True)
class _Plot:
    title: str
    curves: tuple[_Curve, ...]
    height: float = 2.2
    own_legend: bool = True
    columns: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class RunCurves:
    """Data of the figures: samples of a run, `measured` by twin sensor (n,), `twins` by name (n, m), and the first rows
    after each interruption. `limits` are those of test plans.
    """

    header: Header
    samples: JournalSamples
    measured: Mapping[str, Floats]
    twins: Mapping[str, Floats]
    cuts: NDArray[np.int64]
    unit: TimeUnit
    limits: tuple[LimitLine, ...] = ()


def pictures(drawn: RunCurves) -> Html:
    """Return headings and figures as HTML; nothing for a run of fewer than two ticks, no plot without a value."""
    if len(drawn.samples.tick) < 2:
        return joined([])
    import matplotlib

    with matplotlib.rc_context({"text.parse_math": False}):  # A $ in a user's name is a $.
        return joined(_pictures(drawn))


def _pictures(drawn: RunCurves) -> Iterator[Html]:
    if drawn.measured:
        yield _picture("Measured against twin", _against_twin(drawn), drawn)
        residuals, width_s = _residuals(drawn)
        length = f"{width_s / 60:.0f} min" if width_s >= 60 else f"{width_s:g} s"
        yield _picture(f"Residual (measured - twin), means of {length}", residuals[1], drawn, residuals[0])
    yield _picture("Signals", _others(drawn), drawn)
    yield _picture("Set-points and read-backs", _actuators(drawn), drawn)


def zoom_plots(drawn: RunCurves) -> Html:
    """Return the same curves, except residuals, as plots that zoom; nothing for a run of fewer than two ticks."""
    time_s = drawn.samples.time_s
    if len(time_s) < 2:
        return joined([])
    groups = [_against_twin(drawn) if drawn.measured else iter(()), _others(drawn), _actuators(drawn)]
    parts = [
        element("h2", f"Curves that zoom, over record time / {drawn.unit.symbol}"),
        element("p", HINT, class_="note"),
    ]
    for plot in itertools.chain(*groups):
        curves = [ZoomCurve(curve.label, curve.colour, time_s, curve.values) for curve in plot.curves]
        limits = of_columns(drawn.limits, plot.columns)
        parts.append(zoom_plot(plot.title, curves, float(time_s[-1]), drawn.unit, limits))
    return element("div", joined(parts), class_="screen")  # paper has the figures


def twin_colours(names: Sequence[str]) -> dict[str, str]:
    """Return a colour for every twin: orange for the static one, the palette in turn for the tracked ones."""
    tracked = [name for name in names if name != "static"]
    return {"static": STATIC} | {name: TRACKED[k % len(TRACKED)] for k, name in enumerate(tracked)}


def _against_twin(drawn: RunCurves) -> Iterator[_Plot]:
    colours = twin_colours(tuple(drawn.twins))
    for position, (sensor, values) in enumerate(drawn.measured.items()):
        # The measured curve is thin and on top, so that those below it are seen beside it.
        curves = [
            _Curve(name, outputs[:, position], colours[name], max(2.4 - 0.5 * k, 1.0))
            for k, (name, outputs) in enumerate(drawn.twins.items())
        ]
        curves.append(_Curve("measured", values, MEASURED, 0.7, above=5))
        yield _Plot(
            f"{sensor.removesuffix('_C')} / °C", tuple(curves), 2.6, False, frozenset(drawn.header.twin_sensors[sensor])
        )


def _residuals(drawn: RunCurves) -> tuple[tuple[Floats, list[_Plot]], float]:
    """Return the time (b,) and plots of mean residuals, and their averaging time in s."""
    time_s, period_s = drawn.samples.time_s, drawn.header.period_s
    width_s = min(_MEAN_OVER_S, period_s * max(1.0, np.ceil((time_s[-1] - time_s[0]) / 20.0 / period_s)))
    part = np.floor((time_s - time_s[0]) / width_s).astype(np.int64)
    # An interruption ends a mean: the rows on both sides of a gap are of different states of the rig.
    part += np.searchsorted(drawn.cuts, np.arange(len(part)), side="right")
    kept, where = np.unique(part, return_inverse=True)
    middle = np.bincount(where, weights=time_s) / np.bincount(where)
    # A gap is a break in the curve, drawn as an empty part.
    breaks = np.flatnonzero(np.diff(middle) > 2.5 * width_s) + 1
    colours, plots = twin_colours(tuple(drawn.twins)), []
    for position, (sensor, values) in enumerate(drawn.measured.items()):
        curves = []
        for name, outputs in drawn.twins.items():
            off = values - outputs[:, position]
            good = np.isfinite(off)
            count = np.bincount(where[good], minlength=len(kept))
            total = np.bincount(where[good], weights=off[good], minlength=len(kept))
            mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
            curves.append(_Curve(name, np.insert(mean, breaks, np.nan), colours[name], 1.1))
        plots.append(_Plot(f"{sensor.removesuffix('_C')} / K", tuple(curves), 1.7, own_legend=False))
    return (np.insert(middle, breaks, middle[breaks] - width_s), plots), float(width_s)


def _others(drawn: RunCurves) -> Iterator[_Plot]:
    """Yield measured signals without a twin or a set-point of their own, by unit, at most `_MOST_CURVES` in a plot."""
    values = good_values(drawn.samples)
    told = {column for columns in drawn.header.twin_sensors.values() for column in columns} if drawn.measured else set()
    told |= {signal.column for pair in pair_actuators(drawn.header.signals).values() for signal in pair}
    units: dict[str, list[_Curve]] = {}
    columns = {signal.name: signal.column for signal in drawn.header.signals}
    for k, signal in enumerate(drawn.header.signals):
        if signal.kind == "measured" and signal.column not in told:
            group = units.setdefault(signal.unit, [])
            group.append(_Curve(signal.name, values[:, k], _OTHERS[len(group) % _MOST_CURVES]))
    for unit, group in units.items():
        for first in range(0, len(group), _MOST_CURVES):
            curves = tuple(group[first : first + _MOST_CURVES])
            shown = frozenset(columns[curve.label] for curve in curves)
            yield _Plot(symbol(unit), curves, 2.6 if len(curves) > 4 else 2.0, columns=shown)


def _actuators(drawn: RunCurves) -> Iterator[_Plot]:
    """Yield every set-point with its read-back, a plot for each."""
    values = good_values(drawn.samples)
    index = {signal.name: k for k, signal in enumerate(drawn.header.signals)}
    for number, (stem, pair) in enumerate(pair_actuators(drawn.header.signals).items()):
        colour = _OTHERS[number % len(_OTHERS)]
        curves = [_Curve("set", values[:, index[pair[0].name]], MEASURED, 1.6, dashed=True)]
        curves += [_Curve("read", values[:, index[read.name]], colour, 0.9, above=3) for read in pair[1:]]
        unit = symbol(pair[0].unit)
        shown = frozenset(signal.column for signal in pair)
        yield _Plot(f"{stem} / {unit}" if unit else stem, tuple(curves), 1.6, columns=shown)


def _picture(heading: str, plots: Any, drawn: RunCurves, time_s: Floats | None = None) -> Html:
    """Return stacked plots with one time axis, as HTML; nothing if none has a value."""
    known = []
    for plot in plots:
        curves = tuple(curve for curve in plot.curves if np.isfinite(curve.values).any())
        if curves:
            known.append((plot, curves))
    if not known:
        return joined([])
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, sum(plot.height for plot, _ in known) + 0.8), dpi=_DPI)
    ratios = [plot.height for plot, _ in known]
    rows = np.atleast_1d(figure.subplots(len(known), 1, sharex=True, gridspec_kw={"height_ratios": ratios}))
    for axes, (plot, curves) in zip(rows, known, strict=True):
        for curve in curves:
            at, values = (time_s, curve.values) if time_s is not None else _thinned(drawn, curve.values)
            style = "--" if curve.dashed else "-"
            axes.plot(
                at / drawn.unit.seconds,
                values,
                style,
                color=curve.colour,
                linewidth=curve.width,
                label=_short(curve.label),
                zorder=curve.above,
            )
        if time_s is not None:
            axes.axhline(0, color=MEASURED, linewidth=0.6)
        axes.set_ylabel(plot.title)
        axes.grid(alpha=_GRID_ALPHA)
        _draw_limits(axes, of_columns(drawn.limits, plot.columns), drawn.unit.seconds)
        if plot.own_legend:
            # Outside the axes, so that it covers no curve.
            axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize="small")
    above = None
    if not known[0][0].own_legend:
        drawn_as = [pair for axes in rows for pair in zip(*axes.get_legend_handles_labels(), strict=True)]
        handles = {label: handle for handle, label in drawn_as}
        above = figure.legend(handles.values(), handles, loc="upper right", ncols=6, frameon=False)
    rows[-1].set_xlabel(f"time / {drawn.unit.symbol}")
    _one_time_axis(list(rows))
    _fit(figure, list(rows), above)
    return joined([element("h2", heading), _embedded(figure)])


def _draw_limits(axes: Any, lines: Sequence[LimitLine], unit_s: float) -> None:
    """Draw the lines of limits with their ids, and shade the times of failure; levels far from the curves are named."""
    if not lines:
        return
    low, high = axes.get_ylim()
    near = list(levels_in_reach(lines, low, high))
    for line, level in near:
        begin, end = line.from_s / unit_s, line.to_s / unit_s
        axes.plot([begin, end], [level, level], ":", color=line.colour, linewidth=1.1, zorder=4)
        at = {"xy": (end, level), "xytext": (-2, 2), "textcoords": "offset points"}
        axes.annotate(_short(line.name), **at, ha="right", color=line.colour, fontsize="x-small", zorder=6)
    for line in lines:
        for begin, end in line.failed_s:
            axes.axvspan(begin / unit_s, end / unit_s, color=line.colour, alpha=0.12, linewidth=0, zorder=0)
    shown = {(line.name, level) for line, level in near}
    far = [
        f"{_short(line.name)} {level:g}" for line in lines for level in line.levels if (line.name, level) not in shown
    ]
    if far:
        text = f"beyond this axis: {', '.join(far)}"
        axes.text(0.005, 0.97, text, transform=axes.transAxes, va="top", color=lines[0].colour, fontsize="x-small")


def _short(name: str) -> str:
    """Return a name of at most `_LONGEST_LABEL` characters: long ones differ at their ends."""
    half = _LONGEST_LABEL // 2
    return name if len(name) <= _LONGEST_LABEL else f"{name[:half]}…{name[-half + 1 :]}"


def _thinned(drawn: RunCurves, values: Floats) -> tuple[Floats, Floats]:
    """Return time (p,) s and values (p,), thinned to the resolution of a figure, with a break at each interruption."""
    step = max(1, len(values) // _MOST_POINTS)
    kept = np.arange(0, len(values), step)
    cuts = drawn.cuts[(drawn.cuts > 0) & (drawn.cuts < len(values))]
    at = np.searchsorted(kept, cuts)
    time_s = np.insert(drawn.samples.time_s[kept], at, drawn.samples.time_s[cuts])
    return time_s, np.insert(values[kept], at, np.nan)


def _embedded(figure: Any) -> Html:
    from matplotlib.image import imsave

    canvas, buffer = figure.canvas, io.BytesIO()
    canvas.draw()
    imsave(buffer, canvas.buffer_rgba(), format="png", origin="upper", dpi=_DPI)
    return image("png", buffer.getvalue())


def _one_time_axis(rows: list[Any]) -> None:
    """Draw the time axis of the last row alone; the others have its grid. Each tick is half a dozen objects."""
    from matplotlib import rcParams
    from matplotlib.collections import LineCollection

    ticks = rows[-1].get_xticks()
    for axes in rows[:-1]:
        axes.xaxis.set_visible(False)
        lines = LineCollection(
            [[(tick, 0.0), (tick, 1.0)] for tick in ticks],
            colors=rcParams["grid.color"],
            linewidths=rcParams["grid.linewidth"],
            alpha=_GRID_ALPHA,
            transform=axes.get_xaxis_transform(),
        )
        axes.add_collection(lines, autolim=False)


def _fit(figure: Any, rows: list[Any], above: Any) -> None:
    """Make room for the labels, the legends beside the rows and that `above` them.

    The rows share their time axis, so only the widths of texts vary. A layout of matplotlib's own measures every text
    four times, which takes as long as all the rest of the report.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    renderer = FigureCanvasAgg(figure).get_renderer()
    width, height = figure.get_size_inches() * _DPI
    pad, line = _PAD_IN * _DPI, _TIME_AXIS_IN * _DPI
    beside = [axes.get_legend().get_window_extent(renderer).width for axes in rows if axes.get_legend() is not None]
    over = 0.0 if above is None else above.get_window_extent(renderer).height
    sides = {"right": 1.0 - (max(beside, default=0.0) + pad) / width, "top": 1.0 - (over + pad) / height}
    between = len(rows) * pad / (height - over - line)
    figure.subplots_adjust(left=_LEFT_IN * _DPI / width, bottom=line / height, hspace=between, **sides)
    labels = max(axes.bbox.x0 - axes.yaxis.get_tightbbox(renderer).x0 for axes in rows)
    figure.subplots_adjust(left=(labels + pad) / width)
