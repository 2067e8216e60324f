"""Settling of a signal after changes of set-points, or within one step of a test."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.testing.bound_limits import BoundLimit
from hil.testing.judgement.verdicts import Finding, shown, worst
from hil.testing.limits import Settles
from hil.testing.run_data import Floats, RunData, carried_on, longest_piece, ticks_within

FINAL_SHARE = 0.1
"""Last share of a hold whose mean is the final value, where a limit names no target: shorter is noise, and longer would
take the approach to it for the end."""


def holds(data: RunData) -> list[tuple[float, float]]:
    """Return begin and end, s of profile time, of the pieces between changes of set-points in the profile.

    Changes on successive ticks are one ramp, and its hold begins with it. A ramp back to the profile, after it has
    stood, begins none.
    """
    if not len(data.time_s):
        return []
    # A set-point that is missing for a while, and then the same, has not changed.
    columns = [carried_on(data.columns[name]) for name in data.setpoints]
    commanded = np.column_stack(columns or [np.zeros(len(data.time_s))])
    moved = np.flatnonzero((commanded[1:] != commanded[:-1]).any(axis=1)) + 1
    begins = [float(data.time_s[0])]
    last = -np.inf
    stood = data.stood
    for index in np.union1d(moved, np.flatnonzero(stood)):
        time_s = float(data.time_s[index])
        last = time_s if stood[index] else last
        if time_s - last > 1.5 * data.period_s and time_s - begins[-1] > 1.5 * data.period_s:
            begins.append(time_s)
        last = time_s
    return list(zip(begins, [*begins[1:], data.duration_s], strict=True))


def judge_settling(bound: BoundLimit, said: Settles, data: RunData, column: str) -> Finding:
    """Return the finding on a column: of its step, or the worst of all holds that are long enough."""
    window = bound.limit.sentence.window
    if window.from_s is not None or window.to_s is not None:
        return _hold(said, bound, data, column, (bound.from_s, bound.to_s))
    pieces = holds(data)
    long = [piece for piece in pieces if piece[1] - piece[0] > said.within_s]
    left_out = f"; {len(pieces) - len(long)} of {len(pieces)} holds are shorter" if len(long) < len(pieces) else ""
    if not long:
        return Finding("inconclusive", f"no set-points were held for more than {said.within_s:g} s")
    found, _ = worst([(_hold(said, bound, data, column, piece), "") for piece in long])
    return Finding(found.verdict, found.text + left_out, found.value, found.unit, found.at_s, found.margin)


def _hold(said: Settles, bound: BoundLimit, data: RunData, column: str, piece: tuple[float, float]) -> Finding:
    begin_s, end_s = piece
    wanted = ticks_within(begin_s, end_s, data.period_s)
    # The tick at the end belongs to the next hold, except for the last of the profile.
    if end_s < data.duration_s and (wanted.stop - 1) * data.period_s > end_s - 1e-6:
        wanted = wanted[:-1]
    position = data.positions()
    inside = (position >= wanted.start) & (position < wanted.stop)
    position, time_s, x = position[inside], data.time_s[inside], data.columns[column][inside]
    stood = data.stood[inside]
    if stood[1:].any():
        return _stood(said, bound, (time_s, x, stood), begin_s)
    known = np.isfinite(x)
    unknown = np.ones(len(wanted), dtype=np.bool_)
    unknown[position[known] - wanted.start] = False
    gap_s = longest_piece(unknown)[0] * data.period_s
    is_missing = gap_s > bound.limit.gap_at_most_s + 0.5 * data.period_s
    missing = Finding("inconclusive", f"values are missing after {begin_s:g} s, for {gap_s:g} s at the longest")
    final = known & (time_s >= end_s - FINAL_SHARE * (end_s - begin_s))
    if not known.any() or (said.target is None and (is_missing or not final.any())):
        return missing
    target = float(np.mean(x[final])) if said.target is None else said.target.number
    outside = np.flatnonzero(known & (np.abs(x - target) > _half_width(said, bound, target)))
    settled_s = float(time_s[outside[-1]]) + data.period_s - begin_s if len(outside) else 0.0
    margin = said.within_s - settled_s
    about = f"about {shown(target, bound.unit)}"
    if settled_s > said.within_s:
        last = int(outside[-1])
        never = "not settled" if last == np.flatnonzero(known)[-1] else f"settled after {settled_s:g} s"
        text = f"{never} {about} after the change at {begin_s:g} s, the limit is {said.within_s:g} s"
        return Finding("fail", text, settled_s, "s", begin_s, margin)
    if is_missing:
        return missing
    # Ticks without a value right after the last one outside of the band may have been outside, too.
    begin = 0 if not len(outside) else int(position[outside[-1]]) - wanted.start + 1
    later = np.flatnonzero(~unknown[begin:])
    latest_s = settled_s + (int(later[0]) if len(later) else len(unknown) - begin) * data.period_s
    if latest_s > said.within_s:
        text = f"settled after {settled_s:g} s to {latest_s:g} s, by the values that are missing"
        return Finding("inconclusive", f"{text}; the limit is {said.within_s:g} s", settled_s, "s", begin_s, margin)
    text = f"settled within {settled_s:g} s {about} after the change at {begin_s:g} s"
    return Finding("pass", text, settled_s, "s", begin_s, margin)


def _half_width(said: Settles, bound: BoundLimit, target: float) -> float:
    relative = said.band.unit == "%" and bound.unit != "%"
    return said.band.number * (abs(target) / 100.0 if relative else 1.0)


def _stood(
    said: Settles, bound: BoundLimit, ticks: tuple[Floats, Floats, NDArray[np.bool_]], begin_s: float
) -> Finding:
    """Return the finding on a hold in which the profile stood: a failure before that, else inconclusive.

    Times of the profile do not state how long the value took, and safe values have moved it.
    """
    time_s, x, stood = ticks
    first = int(np.argmax(stood[1:])) + 1
    text = f"the profile stood at {time_s[first]:g} s, before the value had settled after {begin_s:g} s"
    if said.target is not None:
        target = said.target.number
        late = time_s[:first] - begin_s >= said.within_s
        wrong = np.flatnonzero(late & (np.abs(x[:first] - target) > _half_width(said, bound, target)))
        if len(wrong):
            at_s = float(time_s[wrong[0]])
            text = f"not settled about {shown(target, bound.unit)} at {at_s:g} s, after the change at {begin_s:g} s"
            return Finding("fail", f"{text}, the limit is {said.within_s:g} s", at_s - begin_s, "s", begin_s)
    return Finding("inconclusive", text, at_s=begin_s)
