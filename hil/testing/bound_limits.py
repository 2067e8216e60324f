"""Relation of limits to a rig: signals, units and times are checked, and amounts get the units of their signals."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from drivers.signals import SUFFIX_OF_UNIT, Signal
from hil.report import pair_actuators
from hil.testing.limits import (
    TIMES_S,
    Amount,
    Bound,
    Compared,
    Follows,
    NoEffect,
    NoTrip,
    Settles,
    Statement,
    Trips,
    TwinError,
    UnitError,
    While,
    difference_unit,
    factor_to,
)
from hil.testing.plan import Limit, Plan, TestPlanError

CONSTANT_S = 60.0
"""Time for which a set-point must be constant before its read-back counts, s, where a limit names none: the time that
reports use, after ramps and lags."""


@dataclass(frozen=True, slots=True)
class RigSignals:
    """Names that limits may use.

    `twin_sensors` maps each sensor of the twin to its columns, `twins` names the twins of the run, and `duration_s` is
    the length of the profile, s. `source` names the rig or run in messages. `longest_hold_s` is the longest time
    between two changes of set-points in the profile, s, None where that is not known.
    """

    signals: tuple[Signal, ...]
    twin_sensors: Mapping[str, tuple[str, ...]]
    twins: tuple[str, ...]
    duration_s: float
    period_s: float
    source: str
    longest_hold_s: float | None = None


@dataclass(frozen=True, slots=True)
class BoundLimit:
    """Limit with its columns, amounts in `unit`, and times in s of profile time.

    A limit on a sensor of several columns holds for each of `columns`. `setpoint` is the column of the set-point that a
    reading follows. `condition` is the column of the window's condition.
    """

    limit: Limit
    statement: Statement
    columns: tuple[str, ...]
    unit: str
    from_s: float
    to_s: float
    condition: str | None = None
    while_: Bound | None = None
    setpoint: str | None = None


class _MismatchError(ValueError):
    """Mistake of one limit, without its place."""


def bind(plan: Plan, known: RigSignals) -> tuple[BoundLimit, ...]:
    """Return the limits of `plan` for a rig or run.

    Raises
    ------
    TestPlanError
        A signal or twin is unknown, a unit is missing or does not fit, or a time is beyond the profile: one sentence
        for each.
    """
    found, problems = [], []
    for step in plan.steps:
        if step.to_s > known.duration_s:
            problems.append(
                f"{step.place}: step {step.name} ends at {step.to_s:g} s, after the profile's end at "
                f"{known.duration_s:g} s; shorten the step or extend the profile"
            )
    for limit in plan.limits:
        try:
            found.append(_bound(limit, known))
        except (_MismatchError, UnitError) as error:
            problems.append(f"{limit.place}: limit {limit.id}: {limit.text!r} {error}")
    if problems:
        raise TestPlanError("\n".join(problems))
    return tuple(found)


def _bound(limit: Limit, known: RigSignals) -> BoundLimit:
    statement, window = limit.sentence.statement, limit.sentence.window
    from_s = 0.0 if window.from_s is None else window.from_s
    to_s = known.duration_s if window.to_s is None else window.to_s
    for time_s in (from_s, to_s):
        if time_s > known.duration_s or (time_s == from_s and from_s >= known.duration_s):
            raise _MismatchError(
                f"is for {time_s:g} s, and the profile ends at {known.duration_s:g} s; correct the time or extend the "
                "profile"
            )
    is_timed = window.from_s is not None or window.to_s is not None
    if isinstance(statement, NoEffect) and (is_timed or window.while_ is not None):
        raise _MismatchError("judges the whole run; take its times and conditions out")
    if isinstance(statement, NoTrip | Trips) and window.while_ is not None:
        raise _MismatchError("judges trips, which no `while` applies to; give it times instead")
    if isinstance(statement, NoEffect) and not known.twin_sensors:
        raise _MismatchError("judges a diagnosis, which needs a twin, and there is none; give the rig one (--twin)")
    if isinstance(statement, Trips) and statement.signal is not None:
        columns, _, _ = _resolve(statement.signal, known)
        names = tuple(signal.name for signal in known.signals if signal.column in columns)
        statement = replace(statement, names=names)
    if isinstance(statement, NoEffect | NoTrip | Trips):
        return BoundLimit(limit, statement, (), "", from_s, to_s)
    if isinstance(statement, TwinError):
        made = _of_twin(limit, statement, known, from_s, to_s)
    elif isinstance(statement, Follows):
        made = _following(limit, statement, known, from_s, to_s)
    elif isinstance(statement, Settles):
        made = _settling(limit, statement, known, from_s, to_s)
    else:
        made = _compared(limit, statement, known, from_s, to_s)
    return made if window.while_ is None else _with_condition(made, window.while_, known)


def _with_condition(made: BoundLimit, condition: While, known: RigSignals) -> BoundLimit:
    if isinstance(made.statement, Settles) or (
        isinstance(made.statement, Compared) and made.statement.measure == "ramp"
    ):
        raise _MismatchError("needs one piece of time; give it a step or times instead of `while`")
    columns, unit, suffixed = _resolve(condition.signal, known)
    if len(columns) > 1:
        raise _MismatchError(f"has a condition on {condition.signal}, which is several sensors; name one of {columns}")
    bound = _converted(condition.bound, unit, suffixed, condition.signal)
    return replace(made, condition=columns[0], while_=bound)


def _resolve(name: str, known: RigSignals) -> tuple[tuple[str, ...], str, bool]:
    """Return the columns of a name, their unit, and True where the name ends with the unit."""
    for signal in known.signals:
        if name == signal.column:
            return (signal.column,), signal.unit, bool(SUFFIX_OF_UNIT[signal.unit]) and name != signal.name
    for signal in known.signals:
        if name == signal.name:
            return (signal.column,), signal.unit, False
    if name in known.twin_sensors:
        return tuple(known.twin_sensors[name]), "degC", name.endswith("_C")
    names = [*(s.column for s in known.signals), *(s.name for s in known.signals), *known.twin_sensors]
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    listed = ", ".join(signal.column for signal in known.signals if signal.kind == "measured")
    remedy = f"did you mean {near[0]}?" if near else f"it has {listed}"
    raise _MismatchError(f"names {name}, which is no signal of {known.source}; {remedy}")


def _number(amount: Amount, unit: str, suffixed: bool, name: str, *, difference: bool = False) -> Amount:
    """Return an amount in the unit of its signal; a name that ends with the unit states it, too."""
    shown = difference_unit(unit) if difference else unit
    if amount.unit is None:
        if not suffixed and unit != "1":
            raise _MismatchError(f"has {amount.number:g} without a unit; write {amount.number:g} {shown}")
        return Amount(amount.number, shown)
    if amount.unit == "%" and unit != "%" and not difference:
        raise _MismatchError(f"is in %, and {name} is in {unit}; write the limit in {unit}")
    number = amount.number * factor_to(unit, amount.unit, difference=difference)
    if not math.isfinite(number):
        raise _MismatchError(f"has {amount}, which is too large in {shown}; write a smaller number")
    return Amount(number, shown)


def _converted(bound: Bound, unit: str, suffixed: bool, name: str, *, difference: bool = False) -> Bound:
    amount = _number(bound.amount, unit, suffixed, name, difference=difference)
    upper = None if bound.upper is None else _number(bound.upper, unit, suffixed, name, difference=difference)
    _require_order(bound, amount, upper)
    return Bound(bound.operator, amount, upper)


def _require_order(bound: Bound, low: Amount, high: Amount | None) -> None:
    """Check that something lies between the amounts of a bound, in one unit."""
    if high is not None and not low.number < high.number:
        raise _MismatchError(f"is {bound}, which holds nothing; write the lesser one first")


def _compared(limit: Limit, said: Compared, known: RigSignals, from_s: float, to_s: float) -> BoundLimit:
    columns, unit, suffixed = _resolve(said.signal, known)
    if said.measure in ("time", "longest"):
        assert said.threshold is not None
        threshold = _converted(said.threshold, unit, suffixed, said.signal)
        bound = _converted(said.bound, "s", False, "the time")
        _require_time(bound.amount.number, to_s - from_s)
        return BoundLimit(limit, replace(said, threshold=threshold, bound=bound), columns, "s", from_s, to_s)
    if said.measure == "ramp":
        return _ramp(limit, said, known, from_s, to_s)
    difference = said.measure in ("deviation", "range")
    bound = _converted(said.bound, unit, suffixed, said.signal, difference=difference)
    shown = difference_unit(unit) if difference else unit
    return BoundLimit(limit, replace(said, bound=bound), columns, shown, from_s, to_s)


def _ramp(limit: Limit, said: Compared, known: RigSignals, from_s: float, to_s: float) -> BoundLimit:
    columns, unit, _ = _resolve(said.signal, known)
    shown, written = difference_unit(unit), said.bound.amount.unit
    value_unit, slash, time_unit = (written or "").rpartition("/")
    if not slash or time_unit not in TIMES_S:
        raise _MismatchError(f"needs the unit of a rate; write {said.bound.amount.number:g} {shown}/min")
    rate = f"{shown}/{time_unit}"
    over_s = TIMES_S[time_unit] if said.over_s is None else said.over_s
    _require_time(over_s, to_s - from_s)
    if over_s < known.period_s:
        raise _MismatchError(
            f"takes a ramp over {over_s:g} s, less than a tick of {known.period_s:g} s; take it longer"
        )
    amounts = []
    for amount in (said.bound.amount, said.bound.upper):
        number = None if amount is None else amount.number * factor_to(unit, value_unit, difference=True)
        amounts.append(None if number is None else Amount(number, rate))
    assert amounts[0] is not None
    bound = Bound(said.bound.operator, amounts[0], amounts[1])
    _require_order(said.bound, amounts[0], amounts[1])
    return BoundLimit(limit, replace(said, bound=bound, over_s=over_s), columns, rate, from_s, to_s)


def _require_time(needed_s: float, there_s: float) -> None:
    if needed_s > there_s:
        raise _MismatchError(f"takes {needed_s:g} s, and it is judged over {there_s:g} s; correct one of them")


def _band(amount: Amount, unit: str, suffixed: bool, name: str) -> Amount:
    """Return a band: in the unit of differences, or in % of a value."""
    if amount.unit != "%" or unit == "%":
        return _number(amount, unit, suffixed, name, difference=True)
    if unit in ("degC", "K"):
        raise _MismatchError("has a band in % of a temperature, whose zero is arbitrary; write it in K")
    return amount


def _settling(limit: Limit, said: Settles, known: RigSignals, from_s: float, to_s: float) -> BoundLimit:
    columns, unit, suffixed = _resolve(said.signal, known)
    if said.within_s >= to_s - from_s:
        raise _MismatchError(
            f"takes {said.within_s:g} s, and it is judged over {to_s - from_s:g} s, so that nothing is left to stay "
            "settled; extend the profile or the step"
        )
    window, longest_s = limit.sentence.window, known.longest_hold_s
    if window.from_s is None and window.to_s is None and longest_s is not None and said.within_s >= longest_s:
        raise _MismatchError(
            f"takes {said.within_s:g} s, and the profile holds its set-points for {longest_s:g} s at most; correct one"
        )
    band = _band(said.band, unit, suffixed, said.signal)
    target = None if said.target is None else _number(said.target, unit, suffixed, said.signal)
    return BoundLimit(limit, replace(said, band=band, target=target), columns, unit, from_s, to_s)


def _following(limit: Limit, said: Follows, known: RigSignals, from_s: float, to_s: float) -> BoundLimit:
    constant_s = CONSTANT_S if said.constant_s is None else said.constant_s
    _require_time(constant_s, to_s - from_s)
    for stem, pair in pair_actuators(known.signals).items():
        names = {stem, *(signal.name for signal in pair), *(signal.column for signal in pair)}
        if said.signal not in names:
            continue
        if len(pair) < 2:
            raise _MismatchError(f"asks for the reading of {stem}, and no signal reads it; name another actuator")
        setpoint, read = pair
        band = _band(said.band, read.unit, said.signal == read.column, said.signal)
        made = replace(said, band=band, constant_s=constant_s)
        return BoundLimit(limit, made, (read.column,), read.unit, from_s, to_s, setpoint=setpoint.column)
    _resolve(said.signal, known)
    listed = ", ".join(pair_actuators(known.signals)) or "none"
    raise _MismatchError(f"names {said.signal}, which has no set-point; there are {listed}")


def _of_twin(limit: Limit, said: TwinError, known: RigSignals, from_s: float, to_s: float) -> BoundLimit:
    if not known.twins:
        raise _MismatchError("judges a twin, and there is none; give the rig or the run one (--twin)")
    twin = known.twins[0] if said.twin == "twin" else said.twin
    if twin not in known.twins:
        raise _MismatchError(f"names the twin {twin}; there are {', '.join(known.twins)}")
    sensors: Sequence[str] = tuple(known.twin_sensors)
    sensor = next((name for name in sensors if said.sensor in (name, name.removesuffix("_C"))), None)
    if sensor is None:
        raise _MismatchError(f"names {said.sensor}, which is no sensor of the twin; there are {', '.join(sensors)}")
    bound = _converted(said.bound, "K", False, said.sensor)
    columns = tuple(known.twin_sensors[sensor])
    return BoundLimit(limit, replace(said, twin=twin, sensor=sensor, bound=bound), columns, "K", from_s, to_s)
