"""Errors of the tower's commands that a user can mend."""

from __future__ import annotations


class TowerOutputError(Exception):
    """A result cannot be written; one sentence that names the folder and the remedy."""
