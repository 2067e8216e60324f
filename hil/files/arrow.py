"""Arrow without pandas in the process of a command.

Arrow looks for pandas when it makes its first array, and loads it where another library brought it along (asammdf,
crepes): 0.2 s of processor time and 40 MB, for types that no code here uses. It looks once in a process. Programs that
import hil may use pandas themselves, so only a command spares it.
"""

from __future__ import annotations

import sys

_LIBRARY = "pandas"
_spared = False


class _Absent:
    """Finder of modules that finds the library not installed."""

    def find_spec(self, name: str, _path: object = None, _target: object = None) -> None:
        if name == _LIBRARY:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def spare_pandas() -> None:
    """Say that this process is that of a command."""
    global _spared
    _spared = True


def look_for_pandas() -> None:
    """Have Arrow look for pandas now; in the process of a command it finds none, unless it is loaded already."""
    global _spared
    if not _spared or _LIBRARY in sys.modules:
        return
    import pyarrow as pa

    _spared, absent = False, _Absent()
    sys.meta_path.insert(0, absent)
    try:
        pa.array([0])
    finally:
        sys.meta_path.remove(absent)
