"""Load profiles of a rig's set-points, and the text of what a run of one writes to the rig."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from drivers.rig_file import Rig

_GOLDEN = 0.6180339887498949
"""Fraction by which a level moves on: the golden ratio's multiples cover an interval evenly (Weyl's sequence)."""
_LOWEST, _SPAN = 0.4, 0.5
"""Levels lie from 40 % to 90 % of the limits: the range of the shipped commissioning profile."""
_HOLD_MIN = (30, 40, 60)
"""Minutes that the first, second and third set-point holds a level, so that no two move together."""


def load_text(rig: Rig, hours: float) -> str:
    """Return a load profile that moves the rig's set-points one at a time, as CSV.

    Parameters
    ----------
    rig
        Rig with at least one set-point.
    hours
        Duration in h.
    """
    from hil.run.session import setpoint_limits

    limits = setpoint_limits(rig)
    end = round(hours * 60)
    moves = {0} | {minute for number in range(len(limits)) for minute in range(5 * number, end, _hold(number))}
    rows = [",".join(["time_s", *limits])]
    for minute in [*sorted(moves), end]:
        levels = [
            limit.low + (limit.high - limit.low) * _level(min(minute, end - 1), number)
            for number, limit in enumerate(limits.values())
        ]
        rows.append(",".join([str(60 * minute), *(f"{level:.5g}" for level in levels)]))
    return "\n".join(rows) + "\n"


def _hold(number: int) -> int:
    return _HOLD_MIN[number % len(_HOLD_MIN)] + 5 * (number // len(_HOLD_MIN))


def _level(minute: int, number: int) -> float:
    """Return the level of a set-point, as a fraction of its limits."""
    move = (minute - 5 * number) // _hold(number) if minute >= 5 * number else 0
    return _LOWEST + _SPAN * ((0.5 + _GOLDEN * (move + number)) % 1.0)


def written_text(rig: Rig, load: Path) -> str:
    """Return the text of what a run of a load profile writes: set-points, ranges, limits, safe values, duration.

    Raises
    ------
    ProfileError
        The profile cannot be read.
    """
    from hil.profile import read_profile
    from hil.run.session import setpoint_limits

    profile = read_profile(load)
    parts = []
    for column, limit in setpoint_limits(rig).items():
        point = next(p for p in rig.setpoints if p.as_signal().column == limit.setpoint)
        if column in profile.columns:
            values = profile.values[:, profile.columns.index(column)]
            what = f"{values.min():g} to {values.max():g} {point.unit}"
        else:
            what = "its safe value alone"
        parts.append(f"{point.name} {what} (limits {limit.low:g} to {limit.high:g}, safe value {point.safe_value:g})")
    beat = rig.heartbeat
    if beat is not None:
        parts.append(", ".join(name for name in (beat.point, beat.arm, beat.watchdog) if name) + " every tick")
    return f"{'; '.join(parts)}; for {profile.duration_s / 3600:.2g} h"
