"""Application packages: command line, runs, journal, records, diagnosis, reports and benchmarks.

The packages below are the interface; each names its own public objects. They are loaded on first use.
"""

from __future__ import annotations

from hil.lazy_names import lazy_names

__version__ = "0.2.0"

__all__ = [
    "__version__",
    "bench",
    "cli",
    "diagnosis",
    "files",
    "guardian",
    "journal",
    "profile",
    "record",
    "report",
    "review",
    "rig",
    "run",
    "run_folder",
    "synthetic",
    "tower",
    "tracking",
    "training",
]

__getattr__, __dir__ = lazy_names(__name__, {"": tuple(name for name in __all__ if name != "__version__")})
