"""Ledger of the trial: a chain of lines, each with the hash of the one before.

Of every case it holds that the truth was sealed, that the answer was handed in, and that the truth was opened, in this
order; it refuses any other.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

EVENTS = ("sealed", "answered", "opened")
NOTE = "noted"
"""Event of a line about the trial as a whole."""


class LedgerError(RuntimeError):
    """Error of an entry out of order, or of a file that differs from its entry."""


class Ledger:
    """Ledger in the file at `path`, which it appends to."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._last = ""
        self._state: dict[str, dict[str, str]] = {}
        if path.is_file():
            for line in path.read_text(encoding="utf-8").splitlines():
                self._take(json.loads(line), line)

    def _take(self, entry: dict[str, str], line: str) -> None:
        if entry["before"] != self._last:
            raise LedgerError(f"{self._path}: the line of {entry['case']} does not follow the one above it")
        self._last = hashlib.sha256(line.encode()).hexdigest()
        if entry["event"] == NOTE:
            return
        if entry["event"] == "sealed":
            self._state[entry["case"]] = {}
        self._state[entry["case"]][entry["event"]] = entry["sha256"]

    def write(self, case: str, event: str, sha256: str) -> None:
        """Append a line; raise LedgerError if it is out of order."""
        have = self._state.get(case, {})
        turn = EVENTS.index(event)
        if event != "sealed" and tuple(have) != EVENTS[:turn]:
            raise LedgerError(f"{case} cannot be {event}: so far it was {', '.join(have) or 'not even sealed'}")
        if event == "opened" and sha256 != have["sealed"]:
            raise LedgerError(f"the truth of {case} is not the one that was sealed")
        self._append({"case": case, "event": event, "sha256": sha256, "before": self._last})

    def note(self, subject: str, text: str) -> None:
        """Append a line about the trial as a whole: its subject, and a text in place of a hash."""
        self._append({"case": subject, "event": NOTE, "text": text, "before": self._last})

    def _append(self, entry: dict[str, str]) -> None:
        line = json.dumps(entry)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(line + "\n")
        self._take(json.loads(line), line)


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
