"""The tabs that an operator looks at, and the panels on them."""

from __future__ import annotations

import itertools
from dataclasses import replace

from hil.journal.rows import Header
from hil.review.styles import ACTUATOR_WORDS, Panel, Stack, path, titled

MARGIN = 0.13
_MOST_BESIDE = 4
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
    """Return a panel of actuators without a legend, which would cover half of it; its title has their colours."""
    names = {entity: entity.rpartition("/")[2].replace("\\", "") for entity in panel.contents}
    told = ", ".join(f"{name} ({colours[entity]})" for entity, name in names.items())
    _, bracket, unit = panel.title.rpartition(" [")
    return replace(panel, title=f"{told}{bracket}{unit}" if bracket else told, legend=False)


def _temperature(sensor: str, *, share: float, columns: bool, legend: bool) -> Panel:
    root = path("sensors", sensor)
    contents = (f"{root}/measured", f"{root}/twin/**", *((f"{root}/columns",) if columns else ()))
    return Panel("lines", titled(sensor.removesuffix("_C"), "degC"), contents, share, legend)


def _residual(sensor: str, *, share: float, legend: bool) -> Panel:
    root = path("sensors", sensor)
    title = titled(f"{sensor.removesuffix('_C')}: measured - twin", "K")
    return Panel("lines", title, (f"{root}/residual", f"{root}/noise"), share, legend)


def _bands(sensor: str, header: Header, *, share: float, legend: bool) -> Panel:
    """The tracked twins alone: beside the static one's error theirs would be a flat line."""
    root = path("sensors", sensor)
    tracked = [twin for twin in header.twin_names if twin != "static"]
    contents = [f"{root}/{what}{path(twin)}" for what in ("band", "miss") for twin in tracked]
    what = "means of 10 min with the bands foretold for them" if legend else ""
    title = titled(f"{sensor.removesuffix('_C')}: measured - tracked{', ' * bool(what)}{what}", "K")
    return Panel(
        "lines", title, tuple(contents), share, legend, max(_LEAST_REACH_K, 6.0 * header.noise_K.get(sensor, 0))
    )


def overview(
    header: Header,
    actuators: dict[str, tuple[str, str]],
    others: dict[str, tuple[str, str]],
    proposers: tuple[str, ...],
) -> Stack:
    """Sensors beside one another, each above its residual; a line of text is the legend of them all."""
    gates = tuple(path("gates", name) for name in proposers)
    cells = [
        Stack(
            "rows",
            (
                _temperature(sensor, share=5.0, columns=False, legend=False),
                _bands(sensor, header, share=4.0, legend=False)
                if len(header.twin_names) > 1
                else _residual(sensor, share=4.0, legend=False),
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
        "State, quality, gates and windows" if proposers else "State, calibration windows and quality",
        ("/state", "/quality", *gates, "/windows/**"),
    )
    events = Panel("texts", "Events", ("/events",))
    colours = dict(zip(actuators, itertools.cycle(ACTUATOR_WORDS), strict=False))
    driven = tuple(_told_by_title(panel, colours) for panel in unit_panels(actuators))
    rows.append(Stack("columns", (*driven, lanes, events), share=3.0))
    return Stack("rows", tuple(rows), title="Overview")


def sensor_tab(sensor: str, columns: tuple[str, ...], header: Header) -> Stack:
    calibrators = sum(twin != "static" for twin in header.twin_names)
    lanes = ("/windows/**", *(path("quality", column) for column in columns))
    height = 50.0 + 30.0 * (min(len(columns), 6) + calibrators)  # of the lanes, in a window of a usual 800 points
    panels = (
        _temperature(sensor, share=5.0, columns=True, legend=True),
        _residual(sensor, share=4.0, legend=True),
        *((_bands(sensor, header, share=4.0, legend=True),) if calibrators else ()),
        Panel(
            "lanes",
            "Calibration windows and quality",
            lanes,
            8.0 * height / (800.0 - height),
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
        "Windows: kind, and whether the fit was accepted" + (", gates of the network" if proposers else ""),
        ("/windows/**", "/calibrated/**", *(path("gates", name) for name in proposers)),
        3.2 if commissioned else 0.8,
    )
    fit = Panel("lines", "RMSE within the window [K]", ("/fit/**",), 1.5)
    relative = tuple(
        Panel("lines", f"{name}: parameters against commissioning [%]", (path("relative", name) + "/**",), reach=100.0)
        for name in calibrators
    )
    shifts = (Stack("columns", relative, share=3.5, margin=0.7),) if commissioned else ()
    told = tuple(
        Panel("texts", f"What {name} proposes, where that changes", (path("proposals", name),), 1.8)
        for name in proposers
    )
    tracking = Stack("rows", (lanes, fit, *shifts, *told), title="Calibration", margin=MARGIN)
    if not units:
        return (tracking,)
    each = tuple(
        Panel("lines", titled(name, unit), (path("parameters", name) + "/**", path("proposed", name) + "/**"))
        for name, unit in units.items()
    )
    return (tracking, Stack("grid", each, title="Parameters", margin=2 * MARGIN))


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
