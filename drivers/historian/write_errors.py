"""Reasons why a file cannot be written, each with its remedy."""

from __future__ import annotations

import errno

_REMEDIES = {
    errno.ENOSPC: "make room",
    errno.EDQUOT: "make room",
    errno.EROFS: "choose a place that can be written",
    errno.EACCES: "choose a place that this user may write",
    errno.EPERM: "choose a place that this user may write",
    errno.ENAMETOOLONG: "choose a shorter path",
    errno.EIO: "check the disk, or choose another",
}


def why_unwritten(error: OSError) -> str:
    """Return the reason and the remedy, such as "No space left on device; make room"."""
    return f"{error.strerror or error}; {_REMEDIES.get(error.errno or 0, 'choose another path')}"
