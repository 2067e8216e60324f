"""Sentences on a calibration that a user has to read: empty months, steps, contradictions of record and labels."""

from __future__ import annotations

import numpy as np

from hil.tower.calibration.station_fit import CellResult
from hil.tower.station import iso
from twin.tower import DAY_S, Array
from twin.tower.calibration import NORMAL, LabelConflict
from twin.tower.cell_observations import Label
from twin.tower.change_detection import Contradiction, Step

COLUMNS = {
    "t_in_C": "the inlet temperature",
    "m_w_kg_s": "the water flow",
    "fan_speed_pct": "the fan speed",
    "dry_C": "the dry bulb",
    "wet_C": "the wet bulb",
    "pressure_kPa": "the air pressure",
}
"""Words of the columns that may jump where the record contradicts itself."""


EMPTY_D = 30.0
"""Days without a steady reading of the outlet that a user has to know of, a month; a cell stands by for shorter."""


def remarks_of(result: CellResult) -> tuple[str, ...]:
    """Return a sentence on each empty month, and on each contradiction of a cell's record and of its labels."""
    bound = result.priors.bounds["bias"]
    blocks = result.calibrated.blocks
    empty = gap_sentences(blocks.time_s[np.isfinite(blocks.outlet)])
    spans = tuple(contradiction_sentence(one, bound) for one in result.contradictions)
    return empty + spans + tuple(dict.fromkeys(conflict_sentence(one) for one in result.conflicts))


def gap_sentences(read_s: Array) -> tuple[str, ...]:
    """Return a sentence on each gap of a month or more between the times of readings (n,), s since 1970."""
    return tuple(
        f"no steady outlet was read from {iso(read_s[k])[:10]} to {iso(read_s[k + 1])[:10]}, "
        f"{(read_s[k + 1] - read_s[k]) / DAY_S:.0f} days: what was done to the cell meanwhile is unknown, so its "
        "intervals there are wide; enter cleanings and exchanged thermometers in the events, or calibrate the parts "
        "apart"
        for k in np.flatnonzero(np.diff(read_s) >= EMPTY_D * DAY_S).tolist()
    )


def step_sentence(step: Step) -> str:
    """Return a sentence on a lasting step, with what stepped."""
    when = f"at {iso(step.start_s)}"
    if step.stop_s > 0.0:
        when = f"between {iso(step.since_s)} and {iso(step.start_s)}, without a steady reading in between"
    if step.kind == "fan":
        return (
            f"the outlet stepped by {step.size:+.2f} K {when}, and the fan's power by "
            f"{100 * np.expm1(step.power):+.1f} % in the same minutes: the air flow changed, not the thermometer"
        )
    what = "the water" if step.kind == "water" else "the outlet thermometer"
    what += " or the water" if step.kind == "thermometer" and step.alone else ""
    return f"{what} stepped by {step.size:+.2f} K {when}"


def contradiction_sentence(one: Contradiction, bound: float) -> str:
    """Return a sentence on a span in which a record contradicts itself.

    Parameters
    ----------
    bound
        Largest bias of the thermometer, K.
    """
    from_to = f"from {iso(one.start_s)} to {iso(one.end_s)}"
    what = (
        f"the outlet steps {one.steps} {'time' if one.steps == 1 else 'times'} against the twin {from_to}, by up to "
        f"{one.size:+.2f} K"
        if one.steps
        else f"the outlet is {one.size:+.2f} K off the twin {from_to}"
    )
    cause = f"{COLUMNS[one.column]} ({one.column}) jumps there: " if one.column else ""
    return (
        f"{what}, as no thermometer does, whose bias is within {bound:g} K: {cause}look at "
        f"{'its tag' if one.column else 'the tags of the cell'}, and align again. These minutes are left out, and no "
        "value is adopted (CONTRADICTORY_RECORD)"
    )


def conflict_sentence(one: LabelConflict) -> str:
    """Return a sentence on a label that contradicts the rest of a record, or another label."""
    name, end = one.label.parameter, f"(CONTRADICTORY_LABEL:{one.label.parameter})"
    if one.other is not None:
        first, last = sorted((one.label, one.other), key=lambda label: label.time_s)
        return (
            f"the labels of the {name} {_told(first)} and {_told(last)} contradict each other: mend the wrong one; "
            f"its intervals are widened {end}"
        )
    clean = 0.0 if name == "bias" else 1.0
    return (
        f"the {one.label.source or 'label'} of the {name} {_told(one.label)} contradicts the record by "
        f"{one.distance:.1f} sd: without it the {name} is {one.mean + clean:.3f} ± {NORMAL * one.sd:.3f}; its "
        f"intervals are widened {end}"
    )


def _told(label: Label) -> str:
    clean = 0.0 if label.parameter == "bias" else 1.0
    low, high = label.low + clean, label.high + clean
    return f"of {iso(label.time_s)[:10]} ({f'{low:.3f}' if low == high else f'{low:.3f} to {high:.3f}'})"
