"""Healthy record that a twin was commissioned on, stored with the twin file so that no command has to name it."""

from __future__ import annotations

import dataclasses
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.rig_file import file_sha256
from hil.record import Record, write_record
from hil.record.times import span
from twin import Network, TwinFileError, chain, save
from twin.discovery import stuck


@dataclass(frozen=True)
class HealthyRecord:
    """Healthy record of a twin: `path`, or None with the reason `why` if the twin file names a missing record."""

    path: Path | None = None
    why: str = ""


def healthy_path(twin: Path) -> Path:
    """Return the path for the healthy record of a new twin file."""
    return twin.with_name(f"{twin.stem}.healthy.parquet")


def without_stuck(network: Network, record: Record) -> Record:
    """Return a record without the readings of stuck thermometers, and with a message about each."""
    columns, messages = dict(record.columns), []
    for sensor in network.sensors:
        sigma = network.parameters[f"{sensor.name}.sigma"].value
        for name in sensor.measured:
            for one in stuck(name, record.time_s, record.columns[name], sigma) if name in record.columns else ():
                columns[name] = columns[name].copy()
                columns[name][one.rows] = np.nan
                messages.append(
                    f"{name} reads {one.value:g} without any noise from {span(one.first_s)} to {span(one.last_s)}, as "
                    "a stuck channel does: its readings there are left out of the fit and of the healthy record"
                )
    return dataclasses.replace(record, columns=columns, messages=(*record.messages, *messages))


def save_with_record(network: Network, record: Record, out: Path) -> Path:
    """Save a commissioned twin as `out`, and with it the columns that it reads of its healthy record.

    Raises
    ------
    TwinFileError
        A file cannot be written.
    """
    from hil.diagnosis.columns import CLOCK, datasheet_clock, start_hour

    wanted = {*network.input_columns, *(c for sensor in network.sensors for c in sensor.measured), CLOCK, "segment"}
    columns = {name: values for name, values in record.columns.items() if name in wanted or name == "profile_s"}
    hour = start_hour(record)
    if hour is None and record.path is not None:
        hour = datasheet_clock(record.path)
    if hour is not None and CLOCK not in columns:
        columns[CLOCK] = ((hour + record.time_s / 3600.0) % 24.0).astype(np.float64)
    stored = healthy_path(out)
    try:
        write_record(Record(record.time_s, columns), stored)
    except OSError as error:
        raise TwinFileError(f"{stored} cannot be written ({error.strerror}); give --out another folder") from error
    revision = dataclasses.replace(network.revision, record=file_sha256(stored), record_file=stored.name)
    save(dataclasses.replace(network, revision=revision), out)
    return stored


def commissioned_on(twin: Path) -> HealthyRecord:
    """Return the healthy record of a twin file, or of its nearest ancestor.

    Raises
    ------
    TwinFileError
        The file cannot be used.
    """
    for entry in chain(twin):
        revision = entry.network.revision
        if not revision.record:
            continue
        path = entry.path.parent / Path(revision.record_file or healthy_path(entry.path)).name
        if not path.is_file():
            missing = f"{path.name}, on which {entry.path.name} was commissioned, is not in its folder any more"
            return HealthyRecord(None, f"{missing}; put it back, or name a healthy record with --healthy")
        if file_sha256(path) != revision.record:
            return HealthyRecord(
                None, f"{path.name} has changed since {entry.path.name} was commissioned on it: not used"
            )
        return HealthyRecord(path)
    return HealthyRecord()


def copy_record(twin: Path, folder: Path) -> None:
    """Copy the healthy record of a twin file, if there is one, into the folder of a copy of that file."""
    stored = commissioned_on(twin).path
    if stored is not None:
        shutil.copyfile(stored, folder / stored.name)


def is_other_record(twin: Path, healthy: Path | None) -> bool:
    """Return True for a healthy record with another content than the one that is stored with the twin file.

    Raises
    ------
    TwinFileError
        The twin file cannot be used.
    """
    stored = commissioned_on(twin).path
    return healthy is not None and stored is not None and file_sha256(healthy) != file_sha256(stored)
