"""What the review shows of a run: entities with their looks, and the tabs and panels that an operator looks at.

Plain data made from the journal's header; nothing here knows Rerun. Entities:

    /sensors/<sensor>/measured           mean of the sensor's GOOD columns, (n, 1)
    /sensors/<sensor>/columns            its columns one by one where there are several, (n, k)
    /sensors/<sensor>/twin/<twin>        prediction, (n, 1)
    /sensors/<sensor>/residual/<twin>    measured minus prediction, (n, 1)
    /sensors/<sensor>/miss/<twin>        its mean over ten minutes, (n, 1)
    /sensors/<sensor>/band/<twin>        the 90 % band foretold for them, (n, 2)
    /sensors/<sensor>/noise              zero and plus/minus two sigma of the noise, (n, 1 or 3)
    /actuators/<name>                    set-point and read-back, (n, 1 or 2)
    /measured/<column>                   what else the rig reports, (n, 1)
    /status                              counters and bit fields, (n, k)
    /quality/<column>, /quality          lanes, one a signal, and the worst of all
    /windows/<calibrator>                lane: kind of each calibration window
    /calibrated/<calibrator>             lane: whether the window's fit was accepted
    /fit/<calibrator>                    RMSE of the window before and after its fit, K, (n, 2)
    /parameters/<parameter>/<calibrator> physical value with its variance
    /proposed/<parameter>/<calibrator>   what it proposes between windows too and no gate holds, with its 90 % interval
    /gates/<calibrator>, /proposals/..   lane: whether its gates are open; text: what it takes on, what holds the rest
    /relative/<calibrator>/<parameter>   per cent off the commissioned value, (n, 1)
    /events, /writes                     text
    /key                                 which colour is what
"""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass, field
from typing import Literal

from drivers.points import Quality, Signal
from hil.journal import Header

Colour = tuple[int, int, int]
NEUTRAL: Colour = (158, 163, 170)
FAINT: Colour = (96, 100, 108)
ORANGE: Colour = (245, 140, 30)
TRACKED: dict[str, Colour] = {
    "blue": (45, 150, 255),
    "green": (60, 200, 120),
    "violet": (180, 120, 255),
    "cyan": (20, 200, 210),
}
ACTUATORS: tuple[Colour, ...] = ((240, 110, 90), (90, 170, 250), (110, 210, 140), (220, 180, 90), (190, 140, 240))
RED: Colour = (235, 70, 70)
GREEN: Colour = (60, 140, 90)
YELLOW: Colour = (230, 200, 60)
VIOLET: Colour = (170, 90, 210)

QUALITY_NAMES = {quality: quality.name.lower().replace("_", " ") for quality in Quality}
QUALITY_COLOURS = {
    Quality.GOOD: (52, 74, 62),
    Quality.STALE: YELLOW,
    Quality.OUT_OF_RANGE: ORANGE,
    Quality.SENSOR_FAULT: RED,
    Quality.LINK_FAULT: VIOLET,
}
WINDOW_COLOURS = {"calibrated": GREEN, "recovery": ORANGE, "stall": RED}
GATE_COLOURS = {
    "open": GREEN,
    "some held": (45, 95, 120),
    "SHORT_RECORD": FAINT,
    "MISSING_REQUIRED": YELLOW,
    "LOW_SENSITIVITY": (120, 100, 60),
    "HIGH_UNCERTAINTY": ORANGE,
    "OUT_OF_ENVELOPE": VIOLET,
    **dict.fromkeys(("CONTRADICTORY_EVENT", "FLAT_RECORD", "SHUFFLED_RECORD", "LEAKAGE"), RED),
}
FLAG_COLOURS = {"calibrated": GREEN, "not calibrated": RED}
_SETPOINT_SUFFIX = re.compile(r"_(set|setpoint|sp|cmd|command|target|demand)$")
_MOST_BESIDE = 4
_MARGIN = 0.13
_LEAST_REACH_K = 0.25
_UNIT_SYMBOLS = {"degC": "°C", "1": "", "m3/h": "m³/h"}


@dataclass(frozen=True, slots=True)
class Lines:
    """Curves of one entity; `extremes` keeps peaks when many samples share a pixel (else they are averaged)."""

    entity: str
    names: tuple[str, ...]
    colours: tuple[Colour, ...] = ()
    widths: tuple[float, ...] = (1.5,)
    extremes: bool = False
    steps: bool = False


@dataclass(frozen=True, slots=True)
class Lane:
    """A lane of states over time, with the colour of each known state."""

    entity: str
    colours: dict[str, Colour]


@dataclass(frozen=True, slots=True)
class Panel:
    """One view: `kind` of content, the entities (Rerun query expressions) and the share of room it gets."""

    kind: Literal["lines", "lanes", "texts", "note"]
    title: str
    contents: tuple[str, ...]
    share: float = 1.0
    legend: bool = True
    reach: float | None = None
    """Of the value axis, to either side of 0; None as far as the values go."""


@dataclass(frozen=True, slots=True)
class Stack:
    """Panels above one another (`rows`), beside one another (`columns`), or in a grid.

    `margin` is the part of the time axis that is left free before the run, where legends cover no curve.
    """

    arrange: Literal["rows", "columns", "grid"]
    parts: tuple[Panel | Stack, ...]
    share: float = 1.0
    title: str = ""
    margin: float = 0.0


@dataclass(frozen=True, slots=True)
class Plan:
    """All looks and the tabs; `columns_of` says which columns of a sample row go to which entity, `colours` how
    estimates that belong to no twin are drawn."""

    header: Header
    lines: tuple[Lines, ...]
    lanes: tuple[Lane, ...]
    tabs: tuple[Stack, ...]
    columns_of: dict[str, tuple[str, ...]] = field(default_factory=dict)
    colours: dict[str, Colour] = field(default_factory=dict)


def path(*parts: str) -> str:
    """Entity path of `parts`, with every character escaped that Rerun gives a meaning."""
    return "".join("/" + re.sub(r"([^A-Za-z0-9_.-])", r"\\\1", part) for part in parts)


def symbol(unit: str) -> str:
    """A unit as an operator writes it: `degC` -> `°C`."""
    return _UNIT_SYMBOLS.get(unit, unit)


def titled(name: str, unit: str) -> str:
    """`name [unit]`, or the name alone for a pure number."""
    return f"{name} [{symbol(unit)}]" if symbol(unit) else name


def twin_colours(twins: tuple[str, ...]) -> dict[str, Colour]:
    """Orange for the twin that is never updated, blue, green .. for those that are."""
    tracked = [twin for twin in twins if twin != "static"]
    return {"static": ORANGE} | dict(zip(tracked, itertools.cycle(TRACKED.values()), strict=False))


def colour_key(twins: tuple[str, ...]) -> str:
    """What the colours of the curves mean, in one line."""
    tracked = [twin for twin in twins if twin != "static"]
    parts = ["grey: measured", *(["orange: static twin"] if "static" in twins else [])]
    parts += [f"{name}: tracked by {twin}" for twin, name in zip(tracked, itertools.cycle(TRACKED), strict=False)]
    return " · ".join([*parts, "thin lines: 90 % band, or ±2σ of the sensor's noise", "gap: no good value"])


def _dimmed(colour: Colour) -> Colour:
    return (colour[0] // 2, colour[1] // 2, colour[2] // 2)


def _lighter(colour: Colour) -> Colour:
    return (128 + colour[0] // 2, 128 + colour[1] // 2, 128 + colour[2] // 2)


def _sensor_lines(header: Header) -> list[Lines]:
    colours = twin_colours(header.twin_names)
    lines = []
    for sensor, columns in header.twin_sensors.items():
        several = len(columns) > 1
        name = f"measured, mean of {len(columns)}" if several else "measured"
        lines.append(Lines(path("sensors", sensor, "measured"), (name,), (NEUTRAL,), (3.0,), extremes=True))
        if several:
            names = tuple(column.removesuffix("_C") for column in columns)
            faint = (FAINT,) * len(columns)
            lines.append(Lines(path("sensors", sensor, "columns"), names, faint, (1.0,), extremes=True))
        for twin in header.twin_names:
            # The one drawn last is the thinnest, so that curves which agree are all seen.
            width = 1.2 if twin == "static" else 2.2
            lines.append(Lines(path("sensors", sensor, "twin", twin), (twin,), (colours[twin],), (width,)))
            lines.append(Lines(path("sensors", sensor, "residual", twin), (twin,), (colours[twin],)))
            lines.append(Lines(path("sensors", sensor, "miss", twin), (twin,), (colours[twin],), (2.0,), steps=True))
            dim, names = _dimmed(colours[twin]), (f"{twin}, 90 % band", f"-{twin}, 90 % band")
            lines.append(Lines(path("sensors", sensor, "band", twin), names, (dim, dim), (1.0,), steps=True))
        sigma = header.noise_K.get(sensor)
        if sigma is None:
            lines.append(Lines(path("sensors", sensor, "noise"), ("zero",), (NEUTRAL,), (1.0,)))
        else:
            names = ("zero", f"+2σ noise ({2 * sigma:.3g} K)", "-2σ noise")
            lines.append(Lines(path("sensors", sensor, "noise"), names, (NEUTRAL, FAINT, FAINT), (1.0,)))
    return lines


def pair_actuators(signals: tuple[Signal, ...]) -> dict[str, tuple[Signal, ...]]:
    """Set-points by name without suffix, each with its read-back where one has that name or the same role."""
    measured = [signal for signal in signals if signal.kind == "measured"]
    pairs: dict[str, tuple[Signal, ...]] = {}
    for setpoint in (signal for signal in signals if signal.kind == "setpoint"):
        stem = _SETPOINT_SUFFIX.sub("", setpoint.name)
        found = [
            signal
            for signal in measured
            if signal.unit == setpoint.unit
            and (signal.name.startswith(stem) or (signal.role is not None and signal.role == setpoint.role))
        ]
        pairs[stem] = (setpoint, *found[:1])
    return pairs


def _by_unit(entities: dict[str, tuple[str, str]]) -> dict[str, list[tuple[str, str]]]:
    groups: dict[str, list[tuple[str, str]]] = {}
    for entity, (name, unit) in entities.items():
        groups.setdefault(unit, []).append((name, entity))
    return groups


def _shortened(names: list[str]) -> str:
    return ", ".join(names) if len(names) <= 3 else f"{names[0]} .. {names[-1]}"


def _unit_panels(entities: dict[str, tuple[str, str]]) -> tuple[Panel, ...]:
    return tuple(
        Panel("lines", titled(_shortened([name for name, _ in group]), unit), tuple(entity for _, entity in group))
        for unit, group in _by_unit(entities).items()
    )


def _temperature(sensor: str, *, share: float, columns: bool, legend: bool) -> Panel:
    root = path("sensors", sensor)
    contents = (f"{root}/measured", f"{root}/twin/**", *((f"{root}/columns",) if columns else ()))
    return Panel("lines", titled(sensor.removesuffix("_C"), "degC"), contents, share, legend)


def _residual(sensor: str, *, share: float, legend: bool) -> Panel:
    root = path("sensors", sensor)
    title = titled(f"{sensor.removesuffix('_C')}: measured - twin", "K")
    return Panel("lines", title, (f"{root}/residual/**", f"{root}/noise"), share, legend)


def _bands(sensor: str, header: Header, *, share: float, legend: bool) -> Panel:
    """The tracked twins alone: beside the static one's error theirs would be a flat line."""
    root = path("sensors", sensor)
    tracked = [twin for twin in header.twin_names if twin != "static"]
    contents = [f"{root}/{what}{path(twin)}" for what in ("band", "miss") for twin in tracked]
    title = titled(f"{sensor.removesuffix('_C')}: measured - tracked, 10 min, 90 % bands", "K")
    return Panel(
        "lines", title, tuple(contents), share, legend, max(_LEAST_REACH_K, 6.0 * header.noise_K.get(sensor, 0))
    )


def make_plan(
    header: Header,
    units: dict[str, str] | None = None,
    commissioned: bool = False,
    proposers: tuple[str, ...] = (),
) -> Plan:
    """Looks and layout; `units` by parameter as far as seen, `commissioned` when what they were is known, `proposers`
    those calibrators that have proposed something."""
    sensor_columns = {column for columns in header.twin_sensors.values() for column in columns}
    lines = _sensor_lines(header)
    columns_of: dict[str, tuple[str, ...]] = {}
    actuators: dict[str, tuple[str, str]] = {}
    for stem, signals in pair_actuators(header.signals).items():
        entity = path("actuators", stem)
        names = tuple(f"{stem} {'set' if signal.kind == 'setpoint' else 'read back'}" for signal in signals)
        colour = ACTUATORS[len(actuators) % len(ACTUATORS)]
        lines.append(Lines(entity, names, (_dimmed(colour), colour)[: len(names)], (3.0, 1.2)))
        columns_of[entity] = tuple(signal.column for signal in signals)
        actuators[entity] = (stem, signals[0].unit)
    paired = {column for columns in columns_of.values() for column in columns}
    others: dict[str, tuple[str, str]] = {}
    for signal in header.signals:
        if signal.kind == "measured" and signal.column not in sensor_columns | paired:
            entity = path("measured", signal.column)
            palette = (*ACTUATORS, *TRACKED.values(), NEUTRAL)
            colour = palette[len(others) % len(palette)]
            lines.append(Lines(entity, (signal.name,), (colour,), extremes=True))
            columns_of[entity] = (signal.column,)
            others[entity] = (signal.name, signal.unit)
    status = tuple(signal.column for signal in header.signals if signal.kind == "status")
    if status:
        lines.append(Lines("/status", status, steps=True))
        columns_of["/status"] = status
    for sensor, columns in header.twin_sensors.items():
        if len(columns) > 1:
            columns_of[path("sensors", sensor, "columns")] = columns

    calibrators = tuple(twin for twin in header.twin_names if twin != "static")
    colours = twin_colours(header.twin_names)
    for name in calibrators:
        names = (f"{name}, before the fit", f"{name}, after")
        lines.append(Lines(path("fit", name), names, (FAINT, colours[name]), steps=True))
    lanes = [Lane(path("quality", signal.column), _quality_colours()) for signal in header.signals]
    lanes.append(Lane("/quality", _worst_colours(header)))
    lanes += [Lane(path("windows", name), WINDOW_COLOURS) for name in calibrators]
    lanes += [Lane(path("calibrated", name), FLAG_COLOURS) for name in calibrators]
    lanes += [Lane(path("gates", name), GATE_COLOURS) for name in proposers]
    proposed = {path("proposed", p, name): _lighter(colours[name]) for p in units or () for name in proposers}
    tabs = [
        _overview(header, actuators, others),
        *(_sensor_tab(sensor, columns, header) for sensor, columns in header.twin_sensors.items()),
        Stack("rows", (*_unit_panels(actuators), *_unit_panels(others)), title="Rig", margin=_MARGIN),
        *_calibration_tab(calibrators, units or {}, commissioned, proposers),
        _quality_tab(bool(status)),
    ]
    return Plan(header, tuple(lines), tuple(lanes), tuple(tabs), columns_of, proposed)


def _quality_colours() -> dict[str, Colour]:
    return {QUALITY_NAMES[quality]: QUALITY_COLOURS[quality] for quality in Quality}


def worst_state(columns: list[str], qualities: list[int]) -> str:
    """What the lane of all signals says on a tick where `columns` are not GOOD."""
    if not columns:
        return QUALITY_NAMES[Quality.GOOD]
    who = columns[0] if len(columns) == 1 else f"{len(columns)} signals"
    return f"{who}: {QUALITY_NAMES[Quality(max(qualities))]}"


def _worst_colours(header: Header) -> dict[str, Colour]:
    who = [signal.column for signal in header.signals]
    who += [f"{n} signals" for n in range(2, len(header.signals) + 1)]
    states = {f"{name}: {QUALITY_NAMES[q]}": QUALITY_COLOURS[q] for name in who for q in Quality if q}
    return {QUALITY_NAMES[Quality.GOOD]: QUALITY_COLOURS[Quality.GOOD]} | states


def _overview(header: Header, actuators: dict[str, tuple[str, str]], others: dict[str, tuple[str, str]]) -> Stack:
    """Sensors beside one another, each above its residual; a line of text is the legend of them all."""
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
        rows.append(Stack("columns", _unit_panels(others), share=6.0))
    lanes = Panel("lanes", "Calibration windows and quality", ("/windows/**", "/quality"))
    events = Panel("texts", "Events", ("/events",))
    rows.append(Stack("columns", (*_unit_panels(actuators), lanes, events), share=3.0))
    return Stack("rows", tuple(rows), title="Overview")


def _sensor_tab(sensor: str, columns: tuple[str, ...], header: Header) -> Stack:
    calibrators = sum(twin != "static" for twin in header.twin_names)
    lanes = ("/windows/**", *(path("quality", column) for column in columns))
    height = 50.0 + 35.0 * (min(len(columns), 6) + calibrators)  # of the lanes, in a window of a usual 800 points
    panels = (
        _temperature(sensor, share=5.0, columns=True, legend=True),
        _residual(sensor, share=4.0, legend=True),
        *((_bands(sensor, header, share=4.0, legend=True),) if calibrators else ()),
        Panel("lanes", "Calibration windows and quality", lanes, 8.0 * height / (800.0 - height)),
    )
    return Stack("rows", panels, title=sensor.removesuffix("_C"), margin=_MARGIN)


def _calibration_tab(
    calibrators: tuple[str, ...], units: dict[str, str], commissioned: bool, proposers: tuple[str, ...]
) -> tuple[Stack, ...]:
    if not calibrators:
        return ()
    lanes = Panel(
        "lanes",
        "Windows: kind, and whether the fit was accepted" + (", gates of the network" if proposers else ""),
        ("/windows/**", "/calibrated/**", *(("/gates/**",) if proposers else ())),
        2.0 if commissioned else 0.8,
    )
    fit = Panel("lines", "RMSE within the window [K]", ("/fit/**",), 1.5)
    relative = tuple(
        Panel("lines", f"{name}: parameters against commissioning [%]", (path("relative", name) + "/**",))
        for name in calibrators
    )
    shifts = (Stack("columns", relative, share=4.0),) if commissioned else ()
    told = tuple(
        Panel("texts", f"What {name} proposes, where that changes", (path("proposals", name),)) for name in proposers
    )
    tracking = Stack("rows", (lanes, fit, *shifts, *told), title="Calibration", margin=_MARGIN)
    if not units:
        return (tracking,)
    each = tuple(
        Panel("lines", titled(name, unit), (path("parameters", name) + "/**", path("proposed", name) + "/**"))
        for name, unit in units.items()
    )
    return (tracking, Stack("grid", each, title="Parameters", margin=2 * _MARGIN))


def _quality_tab(status: bool) -> Stack:
    lanes = Panel("lanes", "Quality of every signal", ("/quality/**",), 4.0)
    counters = (Panel("lines", "Counters and bit fields", ("/status",), 1.5),) if status else ()
    writes = Panel("texts", "Writes other than profile and slew", ("/writes",), 1.5)
    return Stack(
        "rows",
        (lanes, *counters, Stack("columns", (Panel("texts", "Events", ("/events",)), writes), 2.0)),
        title="Quality",
        margin=_MARGIN,
    )
