"""Notes of a commissioning: sentences about parameters, starts and residuals, for the operator."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from twin.commissioning.record import HealthyRecord
from twin.gauss_newton import GaussNewtonFit
from twin.network import Array, Network

AT_BOUND = 1e-6
"""Share of its range within which a value that ended on a bound is at it: more than the optimiser rounds by, 1e-9."""
FAR_FROM_WHITE = 100.0
"""Inflation of variances from which a note states it: intervals are then ten times as wide as noise makes them."""


def notes_of(
    record: HealthyRecord,
    ids: tuple[str, ...],
    agree: tuple[int, int],
    start: Array,
    best: GaussNewtonFit,
    identified: np.ndarray,
    widened: float,
) -> list[str]:
    """Return the notes of a fit to a record.

    Parameters
    ----------
    record, ids
        The healthy record, and the tunables (q,).
    agree
        Number of descents that reached the best cost, and of all.
    start, best
        (q,) values before the fit, and the fit.
    identified
        (q,) True for parameters that the record identifies.
    widened
        Inflation of variances (`variance_inflation`).
    """
    network, inputs = record.network, record.inputs[record.fitted]
    notes = []
    if agree[0] < agree[1]:
        notes.append(f"{agree[0]} of {agree[1]} starts reached the best fit; the others ended above it")
    constant = [c for c, column in zip(network.input_columns, inputs.T, strict=True) if np.ptp(column) == 0.0]
    if constant:
        notes.append(f"{', '.join(constant)} did not vary in the record, so their effects are not identifiable")
    unidentified = [name for name, ok in zip(ids, identified, strict=True) if not ok]
    moved = {
        name: f"{a:.4g} to {b:.4g}"
        for name, a, b in zip(ids, start.tolist(), best.values.tolist(), strict=True)
        if name in unidentified and f"{a:.4g}" != f"{b:.4g}"
    }
    if kept := [name for name in unidentified if name not in moved]:
        notes.append(f"the record does not identify {', '.join(kept)}; their values come from the twin file")
    if moved:
        steps = ", ".join(f"{name} ({step})" for name, step in moved.items())
        notes.append(
            f"the record does not identify {steps}; they moved within their prior only, together with other "
            'parameters: status = "fixed" in the twin file keeps the value of the file'
        )
    hit = {name: value for name, value, at in zip(ids, best.values.tolist(), best.at_bound, strict=True) if at}
    absent = _switched_off(network, hit)
    bound = [name for name in hit if name not in absent]
    if bound:
        notes.append(f"{', '.join(bound)} ended on a bound; the model may lack an effect")
    off = [f"{name} = {value:g}" for name, value in absent.items()]
    if off:
        names = ", ".join(off)
        notes.append(f'{names}: the record shows no such effect; status = "fixed" in the twin file ends its fit')
    if widened > FAR_FROM_WHITE:
        notes.append(f"residuals are far from white (intervals widened {np.sqrt(widened):.0f} times)")
    notes += [record.segments.sentence] if record.segments.gaps else []
    if record.silent:
        notes.append(f"{', '.join(record.silent)}: no reading in the record, so nothing was fitted to it")
    return notes


def _switched_off(network: Network, at_bound: Mapping[str, float]) -> dict[str, float]:
    """Return the parameters that ended at a bound of their kind which is its default, 0 or 1: their effect is off."""
    specs = {f"{e.name}.{spec.name}": spec for e in network.elements for spec in e.parameter_specs()}
    found = {}
    for name, value in at_bound.items():
        spec = specs[name]
        nearest = min((spec.lower, spec.upper), key=lambda bound: abs(bound - value))
        if (
            spec.default == nearest
            and nearest in (0.0, 1.0)
            and abs(value - nearest) < AT_BOUND * (spec.upper - spec.lower)
        ):
            found[name] = nearest
    return found
