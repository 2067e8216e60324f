"""Text of a file that a person writes: regular files, encodings, the line of each key.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.rig_file.text.encodings import decoded
    from drivers.rig_file.text.regular_file import MOST_DESCRIPTION, read_regular, refuse_irregular
    from drivers.rig_file.text.toml_lines import line_of, tables_of

_MODULES = {
    "encodings": ("decoded",),
    "regular_file": (
        "MOST_DESCRIPTION",
        "read_regular",
        "refuse_irregular",
    ),
    "toml_lines": (
        "line_of",
        "tables_of",
    ),
}
_HOME = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

__all__ = ["MOST_DESCRIPTION", "decoded", "line_of", "read_regular", "refuse_irregular", "tables_of"]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
