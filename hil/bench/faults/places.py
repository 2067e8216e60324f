"""Places of the machine that ran a campaign, taken out of what is published of it."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path
from typing import Protocol

PROJECT = Path(__file__).resolve().parents[3]
_PATH = re.compile(r"(?<![\w.:/])/(?:[\w.+@~-]+/)+")
_KEPT = ("/dev/", "/proc/", "/sys/")
"""These are the same on every machine."""


class Published(Protocol):
    """The texts of a result."""

    failures: list[str]
    wrong: list[str]
    reason: str


def without_places(text: str) -> str:
    """Return `text` with PROJECT for the project's folder, FOLDER for a temporary one, and `.../` for the folders of
    any other absolute path."""
    text = text.replace(str(PROJECT), "PROJECT")
    text = re.sub(re.escape(tempfile.gettempdir()) + r"/[\w.+-]+", "FOLDER", text)
    return _PATH.sub(lambda found: found[0] if found[0].startswith(_KEPT) else ".../", text)


def take_places_out(result: Published) -> None:
    """Clean the texts of a result."""
    result.failures = [without_places(text) for text in result.failures]
    result.wrong = [without_places(text) for text in result.wrong]
    result.reason = without_places(result.reason)
