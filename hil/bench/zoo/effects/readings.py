"""Errors of thermometers, of the room's too, and of commands."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter, lfiltic

from hil.bench.zoo.effects.effect import (
    AcceptedAnswer,
    EffectType,
    Injection,
    NoSuchPlaceError,
    ReadingEffect,
    Scene,
    TimeCourse,
)
from hil.bench.zoo.plants import FAN_COLUMN, ROOM_COLUMN, Array

BIAS_K, MOST_BIAS_K = 0.3, 8.0
Form = Callable[[Scene, str], ReadingEffect]


def _reading(
    form: Form, unit: str, first: float, most: float, drivers: tuple[str, ...] = (), also: tuple[str, ...] = ()
) -> Callable[[Scene], Injection]:
    def build(s: Scene) -> Injection:
        column = s.some_thermometer()
        answers = (AcceptedAnswer("sensor", column, drivers), *(AcceptedAnswer(kind, column) for kind in also))
        return Injection(unit, first, most, answers, column, s.onset_s, readings={column: form(s, column)})

    return build


def _plus(course: Callable[[Scene], Array]) -> Form:
    def form(s: Scene, column: str) -> ReadingEffect:
        added = course(s)
        return lambda size, shown, _: shown + size * added

    return form


def _gain(about_c: float) -> Form:
    def form(s: Scene, column: str) -> ReadingEffect:
        step = s.step
        return lambda size, shown, _: shown + size * step * (shown - about_c)

    return form


def _square(s: Scene, column: str) -> ReadingEffect:
    step = s.step
    return lambda size, shown, _: shown + size * step * ((shown - 25.0) / 10.0) ** 2


def _toward_room(s: Scene, column: str) -> ReadingEffect:
    step, room = s.step, s.drive.room
    return lambda size, shown, _: shown + size * step * (room - shown)


def _cross_talk(s: Scene, column: str) -> ReadingEffect:
    own = next(t.node for t in s.plant.thermometers if t.column == column)
    other = str(s.rng.choice([t.column for t in s.plant.thermometers if t.node != own]))
    step = s.step
    return lambda size, shown, context: shown + size * step * (context[other] - shown)


def _lag(s: Scene, column: str) -> ReadingEffect:
    step, period = s.step, s.schedule.period_s
    return lambda size, shown, _: shown + step * (_late(shown, period, abs(size)) - shown)


def _late(course: Array, period_s: float, constant_s: float) -> Array:
    a = float(np.exp(-period_s / constant_s)) if constant_s > 0.0 else 0.0
    b, c = [1.0 - a], [1.0, -a]
    return np.asarray(lfilter(b, c, course, zi=lfiltic(b, c, [course[0]]))[0])


def _stuck(s: Scene, column: str) -> ReadingEffect:
    """Return a reading that sticks in a share `size` of the record, from the onset on."""

    def form(size: float, shown: Array, _: object) -> Array:
        first = int(np.searchsorted(s.time_s, max(s.onset_s, 0.2 * s.time_s[-1])))
        last = first + round(min(abs(size), 1.0) * (len(shown) - first))
        held = shown.copy()
        held[first:last] = shown[first]
        return held

    return form


def _steps_of(s: Scene, column: str) -> ReadingEffect:
    step = s.step
    return lambda size, shown, _: (
        shown + step * (np.round(shown / max(abs(size), 1e-9)) * max(abs(size), 1e-9) - shown) if size else shown
    )


def _with_speed(s: Scene) -> Array:
    if s.varies(FAN_COLUMN):
        return s.step * s.drive.fan
    if s.varies("pump"):
        return s.step * s.drive.pump[:, 0]
    raise NoSuchPlaceError("no speed varies")


def _room(form: Callable[[Scene], ReadingEffect], first: float, most: float) -> Callable[[Scene], Injection]:
    def build(s: Scene) -> Injection:
        answers = (AcceptedAnswer("sensor", ROOM_COLUMN),)
        return Injection("K", first, most, answers, ROOM_COLUMN, s.onset_s, recorded={ROOM_COLUMN: form(s)})

    return build


def _added(course: Callable[[Scene], Array]) -> Callable[[Scene], ReadingEffect]:
    def form(s: Scene) -> ReadingEffect:
        added = course(s)
        return lambda size, true, _: true + size * added

    return form


def _room_late(s: Scene) -> ReadingEffect:
    step, period = s.step, s.schedule.period_s
    return lambda size, true, _: true + step * (_late(true, period, abs(size)) - true)


def _command(
    column: str,
    form: Callable[[Scene], TimeCourse],
    unit: str,
    first: float,
    most: float,
    drivers: tuple[str, ...] = (),
) -> Callable[[Scene], Injection]:
    def build(s: Scene) -> Injection:
        if column != "heater_power_W" and not s.varies(column):
            raise NoSuchPlaceError(f"{column} stands still")
        what = column.rsplit("_", 1)[0]
        answers = [AcceptedAnswer("actuator", what, drivers)]
        if column == "pump_speed_pct":
            answers.append(AcceptedAnswer("flow", "loop"))
        if column == "heater_power_W":
            # Heat that follows the heater's power, at the heater, is the same physics.
            answers += (
                [AcceptedAnswer("heat_source", "heater"), AcceptedAnswer("flow", "loop")] if form is _scaled else []
            )
        if column == FAN_COLUMN:
            answers.append(AcceptedAnswer("heat_rejection", "radiator"))
        place = {"heater_power_W": "heater", FAN_COLUMN: "radiator"}.get(column, "loop")
        return Injection(unit, first, most, tuple(answers), place, s.onset_s, commands={column: form(s)})

    return build


def _scaled(s: Scene) -> TimeCourse:
    step = s.step
    return lambda size, command: command * (1.0 - size * step)


def _drooping(s: Scene) -> TimeCourse:
    step = s.step
    return lambda size, command: command * (1.0 - size * step * command / max(float(command.max()), 1e-9))


def _limited(s: Scene) -> TimeCourse:
    step = s.step

    def form(size: float, command: Array) -> Array:
        top = float(command.max()) * (1.0 - size)
        return command + step * (np.minimum(command, top) - command)

    return form


def _lagging(s: Scene) -> TimeCourse:
    step, period = s.step, s.schedule.period_s
    return lambda size, command: command + step * (_late(command, period, abs(size)) - command)


def _dead_time(s: Scene) -> TimeCourse:
    step, period = s.step, s.schedule.period_s

    def form(size: float, command: Array) -> Array:
        # Between two samples the delayed command is their mean, so that any dead time counts.
        t = np.arange(len(command)) * period
        return command + step * (np.interp(t - abs(size), t, command) - command)

    return form


def _drops_out(s: Scene) -> TimeCourse:
    pulses = s.pulses
    return lambda size, command: command * (1.0 - size * pulses)


def _mains(s: Scene) -> TimeCourse:
    day = s.step * np.sin(2.0 * np.pi * (s.hour - 5.0) / 24.0)
    return lambda size, command: command * (1.0 - size * day)


HEATER = "heater_power_W"
READING_EFFECTS: tuple[EffectType, ...] = (
    EffectType("thermometer: bias", "reading", True, _reading(_plus(lambda s: s.step), "K", BIAS_K, MOST_BIAS_K)),
    EffectType("thermometer: drift", "reading", True, _reading(_plus(lambda s: s.ramp), "K", BIAS_K, MOST_BIAS_K)),
    EffectType("thermometer: gain", "reading", True, _reading(_gain(0.0), "1", 0.01, 0.2)),
    EffectType("thermometer: gain about 25 degC", "reading", True, _reading(_gain(25.0), "1", 0.02, 0.5)),
    EffectType("thermometer: square error", "reading", False, _reading(_square, "K", 0.1, 4.0), True),
    EffectType("thermometer: lag", "reading", True, _reading(_lag, "s", 60.0, 1800.0)),
    EffectType(
        "thermometer: follows heater power",
        "reading",
        False,
        _reading(_plus(lambda s: s.step * s.load), "K", BIAS_K, MOST_BIAS_K),
    ),
    EffectType(
        "thermometer: follows a speed", "reading", False, _reading(_plus(_with_speed), "K", BIAS_K, MOST_BIAS_K)
    ),
    EffectType("thermometer: cross-talk", "reading", True, _reading(_cross_talk, "1", 0.05, 0.9)),
    EffectType("thermometer: sees the room", "reading", False, _reading(_toward_room, "1", 0.02, 0.6)),
    EffectType("thermometer: stuck", "reading", False, _reading(_stuck, "1", 0.3, 1.0)),
    EffectType(
        "thermometer: bias in one interval",
        "reading",
        False,
        _reading(_plus(lambda s: s.interval), "K", BIAS_K, MOST_BIAS_K),
    ),
    EffectType(
        "thermometer: bias in pulses",
        "reading",
        False,
        _reading(_plus(lambda s: s.pulses), "K", BIAS_K, MOST_BIAS_K),
        True,
    ),
    EffectType(
        "thermometer: bias by the hour", "reading", False, _reading(_plus(lambda s: s.lamp), "K", BIAS_K, MOST_BIAS_K)
    ),
    EffectType("thermometer: wanders", "reading", False, _reading(_plus(lambda s: s.erratic), "K", 0.2, MOST_BIAS_K)),
    EffectType("thermometer: coarse steps", "reading", False, _reading(_steps_of, "K", 1.0, 8.0), True),
    EffectType("room: bias", "room", True, _room(_added(lambda s: s.step), 0.5, 10.0)),
    EffectType("room: thermometer in the sun", "room", False, _room(_added(lambda s: s.sun), 1.0, 15.0)),
    EffectType("room: thermometer in the exhaust", "room", False, _room(_added(lambda s: s.step * s.load), 1.0, 15.0)),
    EffectType("room: thermometer late", "room", False, _room(_room_late, 3600.0, 36000.0), True),
    EffectType("heater: gain", "actuator", True, _command(HEATER, _scaled, "1", 0.03, 0.6, ("constant",))),
    EffectType("heater: droop", "actuator", True, _command(HEATER, _drooping, "1", 0.05, 0.6, ("heater_power",))),
    EffectType("heater: limited", "actuator", False, _command(HEATER, _limited, "1", 0.1, 0.7)),
    EffectType("heater: lag", "actuator", True, _command(HEATER, _lagging, "s", 60.0, 1800.0)),
    EffectType("heater: dead time", "actuator", False, _command(HEATER, _dead_time, "s", 60.0, 1800.0)),
    EffectType("heater: drops out", "actuator", False, _command(HEATER, _drops_out, "1", 0.1, 1.0)),
    EffectType("heater: mains by the hour", "actuator", False, _command(HEATER, _mains, "1", 0.03, 0.5), True),
    EffectType("fan: gain", "actuator", True, _command(FAN_COLUMN, _scaled, "1", 0.05, 0.7)),
    EffectType("pump: lag", "actuator", True, _command("pump_speed_pct", _lagging, "s", 120.0, 1800.0), True),
)
