"""Session of an explanation: diagnose, run the experiment that the diagnosis plans, diagnose again with its record.

Each finished round is written before the next one begins, so that a stopped session continues after it.
"""

from __future__ import annotations

import datetime
import shlex
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from hil.diagnosis import DiagnosisRequest, PreparedDiagnosis, Written, after_label, choice_for, prepare, write_results
from hil.explain.experiment import RigChoice, is_record_of, planned, run_request, runs_of
from hil.explain.explanation import (
    DOCUMENT,
    Experiment,
    Explanation,
    ExplanationError,
    HashedFile,
    Round,
    beliefs_of,
    errors_of,
    read_explanation,
    write_explanation,
)
from hil.explain.page import write_page
from hil.record import ReadingOptions, read_record
from hil.run.session import RunRequest, RunResult, check_session, current_record
from hil.run_folder import RunFolder, RunFolderError
from twin.discovery import Diagnosis


@dataclass(frozen=True)
class ExplainRequest:
    """Request of an explanation.

    Attributes
    ----------
    diagnosis
        Request of the first diagnosis; its `more` are the later records that were given.
    folder
        Folder of the results.
    rounds
        Most experiments in this folder.
    rig
        Rig for the experiments; None designs them only.
    """

    diagnosis: DiagnosisRequest
    folder: Path
    rounds: int
    rig: RigChoice | None


class Operator(Protocol):
    """Person at the terminal, and the work that is shown there."""

    def diagnose(self, ready: PreparedDiagnosis, number: int) -> Diagnosis:
        """Diagnose with a progress bar. Errors are those of `diagnose_files`."""

    def show(self, ready: PreparedDiagnosis, found: Diagnosis, written: Written, one: Round) -> None:
        """Print the diagnosis of a round."""

    def approve(self, experiment: Experiment, run: RunRequest, notes: Sequence[str]) -> bool:
        """Show the experiment, with `notes` on its run; return True if it shall be run."""

    def run(self, request: RunRequest) -> RunResult:
        """Carry the run out and show its result. Errors are those of `run_session`."""

    def note(self, text: str) -> None:
        """Print one line."""


def explain(request: ExplainRequest, operator: Operator) -> Explanation:
    """Diagnose and experiment until the cause is settled; return all rounds, which are written to the folder.

    Raises
    ------
    ExplanationError
        The folder holds the explanation of another record, twin or healthy record, or a damaged one.
    OSError
        The disk is full. Further errors are those of `diagnose_files` and `run_session`.
    """
    state = _opened(request)
    if state.rounds:
        operator.note(f"{request.folder / DOCUMENT} holds {_counted(len(state.rounds), 'round')}; it is continued")
    given = _new_records(state, request.diagnosis.more)
    if not state.rounds:
        state = _diagnosed(request, state, given, None, operator)
    elif not given and _has_other_limits(request, state.last):
        operator.note(f"the experiment of round {state.last.number} is designed anew, within the limits of this rig")
        state = _diagnosed(request, state, (), state.last.ran, operator, number=state.last.number)
    elif given:
        plan = state.last.next
        ran = plan if plan is not None and any(is_record_of(path, plan) for path in given) else None
        state = _diagnosed(request, state, given, ran, operator)
    while True:
        end = _end(request, state)
        if end is not None:
            return _written(request, end)
        try:
            done = _experiment(request, state, operator)
        except Exception:
            operator.note(f"finished rounds are kept in {request.folder}; the same command continues after them")
            raise
        if isinstance(done, Explanation):
            return _written(request, done)
        state = _diagnosed(request, state, (done,), state.last.next, operator)


def _opened(request: ExplainRequest) -> Explanation:
    """Return the explanation in the folder, or a new one."""
    asked = request.diagnosis
    ready = prepare(asked)
    healthy = ready.healthy_file
    new = Explanation(
        record=HashedFile.of(asked.record),
        twin=HashedFile.of(asked.twin),
        healthy=HashedFile.of(healthy) if healthy else None,
    )
    try:
        request.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ExplanationError(
            f"{request.folder} cannot be made ({error.strerror}); choose another folder with --out"
        ) from None
    old = read_explanation(request.folder)
    if old is None:
        return new
    for name in ("record", "twin", "healthy"):
        was, now = getattr(old, name), getattr(new, name)
        if (was and was.sha256) != (now and now.sha256):
            which = "healthy record" if name == "healthy" else name
            raise ExplanationError(
                f"{request.folder / DOCUMENT} was made with the {which} {was.path if was else '(none)'}, which differs "
                f"from {now.path if now else 'no such record'}; give another folder with --out"
            )
    missing = [one.path for one in (old.last.records if old.rounds else ()) if not Path(one.path).is_file()]
    if missing:
        raise ExplanationError(
            f"{missing[0]}, the record of an experiment, is not there; put it back, or give another folder with --out"
        )
    return old


def _new_records(state: Explanation, given: Sequence[Path]) -> tuple[Path, ...]:
    """Return the records that the last round did not have."""
    known = {one.sha256 for one in state.last.records} if state.rounds else set()
    return tuple(path for path in given if HashedFile.of(path).sha256 not in known)


def _has_other_limits(request: ExplainRequest, last: Round) -> bool:
    """Return True if the next experiment was designed without the rig of this request, or within other limits."""
    if request.rig is None or last.verdict != "ambiguous" or last.next is None:
        return False
    return last.next.rig is None or last.next.rig.sha256 != HashedFile.of(request.rig.rig).sha256


def _end(request: ExplainRequest, state: Explanation) -> Explanation | None:
    """Return the explanation with its end, or None where an experiment is next."""
    last = state.last
    if last.verdict != "ambiguous":
        return state.ended("settled", "")
    if last.next is None or not last.next.possible:
        return state.ended("not separable", last.next.why if last.next else "the diagnosis plans none for these causes")
    if request.rig is None:
        return state.ended("no rig", "no rig was named for the experiment")
    if state.experiments >= request.rounds:
        more = f"--rounds {request.rounds + 1} allows another one"
        return state.ended("no more rounds", f"{_counted(state.experiments, 'experiment')} did not settle it; {more}")
    return None


def _experiment(request: ExplainRequest, state: Explanation, operator: Operator) -> Path | Explanation:
    """Run the next experiment and return its record, or the explanation with the reason for none."""
    choice, experiment = request.rig, state.last.next
    assert choice is not None and experiment is not None
    if not Path(experiment.profile).is_file():
        raise ExplanationError(
            f"{experiment.profile}, the experiment of round {state.last.number}, is not there; put it back, or give "
            "another folder with --out"
        )
    earlier = runs_of(choice, experiment, state.last.made)
    for folder, status in earlier:
        if status.startswith("done"):
            operator.note(f"the experiment has run to its end already: {folder.path}")
            return _record_of(state, folder)
    if earlier:
        folder, status = earlier[0]
        was = "was cut" if status == "running" else status
        resume = f"`hil resume {shlex.quote(str(folder.path))}`"
        operator.note(f"{folder.path} {was}; a new run begins ({resume} would complete that one)")
    passed = sum(_duration_s(Path(one.path), request.diagnosis.choice) for one in state.last.records)
    run = run_request(choice, experiment, request.diagnosis.twin, passed)
    if not operator.approve(experiment, run, check_session(run).notes):
        return state.ended("declined", "the experiment was not run")
    _written(request, state)
    result = operator.run(run)
    if result.derived is not None and result.derived.stopped_by is not None:
        return state.ended("stopped", f"stopped after the end of the experiment ({result.folder.path})")
    if result.outcome.status == "done":
        return _record_of(state, result.folder)
    reason = f"the experiment {result.outcome.verdict}: {result.outcome.reason} (in {result.folder.path})"
    return state.ended("stopped", reason)


def _record_of(state: Explanation, run: RunFolder) -> Path | Explanation:
    """Return the record of a finished run, or the explanation with the reason for none."""
    try:
        return current_record(run, lambda text: None)
    except RunFolderError as error:
        return state.ended("stopped", str(error))


def _diagnosed(
    request: ExplainRequest,
    state: Explanation,
    given: Sequence[Path],
    ran: Experiment | None,
    operator: Operator,
    number: int | None = None,
) -> Explanation:
    """Return the explanation with a further round, with the records of the last one and those `given`.

    With `number`, that round is made anew.
    """
    began = time.monotonic()
    number = len(state.rounds) if number is None else number
    before = [Path(one.path) for one in state.last.records] if state.rounds else []
    records = (*before, *given)
    ready = prepare(replace(request.diagnosis, more=records))
    found = operator.diagnose(ready, number)
    folder = request.folder / f"round-{number}"
    written, _ = write_results(ready, found, folder, empirical=False, began=began)
    document = found.document()
    one = Round(
        number=number,
        made=datetime.datetime.now(datetime.UTC),
        records=[HashedFile.of(path) for path in records],
        ran=ran,
        verdict=found.verdict,
        summary=found.summary,
        beliefs=beliefs_of(document),
        held_out_s=tuple(document["error"]["held_out_s"]),
        after=after_label(document),
        errors=errors_of(document["error"]["sensors"]),
        further={one["record"]: errors_of(one["sensors"]) for one in document["further_records"]},
        folder=str(folder.absolute()),
        revision=str(written.revision.absolute()) if written.revision else None,
        next=planned(document["next_experiment"], written.experiment, request.diagnosis.rig),
    )
    state = _written(request, state.with_round(one))
    operator.show(ready, found, written, one)
    return state


def _written(request: ExplainRequest, state: Explanation) -> Explanation:
    write_explanation(state, request.folder)
    write_page(state, request.folder)
    return state


def _duration_s(record: Path, choice: ReadingOptions | None) -> float:
    time_s = read_record(record, choice=choice_for(record, choice)).time_s
    return float(time_s[-1] - time_s[0])


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'s' * (count != 1)}"
