"""All effects of the zoo, and their draw."""

from __future__ import annotations

import numpy as np

from hil.bench.zoo.effects.effect import EffectType, Injection, NoSuchPlaceError, Scene
from hil.bench.zoo.effects.heat import HEAT_EFFECTS
from hil.bench.zoo.effects.readings import READING_EFFECTS
from hil.bench.zoo.effects.streams import STREAM_EFFECTS

EFFECTS: tuple[EffectType, ...] = (*HEAT_EFFECTS, *READING_EFFECTS, *STREAM_EFFECTS)


def draw_effect(scene: Scene, order: np.random.Generator, sealed: bool) -> tuple[EffectType, Injection]:
    """Draw an effect that the scene has a place for; reserved ones come with sealed families alone.

    Raises
    ------
    NoSuchPlaceError
        The scene has no place for any effect.
    """
    known = [e for e in EFFECTS if sealed or not e.reserved]
    for k in order.permutation(len(known)):
        try:
            return known[k], known[k].build(scene)
        except NoSuchPlaceError:
            continue
    raise NoSuchPlaceError(f"no effect fits {scene.plant.family}")
