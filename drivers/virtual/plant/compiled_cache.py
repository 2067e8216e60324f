"""Check of the folder in which numba caches machine code of the plant: numba unpickles, so executes, its files.

Beside the source it is as safe as the source itself. NUMBA_CACHE_DIR may name a folder that others can write.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path


def may_cache() -> bool:
    """Return True where the folder of NUMBA_CACHE_DIR, if set, is this user's and nobody else may write it."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    if not given:
        return True
    try:
        status = Path(given).stat()
    except OSError:
        return False
    return status.st_uid == os.getuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
