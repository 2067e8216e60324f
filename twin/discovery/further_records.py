"""Validation of a diagnosis on further records: free runs over records that no effect was fitted to."""

from __future__ import annotations

import numpy as np

from twin.discovery.diagnosis import Carried, Diagnosis, Elsewhere, SensorError
from twin.discovery.effects.phrases import amount
from twin.discovery.evidence.held_out import FAR_OFF, UNUSUAL, binned
from twin.discovery.healthy.basis import Columns
from twin.discovery.records.grid import bridged, on_grid
from twin.gauss_newton import FitData, fit_initial_state
from twin.kernel import Kernel
from twin.network import Array, Network
from twin.segments import find_segments, segment_rows, simulate_segments

FAR_SHARE = 0.25
"""Share of the squares of re-tuning alone up to which effects with a large error still carry over in part: a twin with
them is useful then, though their form is not exact."""
GROWN_FAR_OFF = 4.0
"""The same as `FAR_OFF` for a twin without a healthy record."""
SETTLE_S, SETTLE_SHARE, FIRST_ROWS = 900.0, 0.1, 6
"""Readings of a segment, s, and the share of it at most, that determine its initial temperatures; rows for a first
guess."""


def errors_on_further_record(diagnosis: Diagnosis, network: Network, record: Columns, name: str) -> Elsewhere:
    """Return the errors of the commissioned twin, re-tuned and, if effects were found, with them, over a further
    record.

    Only the initial temperatures are fitted to it; effects are present throughout.
    """
    own = {p.id for p in network.parameters.values() if not p.same_as}
    retuned = network.with_values({m.parameter: m.before for m in diagnosis.moved if m.parameter in own})
    networks = [network, retuned, *([diagnosis.network] if diagnosis.network is not None else [])]
    lost = find_segments(network, record.time_s, record.inputs).lost
    measured = np.where(lost[:, None], np.nan, record.measured)
    runs = [_run(each, record, measured) for each in networks]
    runs = [*runs, runs[-1]][:3]
    grid = on_grid(network, record.time_s, record.inputs, record.measured)
    errors = {}
    for j, sensor in enumerate(network.sensor_names):
        off = [measured[:, j] - run[:, j] for run in runs]
        if not np.isfinite(off[0]).any():
            continue
        raw = [float(np.sqrt(np.nanmean(x**2))) for x in off]
        means = [float(np.sqrt(np.nanmean(binned(x, record.time_s, grid) ** 2))) for x in off]
        usual = diagnosis.errors[sensor].usual if sensor in diagnosis.errors else 0.0
        noise, of_means = float(network.sigma[j]), (means[0], means[1], means[2])
        errors[sensor] = SensorError(raw[0], raw[1], raw[2], noise, of_means, usual)
    carried = _carried(diagnosis, network, errors)
    return Elsewhere(name, errors, carried, "" if carried == "over" else _says(diagnosis, name, errors, carried))


def _run(network: Network, record: Columns, measured: Array) -> Array:
    """Return the readings (N, m), degC, of a free run."""
    time, inputs = record.time_s, bridged(network, record.time_s, record.inputs)
    kernel = Kernel(network, ())
    known = find_segments(network, record.time_s, record.inputs)
    states = []
    for rows in segment_rows(known.begins, len(time)):
        settle_s = min(SETTLE_S, SETTLE_SHARE * (time[rows][-1] - time[rows][0]))
        first = slice(rows.start, max(int(np.searchsorted(time, time[rows.start] + settle_s)), rows.start + 2))
        good = np.isfinite(measured[first])
        data = FitData(time[first], inputs[first], np.where(good, measured[first], 0.0), good / network.sigma)
        state = network.initial_state(measured[rows][:FIRST_ROWS])
        states.append(fit_initial_state(kernel, network.values, state, data, 1.0)[: len(network.nodes)])
    return simulate_segments(kernel, network.values[None], np.concatenate(states)[None], time, inputs, known.begins)[0]


def _carried(diagnosis: Diagnosis, network: Network, errors: dict[str, SensorError]) -> Carried:
    limit = FAR_OFF if diagnosis.method == "contest" else GROWN_FAR_OFF
    far = any(
        e.means[2] > max(limit * network.parameters[f"{sensor}.sigma"].value, UNUSUAL * e.usual)
        for sensor, e in errors.items()
    )
    if not far:
        return "over"
    before, after = (sum((e.means[k] / e.noise) ** 2 for e in errors.values()) for k in (1, 2))
    return "in part" if after <= FAR_SHARE * before else "not"


def _says(diagnosis: Diagnosis, name: str, errors: dict[str, SensorError], carried: Carried) -> str:
    sensor, e = max(errors.items(), key=lambda item: item[1].means[2] / item[1].noise)
    noise = f"at a noise of {amount(e.noise, 'K')}"
    if diagnosis.network is None and diagnosis.verdict != "adequate":
        return ""
    if diagnosis.network is None:
        return f"re-tuned, the twin does not fit {name}: {sensor} is off there by {amount(e.after, 'K')}, {noise}"
    one = len(diagnosis.effects) == 1
    what, them = ("this effect", "it") if one else ("these effects", "them")
    verb = "does not carry" if one else "do not carry"
    over = f"{verb} over to {name}"
    if carried == "in part":
        over = f"{'carries' if one else 'carry'} over to {name} in part only"
    return (
        f"{what} {over}: {sensor} is off there by {amount(e.after, 'K')} with {them}, by "
        f"{amount(e.before, 'K')} when re-tuned, {noise}"
    )
