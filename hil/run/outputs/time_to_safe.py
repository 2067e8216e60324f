"""Time from the loss of the engine to a rig that its guardian has made safe."""

from __future__ import annotations

SILENCE_S = 1.0
"""So long the engine may be silent before the guardian acts, s."""
SAFE_WITHIN_S = 2.0
"""Time from the loss of the engine to safe values that a device admits which answers as soon as it is connected, s."""


def takes_s(connect_delay_s: float) -> float:
    """Return the time from the loss of the engine to safe values where the guardian has to connect first, s."""
    return SILENCE_S + connect_delay_s + (SAFE_WITHIN_S - SILENCE_S) / 2.0
