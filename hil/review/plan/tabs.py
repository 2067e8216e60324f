"""Tabs of the review, and their panels."""

from __future__ import annotations

import itertools
from dataclasses import replace

from hil.journal import Header
from hil.review.plan.styles import ACTUATOR_WORDS, Panel, Stack, path, titled, twin_words

MARGIN = 0.13
PARAMETERS_KEY, ESTIMATES_KEY = path("key", "parameters"), path("key", "estimates")
_MOST_BESIDE = 4
_LANE_PX, _LANES_PX, _WINDOW_PX = 40.0, 60.0, 900.0
"""Height of a lane and of the title and time axis above the lanes, in pictures of the viewer (0.41); height that the
panels of a tab share in a window of a usual 1000 points."""
_MOST_LANES = 5
"""Lanes that a sensor's tab has room for; the others need scrolling."""
_LEAST_REACH_K = 0.25


def _by_unit(entities: dict[str, tuple[str, str]]) -> dict[str, list[tuple[str, str]]]:
    groups: dict[str, list[tuple[str, str]]] = {}
    for entity, (name, unit) in entities.items():
        groups.setdefault(unit, []).append((name, entity))
    return groups


def _shortened(names: list[str]) -> str:
    return ", ".join(names) if len(names) <= 3 else f"{names[0]} .. {names[-1]}"


def unit_panels(entities: dict[str, tuple[str, str]]) -> tuple[Panel, ...]:
    return tuple(
        Panel("lines", titled(_shortened([name for name, _ in group]), unit), tuple(entity for _, entity in group))
        for unit, group in _by_unit(entities).items()
    )


def _told_by_title(panel: Panel, colours: dict[str, str]) -> Panel:
    """Return a panel of actuators without a legend, which would cover half of it; its title names their colours."""
    names = {entity: entity.rpartition("/")[2].replace("\\", "") for entity in panel.contents}
    told = ", ".join(f"{name} ({colours[entity]})" for entity, name in names.items())
    _, bracket, unit = panel.title.rpartition(" [")
    return replace(panel, title=f"{told}{bracket}{unit}" if bracket else told, legend=False)


def _temperature(sensor: str, *, share: float) -> Panel:
    root = path("sensors", sensor)
    title = titled(sensor.removesuffix("_C"), "degC")
    return Panel("lines", title, (f"{root}/measured", f"{root}/twin/**"), share, legend=False)


def _temperature_with_key(sensor: str, columns: tuple[str, ...], header: Header, *, share: float) -> Panel:
    """Return the panel with the sensor's columns, and with a title that names all colours: a legend would be cut."""
    panel = _temperature(sensor, share=share)
    several = len(columns) > 1
    measured = f"measured grey ({len(columns)} columns dim)" if several else "measured grey"
    key = ", ".join([measured, *(f"{twin} {word}" for twin, word in twin_words(header.twin_names).items())])
    more = (path("sensors", sensor) + "/columns",) if several else ()
    return replace(panel, title=f"{panel.title}: {key}", contents=(*panel.contents, *more))


def _residual(sensor: str, *, share: float, told: bool) -> Panel:
    root = path("sensors", sensor)
    noise = " (dim lines: 0 and ±2σ of the sensor's noise)" if told else ""
    title = titled(f"{sensor.removesuffix('_C')}: measured - twin{noise}", "K")
    # A legend of noise and twins would be cut. The plot above names the twins' colours.
    return Panel("lines", title, (f"{root}/residual", f"{root}/noise"), share, legend=False)


def _bands(sensor: str, header: Header, *, share: float, told: bool) -> Panel:
    """Return the tracked twins alone: beside the static one's error theirs would be a flat line."""
    root = path("sensors", sensor)
    tracked = [twin for twin in header.twin_names if twin != "static"]
    contents = [f"{root}/{what}{path(twin)}" for what in ("band", "miss") for twin in tracked]
    what = ", means of 10 min between their 90 % bands, predicted before" if told else ""
    title = titled(f"{sensor.removesuffix('_C')}: measured - tracked{what}", "K")
    reach_K = max(_LEAST_REACH_K, 6.0 * header.noise_K.get(sensor, 0))
    return Panel("lines", title, tuple(contents), share, legend=False, reach=reach_K)


def overview(
    header: Header,
    actuators: dict[str, tuple[str, str]],
    others: dict[str, tuple[str, str]],
    proposers: tuple[str, ...],
) -> Stack:
    """Return the sensors in columns, each above its residual; a line of text is the legend of them all."""
    gates = tuple(path("gates", name) for name in proposers)
    cells = [
        Stack(
            "rows",
            (
                _temperature(sensor, share=5.0),
                _bands(sensor, header, share=4.0, told=False)
                if len(header.twin_names) > 1
                else _residual(sensor, share=4.0, told=False),
            ),
        )
        for sensor in header.twin_sensors
    ]
    rows: list[Panel | Stack] = [Panel("note", "Colours", ("/key",), 0.3)] if cells else []
    rows += [
        Stack("columns", tuple(cells[start : start + _MOST_BESIDE]), share=6.0)
        for start in range(0, len(cells), _MOST_BESIDE)
    ]
    if not cells and others:
        rows.append(Stack("columns", unit_panels(others), share=6.0))
    lanes = Panel(
        "lanes",
        "State, quality, gates, windows" if proposers else "State, quality, windows",
        ("/state", "/quality", *gates, "/windows/**"),
    )
    events = Panel("texts", "Events", ("/events",))
    colours = dict(zip(actuators, itertools.cycle(ACTUATOR_WORDS), strict=False))
    driven = tuple(_told_by_title(panel, colours) for panel in unit_panels(actuators))
    rows.append(Stack("columns", (*driven, lanes, events), share=3.0))
    return Stack("rows", tuple(rows), title="Overview")


def _lanes_share(lanes: int, others: float) -> float:
    """Return the share of a panel with so many lanes, next to panels with the sum of shares `others`."""
    height = _LANES_PX + _LANE_PX * lanes
    return others * height / (_WINDOW_PX - height)


def sensor_tab(sensor: str, columns: tuple[str, ...], header: Header) -> Stack:
    calibrators = sum(twin != "static" for twin in header.twin_names)
    lanes = ("/windows/**", *(path("quality", column) for column in columns))
    others = 9.0 + 4.0 * bool(calibrators)
    panels = (
        _temperature_with_key(sensor, columns, header, share=5.0),
        _residual(sensor, share=4.0, told=True),
        *((_bands(sensor, header, share=4.0, told=True),) if calibrators else ()),
        Panel(
            "lanes",
            "Calibration windows and quality",
            lanes,
            _lanes_share(min(len(columns) + calibrators, _MOST_LANES), others),
        ),
    )
    return Stack("rows", panels, title=sensor.removesuffix("_C"), margin=MARGIN)


def calibration_tab(
    calibrators: tuple[str, ...], units: dict[str, str], commissioned: bool, proposers: tuple[str, ...]
) -> tuple[Stack, ...]:
    if not calibrators:
        return ()
    lanes = Panel(
        "lanes",
        "Windows: kind, and acceptance of the fit" + (", gates of the network" if proposers else ""),
        ("/windows/**", "/calibrated/**", *(path("gates", name) for name in proposers)),
        _lanes_share(2 * len(calibrators) + len(proposers), 7.4 if commissioned else 3.3),
    )
    fit = Panel("lines", "RMSE within the window, dim: before the fit [K]", ("/fit/**",), 1.5, legend=False)
    relative = tuple(
        Panel(
            "lines",
            f"{name}: parameters against commissioning [%]",
            (path("relative", name) + "/**",),
            legend=False,
            reach=100.0,
        )
        for name in calibrators
    )
    key = Panel("note", "Colours of parameters", (PARAMETERS_KEY,), 0.6)
    shifts = (key, Stack("columns", relative, share=3.5)) if commissioned else ()
    told = tuple(
        Panel("texts", f"Changes of proposals of {name}", (path("proposals", name),), 1.8) for name in proposers
    )
    tracking = Stack("rows", (lanes, fit, *shifts, *told), title="Calibration", margin=MARGIN)
    if not units:
        return (tracking,)
    each = tuple(
        Panel(
            "lines",
            titled(name, unit),
            (path("parameters", name) + "/**", path("proposed", name) + "/**"),
            legend=False,
        )
        for name, unit in units.items()
    )
    key = Panel("note", "Colours of estimates", (ESTIMATES_KEY,), 0.3)
    return (tracking, Stack("rows", (key, Stack("grid", each, share=10.0)), title="Parameters"))


def quality_tab(status: bool) -> Stack:
    lanes = Panel("lanes", "State of the run, quality of every signal", ("/state", "/quality/**"), 4.0)
    counters = (Panel("lines", "Counters and bit fields", ("/status",), 1.5),) if status else ()
    writes = Panel("texts", "Writes other than profile and slew", ("/writes",), 1.5)
    return Stack(
        "rows",
        (lanes, *counters, Stack("columns", (Panel("texts", "Events", ("/events",)), writes), 2.0)),
        title="Quality",
        margin=MARGIN,
    )
