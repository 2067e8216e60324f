"""File beside the journal with the position that a broker has confirmed, and the lock of the stream that writes it."""

from __future__ import annotations

import fcntl
import json
import os
import time
from pathlib import Path

from hil.files import parse_json, replacing
from hil.stream.address import Address
from hil.stream.errors import StreamError
from hil.stream.store import Position

_SYNC_S = 1.0
"""Longest time by which the disk may be behind the file, s: a power cut repeats that much, a killed process nothing."""


class PositionFile:
    """File `stream-<name>.json` of one run and one address, held by one process at a time.

    With `everything` a position up to which not every sample was sent does not count.

    Raises
    ------
    StreamError
        Another process streams the run to this address, or the folder takes no file.
    """

    def __init__(self, folder: Path, address: Address, everything: bool = False) -> None:
        self._everything = everything
        self._path = folder / f"stream-{address.file_name}.json"
        self._shown = address.shown
        self._synced_at = 0.0
        # The file itself is replaced, so that a lock on it would not last.
        beside = self._path.with_suffix(".lock")
        try:
            self._lock = os.open(beside, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise self._unwritable(error) from None
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self._lock)
            raise StreamError(f"another process streams {folder} to {address.shown}; end it first") from None
        except OSError:
            pass  # a file system without locks

    @property
    def path(self) -> Path:
        """Return the file."""
        return self._path

    def read(self) -> Position | None:
        """Return the stored position, None where there is none that counts.

        Raises
        ------
        StreamError
            The file is damaged.
        """
        try:
            document = parse_json(self._path.read_text(encoding="utf-8"))
            tick, event = document["tick"], document["event"]
            if type(tick) is not int or type(event) is not int:
                raise TypeError
            if self._everything and document.get("all") is not True:
                return None
        except FileNotFoundError:
            return None
        except (OSError, ValueError, TypeError, KeyError):
            raise StreamError(f"{self._path} is damaged; remove it, and the run is sent from its start again") from None
        return Position(tick, event)

    def write(self, position: Position) -> None:
        """Replace the stored position.

        Raises
        ------
        StreamError
            The folder takes no file.
        """
        document = {"to": self._shown, "tick": position.tick, "event": position.event, "all": self._everything}
        text = json.dumps(document) + "\n"
        now = time.monotonic()
        try:
            if now - self._synced_at >= _SYNC_S:
                with replacing(self._path) as unfinished:
                    unfinished.write_text(text, encoding="utf-8")
                self._synced_at = now
                return
            unfinished = self._path.with_suffix(".part")
            unfinished.write_text(text, encoding="utf-8")
            unfinished.replace(self._path)
        except OSError as error:
            raise self._unwritable(error) from None

    def close(self) -> None:
        """Release the lock."""
        os.close(self._lock)

    def _unwritable(self, error: OSError) -> StreamError:
        return StreamError(f"{self._path} cannot be written ({error.strerror}); make room and check the permissions")
