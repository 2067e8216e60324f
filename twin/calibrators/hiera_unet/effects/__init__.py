"""The subject "unmodelled effects": where power enters that the twin lacks, how much, since when and of which kind.

The names below are the package's interface; they are loaded on first use, because most of them need the extra ``ml``.
Everything else is private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

if TYPE_CHECKING:
    from twin.calibrators.hiera_unet.effects.balance import Balance, Figures, Hypothesis
    from twin.calibrators.hiera_unet.effects.member import EffectsMember, load_effects, save_effects
    from twin.calibrators.hiera_unet.effects.watch import EffectAnswer, EffectsWatch

__all__ = [
    "Balance",
    "EffectAnswer",
    "EffectsMember",
    "EffectsWatch",
    "Figures",
    "Hypothesis",
    "load_effects",
    "save_effects",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "balance": ("Balance", "Figures", "Hypothesis"),
        "member": ("EffectsMember", "load_effects", "save_effects"),
        "watch": ("EffectAnswer", "EffectsWatch"),
    },
)
