"""Locks that let one run drive a rig.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.run.locks.lock_folder import RigLockError
    from hil.run.locks.rig_lock import RigBusyError, RigClaim, claimed

__all__ = ["RigBusyError", "RigClaim", "RigLockError", "claimed"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "lock_folder": ("RigLockError",),
        "rig_lock": (
            "RigBusyError",
            "RigClaim",
            "claimed",
        ),
    },
)
