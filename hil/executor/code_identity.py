"""Identity of the code that runs a task: results of different sources must not be mixed."""

from __future__ import annotations

import functools
import hashlib
import sys
from dataclasses import dataclass
from pathlib import Path

from hil import __version__

PROJECT = Path(__file__).resolve().parents[2]
PACKAGES = ("hil", "drivers", "twin")


@dataclass(frozen=True, slots=True)
class CodeIdentity:
    """Version of hil and of Python, and a digest of the sources."""

    hil: str
    python: str
    sources: str

    def difference(self, other: CodeIdentity) -> str:
        """Return how `other` differs from this, as `hil 0.1.0, here it is 0.2.0`; empty where it does not."""
        for name, theirs, ours in (("hil", other.hil, self.hil), ("Python", other.python, self.python)):
            if theirs != ours:
                return f"{name} {theirs}, here it is {ours}"
        if other.sources != self.sources:
            return f"other sources of hil {other.hil} ({other.sources}, here {self.sources})"
        return ""


@functools.cache
def code_identity() -> CodeIdentity:
    """Return the identity of the code of this process; raises OSError if a source cannot be read."""
    digest = hashlib.sha256()
    for package in PACKAGES:
        for path in sorted((PROJECT / package).rglob("*.py")):
            digest.update(path.relative_to(PROJECT).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return CodeIdentity(__version__, "{}.{}".format(*sys.version_info), digest.hexdigest()[:12])
