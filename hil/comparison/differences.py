"""Differences of runs on the profile's clock, and the drift of the parameters of their twins.

The first run is the reference. Each of its ticks is compared with the nearest tick of another run, at most half a tick
away; a tick without a good value in both is left out and counted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.signals import Signal
from hil.journal import JournalReader
from hil.run_folder import RunFolder, RunFolderError
from hil.testing import RunData, read_run, root_mean_square

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Difference:
    """Difference of one signal, another run minus the reference, in the signal's `unit`; of temperatures in K.

    `reference_mean` and `mean` are of both runs over their common ticks, `rms` and `largest` of the difference, and
    `largest_at_s` its profile time, s. `share` is the share of the reference's ticks that both have a good value for.
    Numbers are None where no tick is common.
    """

    column: str
    unit: str
    run: str
    share: float
    reference_mean: float | None = None
    mean: float | None = None
    bias: float | None = None
    rms: float | None = None
    largest: float | None = None
    largest_at_s: float | None = None


@dataclass(frozen=True, slots=True)
class Drift:
    """Parameter of a calibrator at the end of each run: `values` and half widths of 90 %, None where unknown.

    `beyond` is True for a run whose change from the reference exceeds both half widths in quadrature.
    """

    calibrator: str
    parameter: str
    values: tuple[float | None, ...]
    half_widths: tuple[float | None, ...]
    beyond: tuple[bool, ...]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Runs by name, the first one the reference, with their data, differences and drift of parameters.

    `only_in_some` names the columns that not every run has.
    """

    runs: tuple[str, ...]
    data: tuple[RunData, ...]
    units: Mapping[str, str]
    differences: tuple[Difference, ...]
    drifts: tuple[Drift, ...]
    only_in_some: tuple[str, ...]

    def document(self) -> dict[str, Any]:
        """Return tables as plain data, without the samples."""
        return {
            "runs": list(self.runs),
            "differences": [asdict(difference) for difference in self.differences],
            "parameters": [asdict(drift) for drift in self.drifts],
            "only_in_some": list(self.only_in_some),
        }


def compare_runs(folders: Sequence[RunFolder]) -> Comparison:
    """Return the comparison of two or more runs.

    Raises
    ------
    RunFolderError
        A folder is given twice, or the runs have no signal in common.
    JournalError
        A journal is missing or damaged.
    """
    paths = [folder.path.resolve() for folder in folders]
    twice = [str(path) for path in paths if paths.count(path) > 1]
    if len(folders) < 2 or twice:
        what = f"{twice[0]} is given twice" if twice else "one run alone has nothing to be compared with"
        raise RunFolderError(f"{what}; give two or more different runs")
    names = [path.name if [p.name for p in paths].count(path.name) == 1 else str(path) for path in paths]
    manifests, data, signals = [], [], []
    for folder in folders:
        manifests.append(folder.read_manifest())
        reader = JournalReader(folder.journal)
        try:
            signals.append({signal.column: signal for signal in reader.header.signals if signal.kind != "status"})
            data.append(read_run(folder, reader))
        finally:
            reader.close()
    common = [column for column in signals[0] if all(column in found for found in signals)]
    if not common:
        raise RunFolderError(f"{folders[0].path} has no signal in common with the other runs; compare runs of one rig")
    every = dict.fromkeys(column for found in signals for column in found)
    return Comparison(
        tuple(names),
        tuple(data),
        {column: signals[0][column].unit for column in common},
        tuple(
            _difference(signals[0][column], name, data[0], other)
            for column in common
            for name, other in zip(names[1:], data[1:], strict=True)
        ),
        tuple(_drifts([manifest.get("parameters") or {} for manifest in manifests])),
        tuple(column for column in every if column not in common),
    )


def aligned(reference: RunData, other: RunData, column: str) -> Floats:
    """Return the values (n,) of `other` at the profile times of `reference` (n,), NaN where it has none near."""
    if not len(other.time_s):
        return np.full(len(reference.time_s), np.nan)
    after = np.clip(np.searchsorted(other.time_s, reference.time_s), 0, len(other.time_s) - 1)
    before = np.maximum(after - 1, 0)
    is_before = np.abs(other.time_s[before] - reference.time_s) <= np.abs(other.time_s[after] - reference.time_s)
    nearest = np.where(is_before, before, after)
    apart = np.abs(other.time_s[nearest] - reference.time_s)
    is_near = apart <= 0.5 * max(reference.period_s, other.period_s) + 1e-6
    return np.where(is_near, other.columns[column][nearest], np.nan)


def _difference(signal: Signal, name: str, reference: RunData, other: RunData) -> Difference:
    first, second = reference.columns[signal.column], aligned(reference, other, signal.column)
    common = np.isfinite(first) & np.isfinite(second)
    share = float(common.mean()) if len(common) else 0.0
    if not common.any():
        return Difference(signal.column, signal.unit, name, share)
    with np.errstate(over="ignore", invalid="ignore"):
        off = second[common] - first[common]
        at = int(np.argmax(np.abs(off)))
        mean, bias = float(second[common].mean()), float(off.mean())
        reference_mean, rms = float(first[common].mean()), root_mean_square(off)
    return Difference(
        signal.column,
        signal.unit,
        name,
        share,
        _known(reference_mean),
        _known(mean),
        _known(bias),
        _known(rms),
        _known(float(off[at])),
        float(reference.time_s[common][at]),
    )


def _known(number: float) -> float | None:
    """Return a number; None where damaged values were too large for a difference or a sum."""
    return number if math.isfinite(number) else None


def _drifts(parameters: Sequence[Mapping[str, Mapping[str, Any]]]) -> list[Drift]:
    """Return the drift of each parameter that two runs or more have from the same calibrator."""
    found = []
    for calibrator in dict.fromkeys(name for tables in parameters for name in tables):
        tables = [each.get(calibrator, {}) for each in parameters]
        for parameter in dict.fromkeys(name for table in tables for name in table):
            cells = [table.get(parameter) for table in tables]
            if sum(cell is not None for cell in cells) < 2:
                continue
            values = tuple(None if cell is None else float(cell[0]) for cell in cells)
            widths = tuple(None if cell is None or cell[1] is None else float(cell[1]) for cell in cells)
            found.append(Drift(calibrator, parameter, values, widths, _beyond(values, widths)))
    return found


def _beyond(values: Sequence[float | None], widths: Sequence[float | None]) -> tuple[bool, ...]:
    """Return for each run True where its value differs from the first by more than both half widths in quadrature."""
    first, width = values[0], widths[0]
    told = []
    for value, half in zip(values, widths, strict=True):
        known = first is not None and value is not None and width is not None and half is not None
        told.append(known and abs(value - first) > math.hypot(half, width))  # type: ignore[operator,arg-type]
    return tuple(told)
