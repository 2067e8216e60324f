"""Errors of `hil start`, and its orderly stop."""

from __future__ import annotations


class StartError(ValueError):
    """Error of the folder or of the answers that were given; one sentence with the remedy."""


class StopRequest(Exception):
    """Stop before the end of the course, with the reason; a second `hil start` goes on there."""

    def __init__(self, reason: str, exit_code: int = 2) -> None:
        super().__init__(reason)
        self.exit_code = exit_code
