"""Session of one diagnosis, from its files to its results."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from hil.diagnosis.columns import (
    clock_of,
    datasheet_clock,
    further_columns,
    read_columns,
    read_healthy,
    with_clock,
)
from hil.diagnosis.experiment_file import limits_of, write_experiment
from hil.diagnosis.healthy_record import HealthyRecord, commissioned_on, is_other_record
from hil.diagnosis.results import provenance, write, write_data
from hil.diagnosis.revision import revise, write_proposal
from hil.journal import record_sha256
from hil.record import ReadingOptions, read_record
from hil.record.values import UnitQuestion, open_questions
from twin import Network, TwinFileError, load
from twin.discovery import (
    FLOW_MEASURED,
    Columns,
    Diagnosis,
    Limits,
    NotHealthyError,
    TooShortError,
    column_mistakes,
    diagnose,
    diagnose_grown,
    errors_on_further_record,
    fits_growth,
    with_unused,
)

FLOWS = ("_L_per_min", "_m3_per_h", "_kg_per_s", "_kg_s")
"""Suffixes of columns of a measured flow."""


@dataclass(frozen=True)
class DiagnosisRequest:
    """Request of a diagnosis.

    Attributes
    ----------
    record
        File of the record, or of steady states where `at_rest`.
    twin
        File of the twin.
    healthy
        Healthy record of the rig; None takes the one stored with the twin, if any.
    use_healthy
        False takes the noise floor from `record` alone.
    more
        Later records of the same rig.
    at_rest
        Each row of `record` is a steady state.
    rig
        Rig file whose limits a next experiment keeps; None keeps it within what the record has seen.
    clock
        Time of day at 0 s of the record, like 08:00; None takes what the record says of it.
    choice
        How the records are read.
    named
        Function that names a file in the results, where copies have the names of their originals; None takes the path.
    units_checked
        True if the record's units are right, whatever its reader asks about them.
    """

    record: Path
    twin: Path
    healthy: Path | None = None
    use_healthy: bool = True
    more: tuple[Path, ...] = ()
    at_rest: bool = False
    rig: Path | None = None
    clock: str | None = None
    choice: ReadingOptions | None = None
    named: Callable[[Path], str] | None = None
    units_checked: bool = False

    def name_of(self, path: Path) -> str:
        """Return the name of a file in the results."""
        return str(path) if self.named is None else self.named(path)


@dataclass(frozen=True)
class PreparedDiagnosis:
    """Files of a request, read: the twin with the time of day as an input, the healthy record and its source."""

    request: DiagnosisRequest
    network: Network
    twin: Network
    """Return the twin as its file has it."""
    hour: float | None
    healthy: Columns | None
    stored: HealthyRecord

    @property
    def healthy_file(self) -> Path | None:
        """Return the file of the healthy record, given or stored."""
        return self.request.healthy or self.stored.path


@dataclass(frozen=True)
class Written:
    """Files of a diagnosis; None for those that it did not make.

    Attributes
    ----------
    unsaved
        Reason why the revision could not be saved; "" where it was, or there is none.
    """

    page: Path | None = None
    revision: Path | None = None
    experiment: Path | None = None
    proposal: Path | None = None
    unsaved: str = ""


def prepare(request: DiagnosisRequest) -> PreparedDiagnosis:
    """Read twin and healthy record.

    Raises
    ------
    RecordError, TwinFileError, DiagnosingError
        One of them cannot be used; the message names the file.
    """
    twin = load(request.twin)
    told = request.healthy is not None or not request.use_healthy or request.at_rest
    stored = HealthyRecord() if told else commissioned_on(request.twin)
    healthy = request.healthy or stored.path
    hour = clock_of(request.clock) if request.clock else datasheet_clock(request.record)
    network = with_clock(twin) if hour is not None and not request.at_rest else twin
    choice = request.choice if request.healthy else None
    columns = read_healthy(network, request.twin, healthy, hour, choice) if healthy else None
    return PreparedDiagnosis(request, network, twin, hour, columns, stored)


def diagnose_files(ready: PreparedDiagnosis, say: Callable[[str], None], note: Callable[[str], None]) -> Diagnosis:
    """Diagnose the record of a request.

    Parameters
    ----------
    say
        Called with each stage.
    note
        Called with the notes of the record's reader.

    Raises
    ------
    RecordError, TwinFileError
        The record or the healthy one cannot be diagnosed; the message names the file.
    """
    request, network = ready.request, ready.network
    try:
        record, messages = read_columns(
            network, request.record, ready.hour, at_rest=request.at_rest, choice=request.choice
        )
    except TooShortError as error:
        raise TwinFileError(f"{error}; where each row is a steady state of its own, give --at-rest") from None
    limits = limits_of(request.rig) if request.rig is not None else None
    later = further_columns(network, request.more, ready.hour, request.choice)
    for message in messages:
        note(message)
    try:
        found = answer(
            network,
            record,
            ready.healthy,
            more=later,
            limits=limits,
            at_rest=request.at_rest,
            say=say,
        )
    except NotHealthyError as error:
        raise TwinFileError(f"{ready.healthy_file}: {error}") from None
    except TwinFileError as error:
        raise TwinFileError(f"{request.record}: {error}") from None
    if not request.units_checked:
        asked = () if request.at_rest else map(UnitQuestion, column_mistakes(network, record, ready.healthy))
        found = depending_on_units(found, network, (*asked, *messages))
    found = dataclasses.replace(found, read=messages)
    if found.next_experiment and FLOW_MEASURED in found.next_experiment["measure"]:
        found = with_unread_flow(found, network, read_record(request.record, choice=request.choice).columns)
    if ready.stored.why:
        found = dataclasses.replace(found, notes=(ready.stored.why, *found.notes))
    return found


def with_unread_flow(found: Diagnosis, network: Network, columns: Iterable[str]) -> Diagnosis:
    """Return a diagnosis with a note on a measured flow among the record's columns that the twin does not read."""
    flow = next((e for e in network.elements if e.kind == "flow"), None)
    unread = [c for c in columns if c.endswith(FLOWS) and c not in columns_in_use(network)]
    if flow is None or not unread:
        return found
    nominal = network.parameters[f"{flow.name}.nominal"]
    note = (
        f"the record has a measured flow that the twin does not read ({', '.join(unread)}): compare it at equal pump "
        f"speeds before and after the onset; to have the twin follow it, give it in % of {nominal.value:.4g} "
        f"{nominal.unit} as the column that pump of {flow.name} names, then commission and diagnose again"
    )
    return dataclasses.replace(found, notes=(*found.notes, note))


def columns_in_use(network: Network) -> set[str]:
    """Return the columns of a record that a twin reads: its inputs and those of its sensors."""
    return set(network.recorded_inputs) | {c for named in network.sensor_columns.values() for c in named}


def depending_on_units(found: Diagnosis, network: Network, messages: Sequence[str]) -> Diagnosis:
    """Return `found` with the open questions of columns that it depends on, and then without a certain effect.

    A wrong unit or heading of a column reads like an effect. As long as a question is open, an effect is one of two
    explanations: the verdict is `ambiguous`, and the twin gets no revision.
    """
    asked = open_questions(columns_in_use(network), messages)
    if not asked:
        return found
    warning = (
        f"the answer depends on an open question about columns: {' '.join(asked)} Correct the record or its heading, "
        "or give --units-checked"
    )
    found = dataclasses.replace(found, warnings=(warning, *found.warnings))
    if found.verdict == "adequate":
        return found
    verdict = found.verdict if found.verdict == "unexplained" else "ambiguous"
    summary = f"{' '.join(asked)} If the columns are right: {found.summary}"
    return dataclasses.replace(found, verdict=verdict, summary=summary, network=None)


def write_results(
    ready: PreparedDiagnosis, found: Diagnosis, folder: Path, *, empirical: bool, began: float, page: bool = True
) -> tuple[Written, dict[str, object]]:
    """Save the revision and write document, page, proposal and next experiment; return them and the document's extra.

    Parameters
    ----------
    empirical
        Adopt the curve that is offered where nothing explains the record.
    began
        `time.monotonic()` at the start, s.
    page
        False leaves the page with its figures out, which take a third of the time.
    """
    request = ready.request
    revision, unsaved = None, ""
    try:
        revision = revise(found, ready.twin, request.twin, request.record, empirical=empirical)
    except OSError as error:
        unsaved = f"{request.twin.parent}: {error.strerror or error}; make it writable, or copy the twin elsewhere"
    except TwinFileError as error:
        unsaved = str(error)
    extra = described(ready, revision, began)
    files = {"record": request.record, "twin": request.twin, "healthy record": ready.healthy_file}
    files |= {f"later record {number}": path for number, path in enumerate(request.more, start=1)}
    extra["provenance"] = provenance(files, record_sha256(request.record), _options(ready), request.name_of)
    drawn = None
    if page:
        drawn = write(found, ready.network.sensor_names, folder, extra)
        extra["page"] = request.name_of(drawn)
    else:
        write_data(found, ready.network.sensor_names, folder, extra)
    proposal = write_proposal(found, ready.twin, request.record, folder)
    return Written(drawn, revision, write_experiment(found, folder, request.rig), proposal, unsaved), extra


def _options(ready: PreparedDiagnosis) -> list[str]:
    """Return the options of a request that change what its diagnosis can find.

    A healthy record given for a twin that has none stored is none of them: without it, less is found.
    """
    request = ready.request
    made = {
        "--no-healthy": not request.use_healthy and commissioned_on(request.twin).path is not None,
        "--healthy": is_other_record(request.twin, request.healthy),
        "--with": bool(request.more),
        "--at-rest": request.at_rest,
        "options of reading": request.choice not in (None, ReadingOptions()),
    }
    return [name for name, is_made in made.items() if is_made]


def described(ready: PreparedDiagnosis, revision: Path | None, began: float) -> dict[str, object]:
    """Return the files of a diagnosis and its duration, for its document."""
    healthy, named = ready.healthy_file, ready.request.name_of
    return {
        "record": named(ready.request.record),
        "twin": named(ready.request.twin),
        "revision": named(revision) if revision else None,
        "healthy": named(healthy) if healthy else None,
        "seconds": round(time.monotonic() - began, 2),
    }


def answer(
    network: Network,
    record: Columns,
    healthy: Columns | None,
    *,
    more: Mapping[str, Columns],
    limits: Limits | None,
    at_rest: bool,
    say: Callable[[str], None],
) -> Diagnosis:
    """Return the diagnosis: a score test of effects for a commissioned twin, or the growth of one that never was.

    Raises
    ------
    TwinFileError
        The record cannot be diagnosed.
    """
    if at_rest or (healthy is None and fits_growth(network, record)):
        found = diagnose_grown(network, record, more=tuple(more.values()), at_rest=at_rest, say=say)
    else:
        found = diagnose(network, record, healthy, more=tuple(more.values()), say=say, limits=limits)
    found = with_unused(found, network, record.inputs)
    if not more:
        return found
    say("predicting the further records")
    further = tuple(errors_on_further_record(found, network, columns, name) for name, columns in more.items())
    said = (one.says for one in further if one.says)
    return dataclasses.replace(found, elsewhere=further, notes=(*found.notes, *said))
