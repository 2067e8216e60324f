"""Errors of the panel that a user corrects."""

from __future__ import annotations


class PanelError(ValueError):
    """Panel that cannot be served, or a request that it refuses; the message is one plain sentence."""
