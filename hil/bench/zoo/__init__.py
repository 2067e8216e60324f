"""Zoo of random plants for the blind trial of the diagnosis.

The plants are distributed and share no code with the twins. See `README.md` of this folder.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from hil.lazy_names import lazy_names

__all__ = ["case", "tables", "trial", "twins", "visibility"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "": (
            "case",
            "tables",
            "trial",
            "twins",
            "visibility",
        ),
    },
)
