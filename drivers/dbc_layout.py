"""Layout of a DBC message's signals: which fit in its bytes, which share bits, and messages of some of them alone."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any


def layout_faults(message: Any) -> dict[str, str]:
    """Return the signals of a message that cannot be decoded, and why."""
    found: dict[str, str] = {}
    for signal in message.signals:
        if not is_whole([signal], message):
            found[signal.name] = f"does not fit in the {message.length} bytes of {message.name}; correct one"
        elif signal.scale == 0 or not all(map(_is_finite, (signal.scale, signal.offset))):
            found[signal.name] = "has a factor that loses the value; correct it"
        elif not all(_is_finite(bound or 0) for bound in (signal.minimum, signal.maximum)):
            found[signal.name] = "has a range that is no pair of numbers; correct it"
    return found


def _is_finite(number: float) -> bool:
    try:
        return math.isfinite(float(number))
    except OverflowError:  # a whole number of hundreds of digits
        return False


def shared_bits(message: Any, faults: Mapping[str, str]) -> dict[str, list[str]]:
    """Return the signals that share bits with others, and with which; those of `faults` do not count."""
    signals = [signal for signal in message.signals if signal.name not in faults]
    found: dict[str, list[str]] = {}
    if is_whole(signals, message):
        return found
    for number, one in enumerate(signals):
        for other in signals[number + 1 :]:
            apart = one.multiplexer_ids and other.multiplexer_ids
            if not apart and not is_whole([one, other], message, plain=True):
                found.setdefault(one.name, []).append(other.name)
                found.setdefault(other.name, []).append(one.name)
    return found or {signal.name: ["others"] for signal in signals}


def is_whole(signals: Sequence[Any], message: Any, *, plain: bool = False) -> bool:
    """Return whether cantools takes these signals as one message: they fit in it, and share no bit."""
    if any(signal.start >= 8 * message.length for signal in signals):
        return False
    try:
        part_of(signals, message, plain=plain or len(signals) == 1)
    except Exception:  # cantools raises errors of several unrelated types
        return False
    return True


def part_of(signals: Sequence[Any], message: Any, *, plain: bool = False) -> Any:
    """Return a message of these signals alone; `plain` takes them as if none were multiplexed."""
    if plain:
        signals = [copy.copy(signal) for signal in signals]
        for signal in signals:
            signal.is_multiplexer, signal.multiplexer_ids, signal.multiplexer_signal = False, None, None
    part: Callable[..., Any] = type(message)
    return part(
        message.frame_id,
        message.name,
        message.length,
        list(signals),
        is_extended_frame=message.is_extended_frame,
        strict=True,
    )
