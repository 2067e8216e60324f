"""Table of a diagnosis for the terminal: errors of free runs over the held-out segment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.table import Table

from hil.diagnosis.wording import after_label
from hil.record.times import span


def held_out(document: Mapping[str, Any]) -> str:
    """Return the title of the table of `document`: the segment of its errors."""
    if document.get("method") == "growth at rest":
        return "RMSE in K, every fourth steady state, held out of every fit"
    low, high = document["error"]["held_out_s"]
    return f"RMSE in K, free run from {span(low)} to {span(high)}, held-out segment"


def errors_of(document: dict[str, Any]) -> Table:
    """Return the errors of the diagnosis whose `diagnosis.json` is `document`, K, one row a sensor."""
    return error_table(document["error"]["sensors"], after_label(document))


def error_table(sensors: Mapping[str, Mapping[str, float | None]], after: str) -> Table:
    """Return a row for each sensor: errors in K of the baseline twin, re-tuned and `after`, and the noise.

    Parameters
    ----------
    sensors
        By name, with the keys of `SensorError`.
    after
        Heading of the last twin; "re-tuned" leaves that column out.
    """
    table = Table()
    columns = {"stale": "baseline", "before": "re-tuned", "after": after, "noise": "noise"}
    if after == "re-tuned":
        del columns["after"]
    table.add_column("sensor")
    for heading in columns.values():
        table.add_column(heading, justify="right")
    for name, error in sensors.items():
        cells = (error[key] for key in columns)
        table.add_row(name, *("-" if cell is None else f"{cell:.3f}" for cell in cells))
    return table
