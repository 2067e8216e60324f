"""Twin files: TOML text to a validated network and back, and a twin file from a data sheet.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.twinfile.datasheet import from_datasheet
    from twin.twinfile.toml_text import dump, from_tables, is_edited, load, parse, read_text, save, to_tables

_MODULES = {
    "datasheet": ("from_datasheet",),
    "toml_text": (
        "dump",
        "from_tables",
        "is_edited",
        "load",
        "parse",
        "read_text",
        "save",
        "to_tables",
    ),
}
_HOME = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

__all__ = ["dump", "from_datasheet", "from_tables", "is_edited", "load", "parse", "read_text", "save", "to_tables"]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
