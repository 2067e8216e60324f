"""Errors of a stream: those that a user corrects, and a store that may come back."""

from __future__ import annotations


class StreamError(ValueError):
    """Stream that cannot be made; the message is one plain sentence with the remedy."""


class StoreDownError(ConnectionError):
    """Store that does not answer at present; the message is one plain sentence. Trying again can help."""
