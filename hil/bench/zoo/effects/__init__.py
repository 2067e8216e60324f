"""Hidden effects of the zoo, each declared with the answers that count as right; nothing here imports `twin`.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.bench.zoo.effects.catalogue import EFFECTS, draw_effect
    from hil.bench.zoo.effects.effect import EffectType, Injection, NoSuchPlaceError, Scene

__all__ = ["EFFECTS", "EffectType", "Injection", "NoSuchPlaceError", "Scene", "draw_effect"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "catalogue": (
            "EFFECTS",
            "draw_effect",
        ),
        "effect": (
            "EffectType",
            "Injection",
            "NoSuchPlaceError",
            "Scene",
        ),
    },
)
