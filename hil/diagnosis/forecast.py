"""Forecast of `hil diagnose --forecast`: detectability of effects in a record or a planned load profile."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.columns import CLOCK, DiagnosingError, read_columns
from hil.profile import Profile, ProfileError, read_profile

if TYPE_CHECKING:
    from rich.console import Console

    from twin import Network
    from twin.discovery import Columns, EffectLabel, Forecast

STEP_S = 10.0
_MOST_PAIRS = 20


def show_forecast(
    to: Console, network: Network, path: Path, healthy: Columns | None, hour: float | None, *, as_json: bool
) -> None:
    """Print the least detectable size of each effect, the undetectable effects, and ambiguous pairs.

    Parameters
    ----------
    to
        Console to print on.
    network
        Commissioned twin.
    path
        Record, or load profile of a planned run.
    healthy
        Healthy record of the twin, or None.
    hour
        Hour of the day at 0 s, or None.
    as_json
        True for a JSON document.

    Raises
    ------
    DiagnosingError
        A plan without a healthy record.
    RecordError, TwinFileError
        As `hil.diagnosis.columns.read_columns`.
    """
    from twin.discovery import foresee, foresee_plan

    plan = _plan_at(path, network)
    notes: list[str] = []
    if plan is None:
        found = foresee(network, read_columns(network, path, hour)[0], healthy)
    elif healthy is None:
        raise DiagnosingError(
            f"{path} is a load profile; a forecast for it needs the noise of the rig, so give a record with --healthy"
        )
    else:
        time, inputs, notes = planned_inputs(network, plan, hour)
        found = foresee_plan(network, time, inputs, healthy)
    if as_json:
        print(json.dumps({**document(found), "notes": notes}, indent=1))
        return
    for note in notes:
        to.print(note, soft_wrap=True)
    _show(to, found, "profile" if plan is not None else "record")


def _plan_at(path: Path, network: Network) -> Profile | None:
    """Return the load profile at `path`, or None if that is a record."""
    if path.suffix != ".csv":
        return None
    try:
        profile = read_profile(path)
    except ProfileError:
        return None
    measured = {column for columns in network.sensor_columns.values() for column in columns}
    return None if measured & set(profile.columns) else profile


def planned_inputs(
    network: Network, plan: Profile, hour: float | None
) -> tuple[NDArray[np.float64], NDArray[np.float64], list[str]]:
    """Return time (n,) s and inputs (n, c) of a profile, and notes on inputs that it does not set."""
    from twin import STAMP

    time = np.arange(0.0, plan.duration_s, STEP_S)
    values = plan.sample(time)
    inputs = np.empty((len(time), len(network.input_columns)))
    notes = []
    for j, (column, spec) in enumerate(network.inputs.items()):
        if column in plan.columns:
            inputs[:, j] = values[:, plan.columns.index(column)]
        elif column == CLOCK:
            inputs[:, j] = ((hour or 0.0) + time / 3600.0) % 24.0
        elif column == STAMP:
            inputs[:, j] = time
        else:
            inputs[:, j] = spec.nominal
            notes.append(f"{column} is not in {plan.name}: taken as {spec.nominal:g} {spec.unit}".rstrip())
    return time, inputs, notes


def document(found: Forecast) -> dict[str, object]:
    """Return a forecast as plain data for scripts."""
    return {
        "seen": [
            {
                "kind": s.candidate.kind,
                "where": s.candidate.where,
                "driver": s.candidate.driver,
                "least": s.least,
                "unit": s.candidate.unit,
                "kept": s.kept,
            }
            for s in found.seen
        ],
        "unseen": [c.id for c in found.unseen],
        "confused": [[a.id, b.id, rho] for a, b, rho in found.confused],
    }


def _show(to: Console, found: Forecast, source: str) -> None:
    from rich.table import Table

    from twin.discovery import label_text

    table = Table(
        title=f"Least detectable effect in this {source}, if present from the beginning", title_justify="left"
    )
    for heading in ("kind", "place", "driver", "least size", "not absorbed by tunables"):
        table.add_column(heading, justify="right" if heading.startswith(("least", "not")) else "left")
    shown = set()
    for s in found.seen:
        c = s.candidate
        if (c.kind, c.where, c.driver) in shown:
            continue
        shown.add((c.kind, c.where, c.driver))
        table.add_row(c.kind, c.where, c.driver, f"{s.least:.3g} {c.unit}", f"{100.0 * s.kept:.0f} %")
    to.print(table)
    for label in dict.fromkeys((c.kind, c.where, c.driver) for c in found.unseen):
        if label not in shown:
            to.print(f"not detectable: {label_text(label)}")
    pairs: dict[tuple[EffectLabel, EffectLabel], float] = {}
    for a, b, rho in found.confused:
        pairs.setdefault(((a.kind, a.where, a.driver), (b.kind, b.where, b.driver)), rho)
    for (one, other), rho in list(pairs.items())[:_MOST_PAIRS]:
        to.print(f"ambiguous ({rho:+.3f}): {label_text(one)} and {label_text(other)}")
    if len(pairs) > _MOST_PAIRS:
        to.print(f"and {len(pairs) - _MOST_PAIRS} further pairs")
