"""Fleet file: rigs with their records, and the kinds of jobs to run over them, as TOML."""

from __future__ import annotations

import difflib
import glob
import hashlib
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, cast

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, field_validator

from drivers.rig_file import line_of, mistake, read_regular, tables_of
from twin.calibrators import CALIBRATOR_NAMES

_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
MOST_JOBS = 1_000_000
"""Most jobs of a file: a slip in a pattern or a list of seeds should not fill the memory."""


class FleetError(ValueError):
    """Error of a fleet file or its folder; one sentence in each line, with file, line and remedy."""


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


def _checked_id(text: str) -> str:
    if not _ID.fullmatch(text):
        raise ValueError(f"{text!r} must be at most 64 letters, digits and _ . - only, since files have it; rename it")
    return text


_Id = Annotated[str, AfterValidator(_checked_id)]
_Names = Annotated[tuple[str, ...], Field(min_length=1, strict=False)]
_Seeds = Annotated[tuple[Annotated[int, Field(ge=0, le=2**32 - 1)], ...], Field(min_length=1, strict=False)]


class RigSection(_Strict):
    """Rig: its twin, its records and how they are read."""

    name: _Id
    records: _Names
    twin: str | None = None
    healthy: str | None = None
    clock: str | None = None
    decimal: Literal[".", ","] | None = None
    dates: Literal["dmy", "mdy", "ymd"] | None = None
    time_column: str | None = None
    time_scale: Annotated[float, Field(gt=0.0, strict=False)] = 1.0


class _OverRecords(_Strict):
    over_records: ClassVar[bool] = True
    rigs: _Names | None = None


class DiagnoseSection(_OverRecords):
    """Diagnosis of each record, as `hil diagnose` makes it."""

    kind: Literal["diagnose"]
    page: bool = True


class TrackSection(_OverRecords):
    """Replay of the calibrators on each record, as `hil track` makes it, with each seed."""

    kind: Literal["track"]
    calibrators: _Names | None = None
    seeds: _Seeds = (0,)
    predictions: bool = False

    @field_validator("calibrators")
    @classmethod
    def _known(cls, names: tuple[str, ...] | None) -> tuple[str, ...] | None:
        unknown = [name for name in names or () if name not in CALIBRATOR_NAMES]
        if unknown:
            raise ValueError(f"no calibrator {', '.join(unknown)}; there are {', '.join(CALIBRATOR_NAMES)}")
        return names


class _OverSeeds(_Strict):
    over_records: ClassVar[bool] = False
    reserved: ClassVar[dict[str, str]] = {
        "--seed": "seeds of the entry are the seeds",
        "--out": "the fleet keeps the files of each job",
        "--json": "the fleet reads the result as JSON",
    }
    """Options that `arguments` may not have, with the reason."""
    seeds: _Seeds = (0,)
    arguments: Annotated[tuple[str, ...], Field(strict=False)] = ()

    @field_validator("arguments")
    @classmethod
    def _without_reserved(cls, arguments: tuple[str, ...]) -> tuple[str, ...]:
        for word in arguments:
            name = word.partition("=")[0]
            if name in cls.reserved:
                raise ValueError(f"{name} cannot be given here: {cls.reserved[name]}; take it out")
        return arguments


class TrainSection(_OverSeeds):
    """Training of a member of the network with each seed, as `hil train loop` makes it."""

    reserved: ClassVar[dict[str, str]] = {
        **_OverSeeds.reserved,
        "--data": "the key data names the windows",
        "--minutes": "a job is a whole training, whose length --steps sets",
    }
    kind: Literal["train"]
    data: str | None = None


class BenchSection(_OverSeeds):
    """Benchmark with each seed, as `hil bench` runs it."""

    kind: Literal["bench"]
    bench: Annotated[str, Field(pattern=r"^[a-z][a-z0-9-]*$")]


JobSection = DiagnoseSection | TrackSection | TrainSection | BenchSection
KINDS: dict[str, type[BaseModel]] = {
    "diagnose": DiagnoseSection,
    "track": TrackSection,
    "train": TrainSection,
    "bench": BenchSection,
}


class FleetSection(_Strict):
    """Content of a fleet file."""

    id: _Id
    title: str = ""
    attempts: Annotated[int, Field(ge=1, le=100)] = 3
    rig: Annotated[tuple[RigSection, ...], Field(strict=False)] = ()
    job: Annotated[tuple[Annotated[JobSection, Field(discriminator="kind")], ...], Field(min_length=1, strict=False)]


@dataclass(frozen=True, slots=True)
class FleetRig:
    """Rig of a fleet: paths of its records, twin and healthy record, and the options of reading.

    `twin` is None where each record has a `twin.toml` in its folder, as that of a run has.
    """

    name: str
    records: tuple[Path, ...]
    twin: Path | None
    healthy: Path | None
    section: RigSection


@dataclass(frozen=True, slots=True)
class FleetJob:
    """Entry `[[job]]`: its section, its rigs, its further files by name, and its file and line."""

    section: JobSection
    rigs: tuple[FleetRig, ...]
    files: tuple[tuple[str, Path], ...]
    place: str


@dataclass(frozen=True, slots=True)
class Fleet:
    """Fleet file, read and checked; `attempts` is the most starts of a job."""

    id: str
    title: str
    path: Path
    sha256: str
    attempts: int
    rigs: tuple[FleetRig, ...]
    jobs: tuple[FleetJob, ...]


def read_fleet(path: Path) -> Fleet:
    """Read the fleet file at `path`; raise FleetError with a sentence for every mistake."""
    try:
        content = read_regular(path)
        text, document = tables_of(content)
    except OSError as error:
        raise FleetError(f"{path} cannot be read ({error.strerror}); give the path of a fleet file") from error
    except ValueError as error:
        raise FleetError(f"{path} {error}") from None
    try:
        read = FleetSection.model_validate(document)
    except ValidationError as error:
        # An entry with a mistake is taken out of its list, which is too short then.
        places = [item["loc"] for item in error.errors()]
        items = [
            item
            for item in error.errors()
            if item["type"] != "too_short" or not any(p[: len(item["loc"])] == item["loc"] != p for p in places)
        ]
        raise FleetError("\n".join(_sentence(path, text, document, item) for item in items)) from None
    problems: list[str] = []
    rigs = _rigs(path, text, read, problems)
    jobs = _jobs(path, text, read, rigs, problems)
    if problems:
        raise FleetError("\n".join(problems))
    return Fleet(
        id=read.id,
        title=read.title or read.id,
        path=path,
        sha256=hashlib.sha256(content).hexdigest(),
        attempts=read.attempts,
        rigs=tuple(rigs.values()),
        jobs=jobs,
    )


def _sentence(path: Path, text: str, document: dict[str, Any], item: Any) -> str:
    # Pydantic puts the kind of a job behind its number.
    place = tuple(part for number, part in enumerate(item["loc"]) if not (number == 2 and part in KINDS))
    if item["type"] in ("too_short", "missing") and place == ("job",):
        return f"{path}, line 1: the file has no [[job]]; add one"
    owner, model = "", cast(type[BaseModel], FleetSection)
    if len(place) > 1 and place[0] in ("rig", "job") and isinstance(place[1], int):
        table = document[place[0]][place[1]]
        key = "name" if place[0] == "rig" else "kind"
        named = table.get(key) if isinstance(table, dict) else None
        owner = f" of {place[0]} {named if isinstance(named, str) and named else place[1] + 1}"
        model = RigSection if place[0] == "rig" else KINDS.get(str(named), FleetSection)
    if item["type"].startswith("union_tag"):
        line = line_of(text, (*place, "kind"))
        given = item["input"].get("kind") if isinstance(item["input"], dict) else None
        said = "kind is missing" if given is None else f"there is no kind of job {given!r}"
        return f"{path}, line {line}: {said}; use {', '.join(KINDS)}"
    keys = ".".join(str(part) for part in (place[2:] if owner else place) if not isinstance(part, int)) or "entry"
    said = mistake(item)
    if item["type"] == "extra_forbidden":
        names = list(model.model_fields)
        near = difflib.get_close_matches(str(place[-1]), names, n=1)
        said = (
            f"is not a key here; did you mean {near[0]}?" if near else f"is not a key here; it has {', '.join(names)}"
        )
    return f"{path}, line {line_of(text, place)}: {keys}{owner}: {said}"


def _rigs(path: Path, text: str, read: FleetSection, problems: list[str]) -> dict[str, FleetRig]:
    rigs: dict[str, FleetRig] = {}
    for number, section in enumerate(read.rig):

        def place(key: str, number: int = number, name: str = section.name) -> str:
            return f"{path}, line {line_of(text, ('rig', number, key))}: {key} of rig {name}"

        if section.name in rigs:
            problems.append(f"{place('name')} is there twice; give each rig its own name")
        records: dict[Path, None] = {}
        for pattern in section.records:
            found = _matches(path.parent, pattern)
            if not found:
                problems.append(
                    f"{place('records')}: there is no record {path.parent / pattern}; correct the path, which begins "
                    "at the folder of the file"
                )
            records |= dict.fromkeys(found)
        files: dict[str, Path | None] = {}
        for key in ("twin", "healthy"):
            named = getattr(section, key)
            files[key] = None if named is None else path.parent / named
            if named is not None and not (path.parent / named).is_file():
                problems.append(
                    f"{place(key)}: there is no file {path.parent / named}; correct the path, which begins at the "
                    "folder of the file"
                )
        if section.twin is None and (bare := [r for r in records if not (r.parent / "twin.toml").is_file()]):
            problems.append(f"{place('twin')}: is missing, and {bare[0].parent} has no twin.toml; name the twin")
        rigs[section.name] = FleetRig(section.name, tuple(records), files["twin"], files["healthy"], section)
    return rigs


def _matches(folder: Path, pattern: str) -> list[Path]:
    """Return the records of a pattern in order of their names: files, and those of run folders.

    A name without a pattern is that file.
    """
    literal = folder / pattern
    if literal.is_file():
        return [literal]
    names = [folder / name for name in sorted(glob.glob(pattern, root_dir=folder, recursive=True))]
    records = [path / "record.parquet" if path.is_dir() else path for path in names]
    return [path for path in records if path.is_file()]


def _jobs(
    path: Path, text: str, read: FleetSection, rigs: dict[str, FleetRig], problems: list[str]
) -> tuple[FleetJob, ...]:
    jobs, count = [], 0
    for number, section in enumerate(read.job):

        def place(key: str, number: int = number) -> str:
            return f"{path}, line {line_of(text, ('job', number, key))}"

        chosen: tuple[FleetRig, ...] = ()
        if isinstance(section, _OverRecords):
            names = section.rigs or tuple(rigs)
            unknown = [name for name in names if name not in rigs]
            if not rigs:
                problems.append(f"{place('kind')}: {section.kind} needs a rig with records; add a [[rig]]")
            elif unknown:
                problems.append(
                    f"{place('rigs')}: rigs of job {section.kind}: there is no rig {unknown[0]!r}; there are "
                    f"{', '.join(rigs)}"
                )
            chosen = tuple(rigs[name] for name in dict.fromkeys(names) if name in rigs)
        files: tuple[tuple[str, Path], ...] = ()
        if isinstance(section, TrainSection) and section.data is not None:
            folder = path.parent / section.data
            found = sorted(each for each in folder.rglob("*") if each.is_file())
            files = tuple((each.relative_to(folder).as_posix(), each) for each in found)
            if not files:
                problems.append(
                    f"{place('data')}: data of job train: there is no file in {folder}; make it with hil train, or "
                    "take the key out"
                )
        seeds = getattr(section, "seeds", (0,))
        count += len(seeds) * (sum(len(rig.records) for rig in chosen) or 1)
        jobs.append(FleetJob(section, chosen, files, place("kind")))
    if count > MOST_JOBS:
        problems.append(f"{path}, line 1: the file has {count} jobs, at most {MOST_JOBS} are run; split it")
    return tuple(jobs)
