"""Guardian: a small process of its own that makes a rig safe when the engine no longer can.

`plan` holds the safe values as requests in bytes, `client` is the engine's half, `process` and `wires` are the guardian
itself. The last two import the standard library alone. The guardian therefore starts in milliseconds, stays small, and
is independent of faults in the engine.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.guardian.client import Guard, GuardianClient, NoGuard

__all__ = ["Guard", "GuardianClient", "NoGuard"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "client": (
            "Guard",
            "GuardianClient",
            "NoGuard",
        ),
    },
)
