"""Hidden heat: sources, losses, exchange between parts, and water that is replaced."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hil.bench.zoo.effects.effect import AcceptedAnswer, EffectType, Injection, NoSuchPlaceError, Scene
from hil.bench.zoo.plants import (
    ABOVE,
    ALWAYS,
    EVAPORATION,
    FAN_COLUMN,
    HEAT,
    LATCH,
    LINEAR,
    LINK,
    NOTHING,
    POWER,
    ROOM,
    TRANSFER,
    Array,
    BuiltPart,
    Modifier,
)

Course = Callable[[Scene], Array]

SOURCE_SHARE, MOST_SHARE = 0.03, 0.5
"""First guess and largest hidden power as shares of the heaters' full power."""
USUAL_RISE_K = 20.0


def _spread(cells: Sequence[int], target: int, course: Array, **law: float | int) -> tuple[Modifier, ...]:
    return tuple(Modifier(target, c, course / len(cells), **law) for c in cells)  # type: ignore[arg-type]


def _cells(b: BuiltPart, where: str) -> tuple[int, ...]:
    return b.metal if where == "wall" and b.metal else b.water


def _source(course: Course, drivers: tuple[str, ...], where: str = "water") -> Callable[[Scene], Injection]:
    def build(s: Scene) -> Injection:
        b = s.some_part("metal", "read") if where == "wall" else s.some_part("read")
        first = SOURCE_SHARE * s.power_w
        return Injection(
            "W",
            first,
            MOST_SHARE * s.power_w,
            (AcceptedAnswer("heat_source", b.part.node, drivers),),
            b.part.node,
            s.onset_s,
            _spread(_cells(b, where), HEAT, course(s)),
        )

    return build


def _follows_fan(s: Scene) -> Array:
    if not s.varies(FAN_COLUMN):
        raise NoSuchPlaceError("the fan stands still")
    return s.step * s.drive.fan


def _follows_pump(s: Scene) -> Array:
    if not s.varies("pump"):
        raise NoSuchPlaceError("the pump stands still")
    return s.step * s.drive.pump[:, 0] ** 3


def _switched(law: int) -> Callable[[Scene], Injection]:
    """Return a builder of heat that the temperature of another part switches or drives."""

    def build(s: Scene) -> Injection:
        b, sensed = s.two_parts()
        cell = sensed.water[-1]
        high, low = s.quantile(cell, float(s.rng.uniform(0.5, 0.7))), s.quantile(cell, float(s.rng.uniform(0.25, 0.45)))
        size = SOURCE_SHARE * s.power_w / (1.0 if law == LATCH else max(s.quantile(cell, 0.9) - high, 0.5))
        return Injection(
            "W" if law == LATCH else "W/K",
            size,
            20.0 * size,
            (AcceptedAnswer("heat_source", b.part.node),),
            b.part.node,
            s.onset_s,
            _spread(b.water, HEAT, s.step, law=law, sense=cell, p0=high, p1=low),
        )

    return build


def _with_room(s: Scene) -> Injection:
    b = s.some_part("read")
    course = s.step * (s.drive.room - float(np.mean(s.drive.room)))
    size = SOURCE_SHARE * s.power_w / max(float(np.std(s.drive.room)), 0.3)
    answers = (AcceptedAnswer("heat_source", b.part.node), AcceptedAnswer("heat_loss", b.part.node))
    return Injection("W/K", size, 20.0 * size, answers, b.part.node, s.onset_s, _spread(b.water, HEAT, course))


def _loss(exponent: float, course: Course, drivers: tuple[str, ...] = ()) -> Callable[[Scene], Injection]:
    def build(s: Scene) -> Injection:
        b = s.some_part("read")
        mods = tuple(Modifier(HEAT, c, -course(s) / len(b.water), POWER, c, ROOM, exponent) for c in b.water)
        size = SOURCE_SHARE * s.power_w / USUAL_RISE_K**exponent
        answers = [AcceptedAnswer("heat_loss", b.part.node, drivers)]
        if b.part.fan:
            answers.append(AcceptedAnswer("heat_rejection", b.part.node))
        return Injection("W/K^n", size, 15.0 * size, tuple(answers), b.part.node, s.onset_s, mods)

    return build


def _evaporation(s: Scene) -> Injection:
    """Return evaporation from the uppermost layer, with the day's humidity, which no column records."""
    b = s.some_part("tank")
    mods = tuple(Modifier(HEAT, c, -s.step, EVAPORATION, c) for c in b.water[:1])
    # About 4 kPa lie between warm water and the room's air.
    size = SOURCE_SHARE * s.power_w / 4000.0
    return Injection(
        "W/Pa", size, 10.0 * size, (AcceptedAnswer("heat_loss", b.part.node),), b.part.node, s.onset_s, mods
    )


def _transfer(course: Course, law: int = ALWAYS, element: bool = False) -> Callable[[Scene], Injection]:
    """Return a builder of heat that goes from one part into another."""

    def build(s: Scene) -> Injection:
        a, b = s.two_parts()
        # The temperatures of two parts differ by a few kelvin, so the first guess serves for W/K too.
        size = SOURCE_SHARE * s.power_w
        kind = "coupling" if element else "heat_transfer"
        answers = (
            AcceptedAnswer(kind, a.part.node),
            AcceptedAnswer(kind, b.part.node),
            AcceptedAnswer("coupling", a.part.node),
            AcceptedAnswer("coupling", b.part.node),
            AcceptedAnswer("heat_transfer", a.part.node),
        )
        if law == POWER:
            mods: tuple[Modifier, ...] = (
                Modifier(TRANSFER, b.water[0], course(s), POWER, a.water[-1], b.water[0], 1.0, index2=a.water[-1]),
            )
        else:
            mods = (Modifier(TRANSFER, b.water[0], course(s), index2=a.water[-1]),)
        unit = "W/K" if law == POWER else "W"
        return Injection(unit, size, 10.0 * size, answers, a.part.node, s.onset_s, mods)

    return build


def _refill(hot: bool, repeated: bool) -> Callable[[Scene], Injection]:
    """Return a builder of water that is replaced by fresh water of another temperature."""

    def build(s: Scene) -> Injection:
        b = s.some_part("tank")
        fresh = float(s.rng.uniform(55.0, 65.0) if hot else s.rng.uniform(8.0, 14.0))
        minutes = float(s.rng.uniform(3.0, 15.0))
        since = s.time_s - max(s.onset_s, 0.1 * float(s.time_s[-1]))
        period = float(s.rng.uniform(2.0, 5.0)) * 3600.0
        course = ((since % period if repeated else since) < 60.0 * minutes) & (since >= 0.0)
        mods = tuple(Modifier(HEAT, c, -course.astype(np.float64) / len(b.water), LINEAR, c, p0=fresh) for c in b.water)
        most = 4000.0 * b.part.litres / (60.0 * minutes)
        answers = (AcceptedAnswer("heat_source", b.part.node), AcceptedAnswer("heat_loss", b.part.node))
        return Injection("W/K", 0.1 * most, most, answers, b.part.node, s.onset_s, mods)

    return build


def _ballast(s: Scene) -> Injection:
    p = s.plant
    link = next(k for k, g in enumerate(p.network.link_group) if g == p.ballast_group)
    water = int(p.network.link_b[link])
    b = next(b for b in p.parts if water in b.water)
    size = 3.0 * s.power_w / 100.0
    mods = (Modifier(LINK, p.ballast_group, s.step / NOTHING),)
    answers = (AcceptedAnswer("thermal_mass", b.part.node),)
    return Injection("W/K", size, 30.0 * size, answers, b.part.node, s.onset_s, mods)


def _heater_power(s: Scene) -> Array:
    return s.step * s.load


HEAT_EFFECTS: tuple[EffectType, ...] = (
    EffectType("heat into water, constant", "heat", True, _source(lambda s: s.step, ("constant",))),
    EffectType("heat into a wall, constant", "heat", False, _source(lambda s: s.step, (), "wall")),
    EffectType("heat with heater power", "heat", True, _source(_heater_power, ("heater_power", "cells_power"))),
    EffectType("heat into a wall with heater power", "heat", False, _source(_heater_power, (), "wall")),
    EffectType("heat with the square of the load", "heat", False, _source(lambda s: s.step * s.load**2, ()), True),
    EffectType("heat with the cube of the pump", "heat", True, _source(_follows_pump, ("pump_speed", "pump2_speed"))),
    EffectType("heat with the fan", "heat", True, _source(_follows_fan, ("fan_speed",))),
    EffectType("heat of the sun", "heat", True, _source(lambda s: s.sun, ("time_of_day",))),
    EffectType("heat of a lamp by the hour", "heat", False, _source(lambda s: s.lamp, ())),
    EffectType("heat that grows linearly", "heat", True, _source(lambda s: s.ramp, ())),
    EffectType("heat that saturates", "heat", True, _source(lambda s: s.saturating, ())),
    EffectType("heat that accelerates", "heat", False, _source(lambda s: s.accelerating, ()), True),
    EffectType("heat in one interval", "heat", False, _source(lambda s: s.interval, ())),
    EffectType("heat in pulses", "heat", False, _source(lambda s: s.pulses, ())),
    EffectType("heat into a wall in pulses", "heat", False, _source(lambda s: s.pulses, (), "wall"), True),
    EffectType("heat of random course", "heat", False, _source(lambda s: s.erratic, ())),
    EffectType("heat switched by a temperature", "heat", False, _switched(LATCH)),
    EffectType("heat above a temperature", "heat", False, _switched(ABOVE)),
    EffectType("heat with the room", "heat", False, _with_room),
    EffectType("loss, linear", "loss", True, _loss(1.0, lambda s: s.step)),
    EffectType("loss by natural convection", "loss", True, _loss(1.25, lambda s: s.step)),
    EffectType("loss by the square of the difference", "loss", False, _loss(2.0, lambda s: s.step)),
    EffectType("loss that grows", "loss", True, _loss(1.0, lambda s: s.ramp)),
    EffectType("loss in one interval", "loss", False, _loss(1.0, lambda s: s.interval)),
    EffectType("loss with the fan's draught", "loss", False, _loss(1.0, _follows_fan)),
    EffectType("loss in gusts", "loss", False, _loss(1.0, lambda s: np.abs(s.erratic)), True),
    EffectType("evaporation with the day's humidity", "loss", False, _evaporation),
    EffectType("coupling of two parts", "transfer", True, _transfer(lambda s: s.step, POWER, True)),
    EffectType("power from one part to another", "transfer", False, _transfer(lambda s: s.step)),
    EffectType("power from one part to another with load", "transfer", False, _transfer(_heater_power)),
    EffectType(
        "power from one part to another in one interval", "transfer", False, _transfer(lambda s: s.interval), True
    ),
    EffectType("refill with cold water", "water", False, _refill(False, False)),
    EffectType("refill with hot water", "water", False, _refill(True, False)),
    EffectType("repeated refill with cold water", "water", False, _refill(False, True), True),
    EffectType("mass put in at the room's temperature", "water", True, _ballast),
)
