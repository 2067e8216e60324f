"""Layout of a DBC message's signals: fit in its bytes, shared bits, and messages of some signals alone."""

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
    """Return the signals that share bits, each with the others; those of `faults` do not count."""
    signals = [signal for signal in message.signals if signal.name not in faults]
    found: dict[str, list[str]] = {}
    if is_whole(signals, message):
        return found
    for number, one in enumerate(signals):
        for other in signals[number + 1 :]:
            if one.multiplexer_ids and other.multiplexer_ids:
                pair, plain = [*_chain(one, message), *_chain(other, message)], False
                pair = [signal for number, signal in enumerate(pair) if signal not in pair[:number]]
            else:
                pair, plain = [one, other], True
            if not is_whole(pair, message, plain=plain):
                found.setdefault(one.name, []).append(other.name)
                found.setdefault(other.name, []).append(one.name)
    return found or {signal.name: ["others"] for signal in signals}


def multiplexing_faults(
    message: Any, written: Mapping[tuple[str, str], str], faults: Mapping[str, str]
) -> dict[str, str]:
    """Return the multiplexed signals of a message whose frames cannot be identified, each with the cause.

    `written` is the file's text behind a signal's name, by message and name: a signal with `m2` is only in the frames
    whose multiplexor is 2. `faults` are the signals that cannot be decoded.
    """
    by_name = {signal.name: signal for signal in message.signals}
    found: dict[str, str] = {}
    for signal in message.signals:
        token = written.get((message.name, signal.name), "")
        if token.startswith("m") and not signal.multiplexer_ids:
            found[signal.name] = (
                f"is multiplexed ({token}), and the file does not say which signal selects it; mark one signal of "
                f"{message.name} with M, and give SG_MUL_VAL_ for every multiplexed signal where there are several"
            )
    for signal in message.signals:
        if not signal.multiplexer_ids or signal.name in found or signal.name in faults:
            continue
        above = [one.name for one in _chain(signal, message)[:-1]]
        bad = next((name for name in above if name in found or name in faults), None)
        if bad is not None or signal.multiplexer_signal not in by_name:
            found[signal.name] = (
                f"is multiplexed by {bad or signal.multiplexer_signal}, which cannot be read; correct it"
            )
        elif not is_whole(_chain(signal, message), message):
            found[signal.name] = f"shares bits with {', '.join(above)}, which selects it; correct one"
    return found


def multiplexed_together(signal: Any, message: Any, faults: Mapping[str, str]) -> list[Any]:
    """Return a multiplexed signal, the signals that select it, and all others that share no bit with these."""
    group = _chain(signal, message)
    for other in message.signals:
        chain = [one for one in _chain(other, message) if one not in group]
        if other.multiplexer_ids and chain and not any(one.name in faults for one in chain):
            group = [*chain, *group] if is_whole([*chain, *group], message) else group
    return group


def _chain(signal: Any, message: Any) -> list[Any]:
    """Return the signals that select a multiplexed signal, the first selector first, and the signal."""
    by_name = {one.name: one for one in message.signals}
    chain = [signal]
    while chain[0].multiplexer_ids:
        above = by_name.get(chain[0].multiplexer_signal)
        if above is None or above in chain:
            break
        chain.insert(0, above)
    return chain


def is_whole(signals: Sequence[Any], message: Any, *, plain: bool = False) -> bool:
    """Return True where cantools takes these signals as one message: they fit in it, and share no bit."""
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
