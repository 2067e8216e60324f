"""The Hiera-UNet alone: its configuration, blocks, encoder, decoder, heads, and boosted trees that it may correct.

The names below are the package's interface; they are loaded on first use, because some need the extra ``ml``.
Modules among them are public as a whole. Everything else is private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

if TYPE_CHECKING:
    from twin.calibrators.hiera_unet.model.config import Config, HieraError
    from twin.calibrators.hiera_unet.model.network import HieraUNet, Prediction
    from twin.calibrators.hiera_unet.model.trees import Trees


__all__ = [
    "Config",
    "HieraError",
    "HieraUNet",
    "Prediction",
    "Trees",
    "trees",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "": ("trees",),
        "config": ("Config", "HieraError"),
        "network": ("HieraUNet", "Prediction"),
        "trees": ("Trees",),
    },
)
