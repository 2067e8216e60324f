"""Network inputs: a record on the network's clock, deviations of parameters, channels, features and windows.

The names below are the package's interface; they are loaded on first use. Modules among them are public as a whole.
Everything else is private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

if TYPE_CHECKING:
    from twin.calibrators.hiera_unet.data.channels import ChannelTable
    from twin.calibrators.hiera_unet.data.features import Features, Frame
    from twin.calibrators.hiera_unet.data.parameters import Deviations
    from twin.calibrators.hiera_unet.data.series import ResampledSeries
    from twin.calibrators.hiera_unet.data.subject import Subject
    from twin.calibrators.hiera_unet.data.windows import Windows


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

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "": ("channels", "parameters", "series"),
        "channels": ("ChannelTable",),
        "features": ("Features", "Frame"),
        "parameters": ("Deviations",),
        "series": ("ResampledSeries",),
        "subject": ("Subject",),
        "windows": ("Windows",),
    },
)
