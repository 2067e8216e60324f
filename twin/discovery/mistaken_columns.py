"""Columns of a record that were exchanged, or are in another unit than their name says.

Such a mistake of the file reads like large and odd effects. Without any effect, the commissioned twin explains the
record as soon as the mistake is undone; hardly any fault of a rig is undone by reading two columns the other way round.
A mistake may also begin or end amid a record: two plugs that somebody exchanged, a logger that was set to another unit.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from twin.discovery.effects.phrases import clock
from twin.discovery.effects.probe import Probe, free_run
from twin.discovery.healthy.basis import Columns
from twin.discovery.records.grid import on_grid
from twin.network import Array, Network, TwinFileError
from twin.segments import CLOCK_PREFIX

UNDONE = 0.04
"""Largest share of the squares that a mistake leaves when it is undone, a fifth of the error: a judgement. Three
mistakes in files of other rigs left a hundredth at most."""
LEAST_S = 900.0
"""Shortest part of a record that a mistake is sought in, s. A judgement: a shorter one is a moment of somebody's work.
"""
FAR_OFF = 3.0
"""Root mean square, in noise and the usual error together, from which a record is tried."""
_UNITS: tuple[tuple[str, Callable[[Array], Array]], ...] = (
    ("degrees Fahrenheit", lambda v: (v - 32.0) / 1.8),
    ("kelvin", lambda v: v - 273.15),
)


@dataclass(frozen=True)
class _Undone:
    """Record with a mistake undone: a sentence with ``{errors}`` for the errors before and after, and the record."""

    says: str
    record: Columns


def column_mistakes(network: Network, record: Columns, healthy: Columns | None = None) -> tuple[str, ...]:
    """Return a question about the columns that were probably exchanged or are in another unit; none for most records.

    Parameters
    ----------
    network
        The commissioned twin.
    record
        Record whose columns are in question.
    healthy
        The record that the twin was commissioned on, whose error is usual; None takes the thermometers' noise.
    """
    ids = network.tunables("commission" if "commission" in network.sets else None)
    if not ids:
        return ()
    probe = Probe(network, ids)
    try:
        usual = network.sigma if healthy is None else np.hypot(network.sigma, _rms(probe, healthy))
        found = _rms(probe, record)
    except TwinFileError:
        return ()
    before = _squares(found, usual)
    if not before > FAR_OFF**2 * np.isfinite(found).sum():
        return _for_a_time(probe, record, usual)
    least, said = UNDONE * before, ""
    for undone in _undone(network, record):
        try:
            errors = _rms(probe, undone.record)
        except TwinFileError:
            continue
        if np.isfinite(errors).sum() == np.isfinite(found).sum() and _squares(errors, usual) < least:
            least = _squares(errors, usual)
            worst = int(np.nanargmax(found / usual))
            name = network.sensor_names[worst]
            said = undone.says.format(
                errors=f"the twin is off by {errors[worst]:.2g} K instead of {found[worst]:.2g} K at {name}"
            )
    return (said,) if said else _for_a_time(probe, record, usual)


def _for_a_time(probe: Probe, record: Columns, usual: Array) -> tuple[str, ...]:
    """Return the question about readings that were exchanged or in another unit in one part of a record; () if none.

    The part is the one in which undoing it gains most. It counts if the twin is far off there, and hardly so undone.
    """
    network = probe.network
    grid = on_grid(network, record.time_s, record.inputs, record.measured)
    run = free_run(probe, grid)[1].readings
    least_rows, best, said = max(round(LEAST_S / grid.step_s), 1), 0.0, ""
    for undone in _undone(network, replace(record, inputs=grid.inputs, measured=grid.measured), inputs=False):
        changed = ((undone.record.measured != grid.measured) & np.isfinite(grid.measured)).any(axis=0)
        with np.errstate(invalid="ignore"):
            before = ((grid.measured - run)[:, changed] / usual[changed]) ** 2
            after = ((undone.record.measured - run)[:, changed] / usual[changed]) ** 2
        # A reading that has no other to be exchanged with tells nothing.
        before, after = np.where(np.isfinite(after), before, np.nan), np.where(np.isfinite(before), after, np.nan)
        sums = np.concatenate([[0.0], np.cumsum(np.nansum(before - after, axis=1))])
        begins = np.minimum.accumulate(sums)
        last = int(np.argmax(sums - begins))
        first = int(np.argmin(sums[: last + 1]))
        rows = slice(first, last)
        was, left = float(np.nansum(before[rows])), float(np.nansum(after[rows]))
        far = was > FAR_OFF**2 * np.isfinite(before[rows]).sum()
        long = np.isfinite(before[rows]).any(axis=1).sum() >= least_rows
        if long and far and left < UNDONE * was and was - left > best:
            best = was - left
            errors = [np.sqrt(np.nanmean(squares, axis=0)) * usual[changed] for squares in (after[rows], before[rows])]
            worst = int(np.nanargmax(errors[1]))
            name = [n for n, c in zip(network.sensor_names, changed, strict=True) if c][worst]
            off = f"the twin is off by {errors[0][worst]:.2g} K instead of {errors[1][worst]:.2g} K at {name}"
            begun, ended = (clock(float(grid.time[k])) for k in (first, last - 1))
            part = f"from {begun} to {ended}" if last < len(run) else f"from {begun} on"
            said = f"{part}, {undone.says.format(errors=off)}"
    return (said,) if said else ()


def _rms(probe: Probe, record: Columns) -> Array:
    """Return the error (m,), K, of the commissioned twin's free run; NaN for a sensor without a reading.

    Raises
    ------
    TwinFileError
        The free run does not stay finite.
    """
    grid = on_grid(probe.network, record.time_s, record.inputs, record.measured)
    _, _, residual, good = free_run(probe, grid)
    if (np.isfinite(grid.measured) & ~good).any():
        raise TwinFileError("the twin's free run does not stay finite")
    count = good.sum(axis=0)
    squares = np.where(good, residual, 0.0) ** 2
    return np.where(count > 0, np.sqrt(squares.sum(axis=0) / np.maximum(count, 1)), np.nan)


def _squares(errors: Array, usual: Array) -> float:
    return float(np.nansum((errors / usual) ** 2))


def _undone(network: Network, record: Columns, *, inputs: bool = True) -> Iterator[_Undone]:
    """Yield the record with each possible mistake of its readings, and of its inputs, undone."""
    given = [(c, record.inputs[:, j]) for j, c in enumerate(network.input_columns) if not c.startswith(CLOCK_PREFIX)]
    columns = given if inputs else []
    single = [j for j, s in enumerate(network.sensors) if len(s.measured) == 1]
    columns += [(network.sensors[j].measured[0], record.measured[:, j]) for j in single]
    for (a, one), (b, other) in itertools.combinations(columns, 2):
        same_unit = a.rpartition("_")[2] == b.rpartition("_")[2]
        if a != b and same_unit and not np.array_equal(one, other, equal_nan=True):
            asks = "Are their headings right, and their plugs?"
            says = f"{a} and {b} look exchanged: read the other way round, {{errors}}. {asks}"
            yield _Undone(says, _with(network, record, {a: other, b: one}))
    for name, values in columns:
        for unit, celsius in _UNITS if name.endswith("_C") else ():
            says = f"{name} looks like {unit}: read so, {{errors}}. Is its unit right?"
            yield _Undone(says, _with(network, record, {name: celsius(values)}))


def _with(network: Network, record: Columns, values: dict[str, Array]) -> Columns:
    """Return the record with other values in some columns."""
    inputs, measured = record.inputs.copy(), record.measured.copy()
    for j, column in enumerate(network.input_columns):
        if column in values:
            inputs[:, j] = values[column]
    for j, sensor in enumerate(network.sensors):
        if len(sensor.measured) == 1 and sensor.measured[0] in values:
            measured[:, j] = values[sensor.measured[0]]
    return replace(record, inputs=inputs, measured=measured)
