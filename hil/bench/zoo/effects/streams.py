"""Changes of flow, of bypasses and of conductances."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hil.bench.zoo.effects.effect import AcceptedAnswer, EffectType, Injection, NoSuchPlaceError, Scene
from hil.bench.zoo.plants import (
    ABOVE,
    FAN_COLUMN,
    FLOW,
    GATE,
    LATCH,
    LINEAR,
    LINK,
    POWER,
    ROOM,
    Array,
    BuiltPart,
    Modifier,
)

Course = Callable[[Scene], Array]
FLOW_ANSWERS = (AcceptedAnswer("flow", "loop"), AcceptedAnswer("actuator", "pump_speed"))


def _flow(course: Course, law: int = 0) -> Callable[[Scene], Injection]:
    """Return a builder of a changed flow of the first loop; a law lets it follow the temperature at the pump."""

    def build(s: Scene) -> Injection:
        cell = int(s.plant.network.loop_pump_cell[0])
        middle = s.quantile(cell, 0.5)
        span = max(s.quantile(cell, 0.95) - s.quantile(cell, 0.05), 1.0)
        first, most = (0.05, 0.8) if law in (0, LATCH) else (0.1 / span, 1.2 / span)
        high, low = s.quantile(cell, 0.6), s.quantile(cell, 0.4)
        reference = middle if law == LINEAR else high
        mods = (Modifier(FLOW, 0, -course(s), law, cell, ROOM, reference, low),)
        return Injection("1" if law in (0, LATCH) else "1/K", first, most, FLOW_ANSWERS, "loop", s.onset_s, mods)

    return build


def _bypass(course: Course, law: int = 0) -> Callable[[Scene], Injection]:
    def build(s: Scene) -> Injection:
        b = s.some_part("read", "inner")
        if sum(other.part.node == b.part.node for other in s.plant.parts) > 2:
            raise NoSuchPlaceError("a share of one of many cells is not the bypass of their node")
        cell = b.water[0]
        high = s.quantile(cell, 0.6)
        span = max(s.quantile(cell, 0.98) - high, 0.3)
        first, most = (0.08, 0.85) if law != ABOVE else (0.3 / span, 1.5 / span)
        mods = (Modifier(GATE, b.gate, course(s), law, cell, ROOM, high, s.quantile(cell, 0.4)),)
        answers: tuple[AcceptedAnswer, ...] = (AcceptedAnswer("flow", b.part.node),)
        if b.part.fan:
            answers = (*answers, AcceptedAnswer("heat_rejection", b.part.node))
        return Injection("1" if law != ABOVE else "1/K", first, most, answers, b.part.node, s.onset_s, mods)

    return build


def _fouling(course: Course, law: int = 0) -> Callable[[Scene], Injection]:
    """Return a builder of a radiator that rejects less."""

    def build(s: Scene) -> Injection:
        b = s.some_part("fan")
        cell = b.water[0]
        answers = (
            AcceptedAnswer("heat_rejection", b.part.node),
            AcceptedAnswer("actuator", "fan_speed"),
            AcceptedAnswer("heat_loss", b.part.node),
        )
        p0, first, most = s.quantile(cell, 0.6), 0.08, 0.85
        if law == POWER:
            p0, gap = 1.0, float(np.mean(s.calm[:, cell] - s.drive.room))
            first, most = 0.1 / max(gap, 1.0), 0.6 / max(gap, 1.0)
        mods = (Modifier(LINK, b.fan_group, -course(s), law, cell, ROOM, p0, s.quantile(cell, 0.4)),)
        return Injection("1" if law != POWER else "1/K", first, most, answers, b.part.node, s.onset_s, mods)

    return build


def _fan_law(course: Course) -> Course:
    def build(s: Scene) -> Array:
        if not s.varies(FAN_COLUMN):
            raise NoSuchPlaceError("the fan stands still")
        return course(s)

    return build


def _film(course: Course) -> Callable[[Scene], Injection]:
    """Return a builder of a worse contact of a wall that is read on the metal, or of a heat exchanger."""

    def build(s: Scene) -> Injection:
        found: list[BuiltPart] = [b for b in s.plant.parts if b.part.reads == "metal" or b.part.name == "hot"]
        if not found:
            raise NoSuchPlaceError("no wall is read and there is no exchanger")
        b = found[int(s.rng.integers(len(found)))]
        answers: tuple[AcceptedAnswer, ...]
        if b.part.name == "hot":
            answers = (AcceptedAnswer("coupling", "cold"), AcceptedAnswer("coupling", "hot"))
        else:
            # Twins hold a wall and its water as one volume: its share of the exchange is all that may move.
            answers = (AcceptedAnswer("flow", b.part.node), AcceptedAnswer("coupling", b.part.node))
        mods = (Modifier(LINK, b.film_group, -course(s)),)
        return Injection("1", 0.15, 0.9, answers, b.part.node, s.onset_s, mods)

    return build


STREAM_EFFECTS: tuple[EffectType, ...] = (
    EffectType("flow: less", "flow", True, _flow(lambda s: s.step)),
    EffectType("flow: falls", "flow", True, _flow(lambda s: s.ramp)),
    EffectType("flow: follows a temperature", "flow", False, _flow(lambda s: s.step, LINEAR)),
    EffectType("flow: periodic", "flow", False, _flow(lambda s: s.pulses)),
    EffectType("flow: less in one interval", "flow", False, _flow(lambda s: s.interval)),
    EffectType("flow: switched by a temperature", "flow", False, _flow(lambda s: s.step, LATCH), True),
    EffectType("flow: wanders", "flow", False, _flow(lambda s: 0.5 * np.clip(s.erratic, -2.0, 2.0))),
    EffectType("bypass: constant", "bypass", True, _bypass(lambda s: s.step)),
    EffectType("bypass: opens slowly", "bypass", True, _bypass(lambda s: s.ramp)),
    EffectType("bypass: opens with temperature", "bypass", False, _bypass(lambda s: s.step, ABOVE)),
    EffectType("bypass: periodic", "bypass", False, _bypass(lambda s: s.pulses), True),
    EffectType("radiator: fouled", "conductance", True, _fouling(lambda s: s.step)),
    EffectType("radiator: fouls slowly", "conductance", True, _fouling(lambda s: s.ramp)),
    EffectType("radiator: fouls to a limit", "conductance", True, _fouling(lambda s: s.saturating)),
    EffectType("radiator: switched by a temperature", "conductance", False, _fouling(lambda s: s.step, LATCH)),
    EffectType("radiator: covered in one interval", "conductance", False, _fouling(lambda s: s.interval)),
    EffectType("radiator: follows the difference", "conductance", False, _fouling(lambda s: s.step, POWER)),
    EffectType(
        "radiator: draws in its own exhaust",
        "conductance",
        True,
        _fouling(_fan_law(lambda s: s.step * s.drive.fan**0.6)),
    ),
    EffectType(
        "radiator: other power of the fan",
        "conductance",
        True,
        _fouling(_fan_law(lambda s: -s.step * np.log(np.maximum(s.drive.fan, 0.05)))),
    ),
    EffectType("wall: contact worse", "conductance", False, _film(lambda s: s.step)),
    EffectType("wall: contact worsens", "conductance", False, _film(lambda s: s.ramp)),
    EffectType(
        "radiator: wanders", "conductance", False, _fouling(lambda s: 0.5 * np.clip(s.erratic, -2.0, 2.0)), True
    ),
)
