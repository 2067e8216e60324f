"""The calibrators `hiera_unet` and `hiera_ls`: loaded ensemble, history, gates, agreement, proposal and service.

The names below are the package's interface; they are loaded on first use, because some need the extra ``ml``.
Modules among them are public as a whole. Everything else is private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

if TYPE_CHECKING:
    from twin.calibrators.hiera_unet.serve.members import Ensemble, load_ensemble
    from twin.calibrators.hiera_unet.serve.refined import RefinedCalibrator
    from twin.calibrators.hiera_unet.serve.service import HieraUNetCalibrator


__all__ = [
    "Ensemble",
    "HieraUNetCalibrator",
    "RefinedCalibrator",
    "gates",
    "load_ensemble",
    "members",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "": ("gates", "members"),
        "members": ("Ensemble", "load_ensemble"),
        "refined": ("RefinedCalibrator",),
        "service": ("HieraUNetCalibrator",),
    },
)
