"""Decides where numba may keep machine code of the plant: it unpickles, and so executes, what it finds there.

Beside the source it is as safe as the source itself. NUMBA_CACHE_DIR may name a folder that others can write.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path


def may_cache() -> bool:
    """Return whether the folder that numba is told to use, if any, is this user's and nobody else may write it."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    if not given:
        return True
    try:
        status = Path(given).stat()
    except OSError:
        return False
    return status.st_uid == os.getuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
