"""A record that a test made, as a file."""

from __future__ import annotations

from pathlib import Path

from hil.record.reader import Record, write_record
from twin.discovery.healthy.basis import Columns
from twin.network import Network


def written(network: Network, made: Columns, path: Path) -> Path:
    """The record as a file, each sensor's mean in all of its columns."""
    columns = dict(zip(network.input_columns, made.inputs.T, strict=True))
    for j, names in enumerate(network.sensor_columns.values()):
        columns |= dict.fromkeys(names, made.measured[:, j])
    write_record(Record(made.time_s, columns), path)
    return path
