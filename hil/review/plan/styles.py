"""Colours, names and plain parts of a review's plan: curves, lanes, panels, stacks."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal

from drivers.signals import Quality
from hil.journal import Header, State

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
ACTUATOR_WORDS = ("red", "blue", "green", "yellow", "violet")
"""Names of `ACTUATORS`, for titles of panels without a legend."""
MANY: dict[str, Colour] = {
    **dict(zip(ACTUATOR_WORDS, ACTUATORS, strict=True)),
    "cyan": (20, 200, 210),
    "orange": ORANGE,
    "pink": (250, 130, 190),
    "brown": (165, 115, 75),
    "grey": NEUTRAL,
}
"""Colours by their names, for curves that a line of text distinguishes."""
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
    **dict.fromkeys(("SHORT_RECORD", "UNCONFIRMED"), FAINT),
    "MISSING_REQUIRED": YELLOW,
    "LOW_SENSITIVITY": (120, 100, 60),
    "HIGH_UNCERTAINTY": ORANGE,
    "OUT_OF_ENVELOPE": VIOLET,
    **dict.fromkeys(("CONTRADICTORY_EVENT", "FLAT_RECORD", "SHUFFLED_RECORD", "LEAKAGE"), RED),
}
STATE_COLOURS = {
    State.IDLE: FAINT,
    State.VALIDATING: FAINT,
    State.CONNECTING: FAINT,
    State.RESTORING: (45, 95, 120),
    State.RUNNING: GREEN,
    State.HELD: (45, 150, 255),
    State.PAUSED: YELLOW,
    State.SUSPENDED: ORANGE,
    State.FINISHING: (45, 95, 120),
    State.DONE: FAINT,
    State.ABORTED: VIOLET,
    State.FAULTED: RED,
}
FLAG_COLOURS = {"calibrated": GREEN, "not calibrated": RED}
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
    """Lane of states over time, with the colour of each known state."""

    entity: str
    colours: dict[str, Colour]


@dataclass(frozen=True, slots=True)
class Panel:
    """View: `kind` of content, the entities (Rerun query expressions) and its share of the room."""

    kind: Literal["lines", "lanes", "texts", "note"]
    title: str
    contents: tuple[str, ...]
    share: float = 1.0
    legend: bool = True
    reach: float | None = None
    """Half height of the value axis around 0; None fits it to the values."""
    margin: float = 0.0
    """Part of the time axis that is left free before the run, in addition to that of the enclosing stacks."""


@dataclass(frozen=True, slots=True)
class Stack:
    """Panels in `rows`, in `columns` or in a grid.

    `margin` is the part of the time axis that is left free before the run, where legends cover no curve.
    """

    arrange: Literal["rows", "columns", "grid"]
    parts: tuple[Panel | Stack, ...]
    share: float = 1.0
    title: str = ""
    margin: float = 0.0


@dataclass(frozen=True, slots=True)
class ReviewPlan:
    """Styles and tabs of a review.

    `columns_of` maps entities to columns of a sample row, `colours` are those of estimates without a twin, `notes` are
    texts by entity that hold at all times, `start_s` is the time of the first row since 1970, for axes with dates."""

    header: Header
    lines: tuple[Lines, ...]
    lanes: tuple[Lane, ...]
    tabs: tuple[Stack, ...]
    columns_of: dict[str, tuple[str, ...]] = field(default_factory=dict)
    colours: dict[str, Colour] = field(default_factory=dict)
    notes: dict[str, str] = field(default_factory=dict)
    start_s: float | None = None


def path(*parts: str) -> str:
    """Return the entity path of `parts`, with Rerun's special characters escaped."""
    return "".join("/" + re.sub(r"([^A-Za-z0-9_.-])", r"\\\1", part) for part in parts)


def symbol(unit: str) -> str:
    """Return a unit in display form: `degC` -> `°C`."""
    return _UNIT_SYMBOLS.get(unit, unit)


def titled(name: str, unit: str) -> str:
    """Return `name [unit]`, or the name alone for a pure number."""
    return f"{name} [{symbol(unit)}]" if symbol(unit) else name


def twin_colours(twins: tuple[str, ...]) -> dict[str, Colour]:
    """Return orange for the twin that is never updated, blue, green .. for tracked twins."""
    tracked = [twin for twin in twins if twin != "static"]
    return {"static": ORANGE} | dict(zip(tracked, itertools.cycle(TRACKED.values()), strict=False))


def twin_words(twins: tuple[str, ...]) -> dict[str, str]:
    """Return the names of the colours of `twin_colours`."""
    tracked = [twin for twin in twins if twin != "static"]
    static = {"static": "orange"} if "static" in twins else {}
    return static | dict(zip(tracked, itertools.cycle(TRACKED), strict=False))


def with_colours(names: Iterable[str]) -> str:
    """Return `one (red), another (blue)`: names with their colours of `MANY` in this order."""
    return ", ".join(f"{name} ({word})" for name, word in zip(names, itertools.cycle(MANY), strict=False))


def colour_key(twins: tuple[str, ...]) -> str:
    """Return the key of colours in one line."""
    tracked = [twin for twin in twins if twin != "static"]
    parts = ["grey: measured", *(["orange: static twin"] if "static" in twins else [])]
    parts += [f"{name}: tracked by {twin}" for twin, name in zip(tracked, itertools.cycle(TRACKED), strict=False)]
    parts += ["dim lines: 90 % band, or ±2σ of the sensor's noise", "gap: no good value"]
    return " · ".join([*parts, "set-points: dim, read back: bright"])


def estimates_key(twins: tuple[str, ...], proposers: tuple[str, ...]) -> str:
    """Return the key of colours of a parameter's estimates in one line."""
    tracked = [twin for twin in twins if twin != "static"]
    parts = [f"{name}: {twin}" for twin, name in zip(tracked, itertools.cycle(TRACKED), strict=False)]
    parts += [f"grey: {name} proposes, if no gate holds it" for name in proposers]
    return " · ".join([*parts, "bands: 90 % intervals"])
