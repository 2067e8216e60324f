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
_HOLD_S = (1800, 2400, 3600)
"""Seconds that the first, second and third set-point holds a level."""
_STEP_S = 300
"""Seconds by which each further set-point moves later, so that no two of the first three move together."""


def load_text(rig: Rig, hours: float, pace: int = 1) -> str:
    """Return a load profile that moves the rig's set-points one at a time, as CSV.

    Parameters
    ----------
    rig
        Rig with at least one set-point.
    hours
        Duration in h.
    pace
        Factor by which the levels change faster than in a commissioning.
    """
    from hil.run.session import setpoint_limits

    limits = setpoint_limits(rig)
    rows = [",".join(["time_s", *limits])]
    end_s, before = round(3600 * hours), ""
    for time_s in range(0, end_s + 1, _STEP_S // pace):
        levels = []
        for number, limit in enumerate(limits.values()):
            hold_s = _HOLD_S[number % len(_HOLD_S)]
            move = max(0, (min(time_s, end_s - 1) * pace - _STEP_S * number) // hold_s)
            share = _LOWEST + _SPAN * ((0.5 + _GOLDEN * (move + number)) % 1.0)
            levels.append(f"{limit.low + (limit.high - limit.low) * share:.5g}")
        row = ",".join(levels)
        if row != before or time_s == end_s:
            rows.append(f"{time_s},{row}")
        before = row
    return "\n".join(rows) + "\n"


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
