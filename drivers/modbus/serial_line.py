"""Times of bytes and silences on a serial line (Modbus over serial line V1.02, 2.5.1)."""

BITS_PER_BYTE = 11
"""Start, eight, parity or a second stop bit, stop."""
_SILENCE_ABOVE_19200_S = 1.75e-3


def silence_s(baud: int) -> float:
    """Return the gap between two frames at `baud` bit/s, in s (2.5.1.1)."""
    return 3.5 * BITS_PER_BYTE / baud if baud <= 19200 else _SILENCE_ABOVE_19200_S
