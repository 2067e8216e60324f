"""Jobs of a fleet file: inputs with digests, and an id from the content, so that equal work is done once."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil import __version__
from hil.diagnosis import commissioned_on
from hil.files import safe_file_name
from hil.fleet.fleet_file import Fleet, FleetError, FleetJob, FleetRig
from twin import TwinFileError, chain

READING = ("clock", "decimal", "dates", "time_column", "time_scale")
"""Keys of a rig that say how its records are read."""
SHEET = "datasheet.json"
"""File beside a record that states the time of day at its beginning."""
_LONGEST_NAME = 120


@dataclass(frozen=True, slots=True)
class JobInput:
    """File of a job: its role, its place on a worker below the job's folder, its path here and its SHA-256."""

    role: str
    place: str
    path: Path
    sha256: str


@dataclass(frozen=True, slots=True)
class Job:
    """Job: `id` names its files and follows from all the rest; `seed` is None where a kind has none."""

    id: str
    kind: str
    rig: str
    record: str
    seed: int | None
    options: Mapping[str, Any]
    inputs: tuple[JobInput, ...]

    def content(self) -> dict[str, bytes]:
        """Return the bytes of the inputs by their place; raise FleetError if one has changed since it was listed."""
        found = {}
        for one in self.inputs:
            try:
                found[one.place] = one.path.read_bytes()
            except OSError as error:
                raise FleetError(f"{one.path} cannot be read ({error.strerror}); put it back") from None
            if hashlib.sha256(found[one.place]).hexdigest() != one.sha256:
                raise FleetError(f"{one.path} has changed since the fleet began; give the same command again")
        return found


def jobs_of(fleet: Fleet) -> tuple[Job, ...]:
    """Return the jobs of a fleet in the order of its file; raise FleetError if an input cannot be used."""
    jobs: dict[str, Job] = {}
    inputs = _Inputs()
    for entry in fleet.jobs:
        for job in _jobs(entry, fleet.path.parent, inputs):
            jobs.setdefault(job.id, job)
    return tuple(jobs.values())


def _jobs(entry: FleetJob, folder: Path, inputs: _Inputs) -> Iterator[Job]:
    section = entry.section
    options = section.model_dump(exclude={"kind", "rigs", "seeds", "data"})
    seeds: tuple[int | None, ...] = getattr(section, "seeds", (None,))
    if not section.over_records:
        files = tuple(inputs.file("data", path, f"data/{name}", entry.place) for name, path in entry.files)
        for seed in seeds:
            yield _job(section.kind, ("", ""), seed, options, files)
        return
    for rig in entry.rigs:
        reading = rig.section.model_dump(include=set(READING))
        for record in rig.records:
            files = tuple(inputs.of_record(rig, record, entry.place))
            for seed in seeds:
                yield _job(section.kind, (rig.name, _shown(record, folder)), seed, {**options, **reading}, files)


def _job(
    kind: str, subject: tuple[str, str], seed: int | None, options: dict[str, Any], inputs: tuple[JobInput, ...]
) -> Job:
    rig, record = subject
    content = {
        "hil": __version__,
        "kind": kind,
        "rig": rig,
        "record": record,
        "seed": seed,
        "options": options,
        "inputs": [(one.role, one.place, one.sha256) for one in inputs],
    }
    digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
    words = [kind, *([options["bench"]] if "bench" in options else []), rig, Path(record).stem if record else ""]
    words += [f"s{seed}"] if seed is not None else []
    name = safe_file_name("-".join(word for word in words if word), _LONGEST_NAME)
    return Job(f"{name}-{digest}", kind, rig, record, seed, options, inputs)


class _Inputs:
    """Inputs of jobs; each file is read once."""

    def __init__(self) -> None:
        self._digests: dict[Path, str] = {}
        self._twins: dict[Path, tuple[Path, ...]] = {}

    def of_record(self, rig: FleetRig, record: Path, line: str) -> Iterator[JobInput]:
        """Yield the files that a diagnosis or a replay of a record reads: also the ancestors of the twin."""
        yield self.file("record", record, f"record/{record.name}", line)
        sheet = record.parent / SHEET
        if sheet.is_file() and sheet != record:
            yield self.file("sheet", sheet, f"record/{SHEET}", line)
        twin = rig.twin or record.parent / "twin.toml"
        for number, path in enumerate(self._twin_files(twin, line)):
            yield self.file("twin" if number == 0 else "of the twin", path, f"twin/{path.name}", line)
        if rig.healthy is not None:
            yield self.file("healthy", rig.healthy, f"healthy/{rig.healthy.name}", line)

    def _twin_files(self, twin: Path, line: str) -> tuple[Path, ...]:
        """Return a twin, its ancestors and the healthy record that is stored with them."""
        if twin not in self._twins:
            try:
                stored = commissioned_on(twin).path
                ancestors = tuple(entry.path for entry in chain(twin))
            except (TwinFileError, OSError) as error:
                raise FleetError(f"{line}: {error}") from None
            self._twins[twin] = ancestors if stored is None else (*ancestors, stored)
        return self._twins[twin]

    def file(self, role: str, path: Path, place: str, line: str) -> JobInput:
        """Return an input with its digest; raise FleetError if it cannot be read."""
        if path not in self._digests:
            try:
                with path.open("rb") as file:
                    self._digests[path] = hashlib.file_digest(file, "sha256").hexdigest()
            except OSError as error:
                raise FleetError(
                    f"{line}: {path} cannot be read ({error.strerror}); correct it or its permissions"
                ) from None
        return JobInput(role, place, path, self._digests[path])


def _shown(record: Path, folder: Path) -> str:
    """Return a record as the file names it: from its folder, where it lies below."""
    return record.relative_to(folder).as_posix() if record.is_relative_to(folder) else str(record)
