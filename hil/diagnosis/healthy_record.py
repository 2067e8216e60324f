"""The healthy record that a twin was commissioned on: kept beside the twin file, so that nobody has to name it."""

from __future__ import annotations

import dataclasses
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.rig_file.reader import file_sha256
from hil.record.reader import Record, write_record
from twin.network import Network, TwinFileError
from twin.revisions import chain
from twin.twinfile import save


@dataclass(frozen=True)
class Kept:
    """`path` of the record, None where there is none to be had; `why` then, where a twin file says that there was."""

    path: Path | None = None
    why: str = ""


def beside(twin: Path) -> Path:
    """Where the record that a new twin file is commissioned on is kept."""
    return twin.with_name(f"{twin.stem}.healthy.parquet")


def save_with_record(network: Network, record: Record, out: Path) -> Path:
    """Save a commissioned twin as `out`, and what it reads of the record that it was commissioned on beside it.

    Raises:
        TwinFileError: a file cannot be written.
    """
    from hil.diagnosis.columns import CLOCK, clock_beside, start_hour

    wanted = {*network.input_columns, *(c for sensor in network.sensors for c in sensor.measured), CLOCK, "segment"}
    columns = {name: values for name, values in record.columns.items() if name in wanted or name == "profile_s"}
    hour = start_hour(record)
    if hour is None and record.path is not None:
        hour = clock_beside(record.path)
    if hour is not None and CLOCK not in columns:
        columns[CLOCK] = ((hour + record.time_s / 3600.0) % 24.0).astype(np.float64)
    kept = beside(out)
    try:
        write_record(Record(record.time_s, columns), kept)
    except OSError as error:
        raise TwinFileError(f"{kept} cannot be written ({error.strerror}); give --out another folder") from error
    revision = dataclasses.replace(network.revision, record=file_sha256(kept), record_file=kept.name)
    save(dataclasses.replace(network, revision=revision), out)
    return kept


def commissioned_on(twin: Path) -> Kept:
    """The healthy record of a twin file, or of the one that it was made of.

    Raises:
        TwinFileError: the file cannot be used.
    """
    for entry in chain(twin):
        revision = entry.network.revision
        if not revision.record:
            continue
        path = entry.path.parent / Path(revision.record_file or beside(entry.path)).name
        if not path.is_file():
            missing = f"{path.name}, on which {entry.path.name} was commissioned, is not beside it any more"
            return Kept(None, f"{missing}; put it back, or name a healthy record with --healthy")
        if file_sha256(path) != revision.record:
            return Kept(None, f"{path.name} is no longer what {entry.path.name} was commissioned on: left aside")
        return Kept(path)
    return Kept()


def copy_record(twin: Path, folder: Path) -> None:
    """Copy the healthy record of a twin file, if there is one, into a folder to which that file is copied."""
    kept = commissioned_on(twin).path
    if kept is not None:
        shutil.copyfile(kept, folder / kept.name)
