"""Network inputs: a record on the network's clock, deviations of parameters, channels, features and windows.

The names below are the package's interface; they are loaded on first use. Modules among them are public as a whole.
Everything else is private to the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.calibrators.hiera_unet.data.channels import ChannelTable
    from twin.calibrators.hiera_unet.data.features import Features, Frame
    from twin.calibrators.hiera_unet.data.parameters import Deviations
    from twin.calibrators.hiera_unet.data.series import ResampledSeries
    from twin.calibrators.hiera_unet.data.subject import Subject
    from twin.calibrators.hiera_unet.data.windows import Windows

_MODULES = {
    "channels": ("ChannelTable",),
    "features": ("Features", "Frame"),
    "parameters": ("Deviations",),
    "series": ("ResampledSeries",),
    "subject": ("Subject",),
    "windows": ("Windows",),
}
_HOME = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

_PUBLIC_MODULES = ("channels", "parameters", "series")

__all__ = [
    "ChannelTable",
    "Deviations",
    "Features",
    "Frame",
    "ResampledSeries",
    "Subject",
    "Windows",
    "channels",
    "parameters",
    "series",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name in _PUBLIC_MODULES:
        return import_module(f"{__name__}.{name}")
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return __all__
