"""Statement about the place of an effect that a twin does not model, shared by tracking and diagnosis."""

from __future__ import annotations

from twin.discovery.effects.phrases import agreeing, amount, clock

WHOLE = 9.5
"""Power, W, from which it is given in whole watts; a smaller one has two digits."""
KILO = 10_000.0
"""Power, W, from which it is given in kilowatts."""
PASSING = "of the flow"
"""Unit of what passes a place, which is a share of its flow."""


def disturbance_statement(
    where: str,
    value: float,
    unit: str,
    interval: tuple[float, float] | None = None,
    since_s: float | None = None,
    average: bool = False,
) -> str:
    """Return the statement, without a full stop, as `tank gives off 44 W (32 to 57) that the twin does not model`.

    Parameters
    ----------
    where
        Node, sensor, input column or element.
    value
        Size in `unit`: W for heat that enters the place, K for an error of a reading, else a change of the place's own.
    interval
        Bounds of `value`, in the same unit and with the same sign.
    since_s
        Onset in the record's time, s; None for all of the time at hand.
    average
        True if `value` is the mean of a course, and `interval` its range.
    """
    since = f", from {clock(since_s)} on" if since_s is not None and since_s > 0.0 else ""
    if interval is not None and average and _both_ways(*interval):
        between = f"between {_sized(interval[0], unit)} and {_sized(interval[1], unit)}"
        verb = agreeing(where, {"W": "gives off", "K": "is off by"}.get(unit, "differs from the twin by"))
        rest = " that the twin does not model" if unit == "W" else ""
        return f"{where.replace('_', ' ') if unit not in ('W', 'K') else where} {verb} {between}{rest}{since}"
    low, high = sorted(-x if value < 0.0 else x for x in interval or (value, value))
    spread = f" ({_bare(low, unit)} to {_bare(high, unit)})" if interval is not None else ""
    size = f"{_sized(abs(value), unit)}{' on average' if average else ''}{spread}"
    if unit == "W":
        verb = agreeing(where, "takes up" if value < 0.0 else "gives off")
        text = f"{where} {verb} {size} that the twin does not model"
    elif unit == "K":
        text = f"{where} {agreeing(where, 'reads')} too {'low' if value < 0.0 else 'high'} by {size}"
    elif unit == PASSING and value > 0.0:
        text = f"{where} {agreeing(where, 'is')} bypassed by {size}"
    else:
        change = f"{size} {'less' if value < 0.0 else 'more'}"
        text = f"{where.replace('_', ' ')} {agreeing(where, 'has')} {change} than the twin models"
    return text + since


def _both_ways(low: float, high: float) -> bool:
    """Return True if a course goes about as far to either side, so that its mean tells nothing."""
    return low < 0.0 < high and min(-low, high) > 0.5 * max(-low, high)


def _sized(value: float, unit: str) -> str:
    if unit != "W" or abs(value) >= KILO:
        return amount(value, unit)
    return f"{value:.0f} W" if abs(value) >= WHOLE else f"{value:.2g} W"


def _bare(value: float, unit: str) -> str:
    """Return a bound without its unit, unless it is one that `amount` scales."""
    if unit == "W" and abs(value) >= KILO:
        return amount(value, unit)
    return _sized(value, unit).split(" ")[0]
