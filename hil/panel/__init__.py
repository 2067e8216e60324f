"""Browser panel of runs: a process of its own that reads journals and steers through the control socket.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.panel.errors import PanelError
    from hil.panel.server import ServeOptions, serve

__all__ = ["PanelError", "ServeOptions", "serve"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "errors": ("PanelError",),
        "server": ("ServeOptions", "serve"),
    },
)
