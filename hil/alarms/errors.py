"""Errors of alarms that a user corrects, and a message that could not be sent."""

from __future__ import annotations


class AlarmError(ValueError):
    """Alarm that is not known, or an act that its state does not admit; the message is one plain sentence."""


class NotSentError(ConnectionError):
    """Message that an address did not take; the message is one plain sentence without a secret."""
