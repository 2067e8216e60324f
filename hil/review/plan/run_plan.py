"""Plan of the review of a run: entities with their styles, and tabs with panels. Plain data made from the journal's
header, independent of Rerun. Entities:

    /sensors/<sensor>/measured           mean of the sensor's GOOD columns, (n, 1)
    /sensors/<sensor>/columns            its columns one by one where there are several, (n, k)
    /sensors/<sensor>/twin/<twin>        prediction, (n, 1); a file leaves out what lies on straight lines
    /sensors/<sensor>/residual           measured minus prediction, one column for each twin, (n, twins)
    /sensors/<sensor>/miss/<twin>        its mean over ten minutes, (n, 1)
    /sensors/<sensor>/band/<twin>        the predicted 90 % band for them, (n, 2)
    /sensors/<sensor>/noise              zero and plus/minus two sigma of the noise, (n, 1 or 3)
    /actuators/<name>                    set-point and read-back, (n, 1 or 2)
    /measured/<column>                   other signals of the rig, (n, 1)
    /status                              counters and bit fields, (n, k)
    /state                               lane: state of the run (`hil.journal.states`)
    /quality/<column>, /quality          lanes, one for each signal, and the worst of all
    /windows/<calibrator>                lane: kind of each calibration window
    /calibrated/<calibrator>             lane: whether the window's fit was accepted
    /fit/<calibrator>                    RMSE of the window before and after its fit, K, (n, 2)
    /parameters/<parameter>/<calibrator> physical value with the square of its 90 % half width
    /proposed/<parameter>/<calibrator>   its open proposals, also between windows, with its 90 % interval
    /gates/<calibrator>, /proposals/..   lane: state of its gates; text: accepted and held parameters
    /relative/<calibrator>/<parameter>   per cent off the commissioned value, (n, 1)
    /events, /writes                     text
    /key, /key/..                        key of colours
"""

from __future__ import annotations

import itertools

from drivers.signals import Quality
from hil.journal import Header
from hil.report import pair_actuators
from hil.review.plan.legends import with_room_for_legends
from hil.review.plan.styles import (
    ACTUATORS,
    FAINT,
    FLAG_COLOURS,
    GATE_COLOURS,
    MANY,
    NEUTRAL,
    QUALITY_COLOURS,
    QUALITY_NAMES,
    STATE_COLOURS,
    TRACKED,
    WINDOW_COLOURS,
    Colour,
    Lane,
    Lines,
    ReviewPlan,
    Stack,
    colour_key,
    estimates_key,
    path,
    twin_colours,
    with_colours,
)
from hil.review.plan.tabs import (
    ESTIMATES_KEY,
    MARGIN,
    PARAMETERS_KEY,
    calibration_tab,
    overview,
    quality_tab,
    sensor_tab,
    unit_panels,
)


def _dimmed(colour: Colour, to: float = 0.5) -> Colour:
    red, green, blue = (int(part * to) for part in colour)
    return red, green, blue


def _sensor_lines(header: Header) -> list[Lines]:
    colours = twin_colours(header.twin_names)
    lines = []
    for sensor, columns in header.twin_sensors.items():
        several = len(columns) > 1
        name = f"measured, mean of {len(columns)}" if several else "measured"
        lines.append(Lines(path("sensors", sensor, "measured"), (name,), (NEUTRAL,), (4.0,), extremes=True))
        if several:
            names = tuple(column.removesuffix("_C") for column in columns)
            faint = (FAINT,) * len(columns)
            lines.append(Lines(path("sensors", sensor, "columns"), names, faint, (1.0,), extremes=True))
        # Drawn by name, each thinner than the one before, so that coinciding curves are all visible.
        drawn = sorted(header.twin_names)
        for twin in header.twin_names:
            width = max(1.2, 1.2 + 0.9 * (len(drawn) - 1 - drawn.index(twin)))
            lines.append(Lines(path("sensors", sensor, "twin", twin), (twin,), (colours[twin],), (width,)))
            lines.append(
                Lines(path("sensors", sensor, "miss", twin), (twin,), (colours[twin],), (0.6 * width,), steps=True)
            )
            tracked = [name for name in drawn if name != "static"]
            # Bands of equal width coincide: those drawn first are wider, so all are visible.
            wide = 1.5 + 3.0 * (len(tracked) - 1 - tracked.index(twin)) if twin in tracked else 1.5
            dim, names = _dimmed(colours[twin], 1.0 - 0.06 * wide), (f"{twin}, 90 % band", f"-{twin}, 90 % band")
            lines.append(Lines(path("sensors", sensor, "band", twin), names, (dim, dim), (wide,), steps=True))
        if header.twin_names:
            drawn_in = tuple(colours[twin] for twin in header.twin_names)
            lines.append(Lines(path("sensors", sensor, "residual"), header.twin_names, drawn_in))
        sigma = header.noise_K.get(sensor)
        if sigma is None:
            lines.append(Lines(path("sensors", sensor, "noise"), ("zero",), (NEUTRAL,), (1.0,)))
        else:
            names = ("zero", f"+2σ noise ({2 * sigma:.3g} K)", "-2σ noise")
            lines.append(Lines(path("sensors", sensor, "noise"), names, (NEUTRAL, FAINT, FAINT), (1.0,)))
    return lines


def make_plan(
    header: Header,
    units: dict[str, str] | None = None,
    commissioned: bool = False,
    proposers: tuple[str, ...] = (),
) -> ReviewPlan:
    """Return styles and layout. `units` are those of the parameters so far, `commissioned` their values if known,
    `proposers` the calibrators with proposals so far.
    """
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
        several = tuple(itertools.islice(itertools.cycle(MANY.values()), len(status)))
        lines.append(Lines("/status", status, several, steps=True))
        columns_of["/status"] = status
    for sensor, columns in header.twin_sensors.items():
        if len(columns) > 1:
            columns_of[path("sensors", sensor, "columns")] = columns

    calibrators = tuple(twin for twin in header.twin_names if twin != "static")
    colours = twin_colours(header.twin_names)
    for name in calibrators:
        names = (f"{name}, before the fit", f"{name}, after")
        lines.append(Lines(path("fit", name), names, (_dimmed(colours[name]), colours[name]), steps=True))
    for name in calibrators:
        for parameter, colour in zip(units or {}, itertools.cycle(MANY.values()), strict=False):
            lines.append(Lines(path("relative", name, parameter), (parameter,), (colour,)))
    lanes = [Lane(path("quality", signal.column), _quality_colours()) for signal in header.signals]
    lanes.append(Lane("/quality", _worst_colours(header)))
    lanes.append(Lane("/state", {state.value: colour for state, colour in STATE_COLOURS.items()}))
    lanes += [Lane(path("windows", name), WINDOW_COLOURS) for name in calibrators]
    lanes += [Lane(path("calibrated", name), FLAG_COLOURS) for name in calibrators]
    lanes += [Lane(path("gates", name), GATE_COLOURS) for name in calibrators]
    tabs = [
        overview(header, actuators, others, proposers),
        *(sensor_tab(sensor, columns, header) for sensor, columns in header.twin_sensors.items()),
        Stack("rows", (*unit_panels(actuators), *unit_panels(others)), title="Rig", margin=MARGIN),
        *calibration_tab(calibrators, units or {}, commissioned, proposers),
        quality_tab(bool(status)),
    ]
    labels = {line.entity: line.names for line in lines}
    notes = {"/key": colour_key(header.twin_names)}
    if units:
        notes |= {PARAMETERS_KEY: with_colours(units), ESTIMATES_KEY: estimates_key(header.twin_names, proposers)}
    roomy = tuple(with_room_for_legends(tab, labels) for tab in tabs)
    return ReviewPlan(header, tuple(lines), tuple(lanes), roomy, columns_of, notes=notes)


def _quality_colours() -> dict[str, Colour]:
    return {QUALITY_NAMES[quality]: QUALITY_COLOURS[quality] for quality in Quality}


def worst_state(columns: list[str], qualities: list[int]) -> str:
    """Return the state of the lane of all signals on a tick whose `columns` are not GOOD."""
    if not columns:
        return QUALITY_NAMES[Quality.GOOD]
    who = columns[0] if len(columns) == 1 else f"{len(columns)} signals"
    return f"{who}: {QUALITY_NAMES[Quality(max(qualities))]}"


def _worst_colours(header: Header) -> dict[str, Colour]:
    who = [signal.column for signal in header.signals]
    who += [f"{n} signals" for n in range(2, len(header.signals) + 1)]
    states = {f"{name}: {QUALITY_NAMES[q]}": QUALITY_COLOURS[q] for name in who for q in Quality if q}
    return {QUALITY_NAMES[Quality.GOOD]: QUALITY_COLOURS[Quality.GOOD]} | states
