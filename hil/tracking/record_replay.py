"""Replay of a record past a static twin and tracked ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hil.tracking.twins import Comparison, Proposed, Twins, disturbance, window_kind

if TYPE_CHECKING:
    from hil.record import Record

BLOCK_ROWS = 1200


@dataclass(frozen=True, slots=True)
class Replay:
    """Result of a replay.

    Attributes
    ----------
    comparison
        Errors, bands and parameters of the twins on the whole record.
    windows
        Calibrator -> kind of window -> count.
    disturbed
        Windows with an unknown power: calibrator, end in s, sentence.
    proposals
        Proposals of the network.
    outputs
        Predictions (n, m) degC by twin.
    """

    comparison: Comparison
    windows: dict[str, dict[str, int]]
    disturbed: tuple[dict[str, Any], ...]
    proposals: tuple[Proposed, ...]
    outputs: dict[str, NDArray[np.float64]]

    def document(self, twins: Twins) -> dict[str, Any]:
        """Return the result as plain data, without the predictions; `twins` are those of the replay."""
        return {
            "errors_K": dataclasses.asdict(self.comparison.errors),
            "bands": self.comparison.bands,
            "parameters": self.comparison.parameters,
            "parameter_units": self.comparison.units,
            "left_out": twins.left_out,
            "tuned": twins.tuning(),
            "outdone": self.comparison.outdone,
            "windows": self.windows,
            "disturbed": list(self.disturbed),
            "proposals": [p.document for p in self.proposals],
        }


def replay(twins: Twins, record: Record, progress: Callable[[int], None]) -> Replay:
    """Replay a record past new twins; `progress` gets the number of samples done.

    Raises
    ------
    RecordError
        A column that the twin needs is not in the record.
    """
    record.require(*twins.network.recorded_inputs)
    outputs: dict[str, list[NDArray[np.float64]]] = {}
    windows: dict[str, dict[str, int]] = {name: {} for name in twins.calibrators}
    disturbed: list[dict[str, Any]] = []
    proposals: list[Proposed] = []
    for done, block in twins.over(record.time_s, record.columns, BLOCK_ROWS):
        for name, values in block.outputs.items():
            outputs.setdefault(name, []).append(values)
        for window in block.calibrations:
            kind = window_kind(window.document)
            windows[window.calibrator][kind] = windows[window.calibrator].get(kind, 0) + 1
            if (found := disturbance(window.document)) is not None:
                disturbed.append({"calibrator": window.calibrator, "window_end_s": window.end_s, "found": found})
        proposals += block.proposals
        progress(done)
    joined = {name: np.concatenate(blocks) for name, blocks in outputs.items()}
    return Replay(twins.comparison(), windows, tuple(disturbed), tuple(proposals), joined)


def write_predictions(out: Path, twins: Twins, record: Record, found: Replay) -> None:
    """Write the predictions as a record, a column for each sensor and twin, `.parquet` or `.csv`; raises OSError."""
    from hil.record import Record as Written
    from hil.record import write_record

    columns: dict[str, NDArray[np.float64]] = {}
    for name, values in found.outputs.items():
        sensors = enumerate(twins.network.sensor_names)
        columns |= {f"{sensor.removesuffix('_C')}_{name}_C": values[:, i] for i, sensor in sensors}
    write_record(Written(record.time_s, columns), out)
