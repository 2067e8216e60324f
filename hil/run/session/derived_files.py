"""Files derived from the journal after a run: record, adopted revision, review and report.

Each is made independently, so that a failure or a signal in one leaves the others. `run.json` names the missing ones
with the reason, and `hil report RUN` makes them later. The journal is read and never written here.
"""

from __future__ import annotations

import contextlib
import json
import shlex
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hil.errors import exit_code
from hil.files import printable, replacing
from hil.journal import JournalError, JournalReader, export_record
from hil.record import read_record
from hil.run.engine import RunSignals
from hil.run.session.manifest import foreign_journal
from hil.run_folder import FolderLostError, RunFolder, left_safe
from hil.tracking import Adoption, Proposed, adopt, adoption_manifest, closed_gates

RECORD, REVIEW, REPORT, REVISION = "record.parquet", "review.rrd", "report.html", "adopted revision"
VERDICT = "verdict.json"
_NOT_YET = "not made yet"
_REPEAT_S = 0.02
_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)


@dataclass(slots=True)
class DerivedFiles:
    """Files derived from a run: `folder` holds them, `missing` maps each file that was not made to the reason.

    `stopped_by` is the signal that ended the work, `adopted` the revision of the twin.
    """

    folder: RunFolder
    missing: dict[str, str] = field(default_factory=dict)
    stopped_by: signal.Signals | None = None
    adopted: Adoption | None = None

    @property
    def gates(self) -> str | None:
        """Sentence about the proposals that the network's gates held; None where it proposed nothing."""
        try:
            proposals = _proposals(self.folder)
        except JournalError:
            return None
        return closed_gates(proposals) if proposals else None

    def exit_code(self, in_order: bool) -> int:
        """Return the exit code of the command of a run that was `in_order` or not.

        The code is 128 plus the signal's number where a signal left files missing, 1 where a file is missing or the
        run was not in order, else 0.
        """
        if self.stopped_by is not None and self.missing:
            return 128 + self.stopped_by
        return 0 if in_order and not self.missing else 1


class _StoppedError(BaseException):
    """Request of a signal to end the work; no handler of `Exception` may catch it."""


class _StopRequest:
    """Deliberate signal that ends the work: it interrupts a block that runs `armed`.

    A signal may come while Python runs a finalizer or a callback of a weak reference, where it discards every
    exception; the signal is repeated then, until the block has ended.
    """

    def __init__(self) -> None:
        self.received: signal.Signals | None = None
        self._armed = False
        self._discarded = False
        self._repeats: list[threading.Timer] = []

    @contextlib.contextmanager
    def armed(self) -> Iterator[None]:
        """Raise _StoppedError in the block when a signal comes; outside of it the signal is only stored."""
        before = sys.unraisablehook

        def discarded(unraisable: sys.UnraisableHookArgs) -> None:
            if isinstance(unraisable.exc_value, _StoppedError):
                self._repeat()
            else:
                before(unraisable)

        self._armed, sys.unraisablehook = True, discarded
        try:
            if self.received is not None:
                raise _StoppedError
            yield
        finally:
            self._armed, sys.unraisablehook = False, before
            for repeat in self._repeats:
                repeat.cancel()
                if repeat.is_alive():
                    repeat.join()
            self._repeats.clear()

    def _repeat(self) -> None:
        self._discarded = True
        main, number = threading.main_thread().ident, self.received
        if main is not None and number is not None:
            self._repeats.append(threading.Timer(_REPEAT_S, signal.pthread_kill, (main, number)))
            self._repeats[-1].start()

    def __call__(self, number: signal.Signals, is_deliberate: bool) -> None:
        if number not in _ENDING or not (is_deliberate or self._discarded):
            return  # an echo disturbs no end that has begun
        self.received, self._discarded = self.received or number, False
        if self._armed:
            raise _StoppedError


def derive_files(
    folder: RunFolder,
    manifest: dict[str, Any],
    announce: Callable[[str], None],
    *,
    omitted: Collection[str] = (),
    signals: RunSignals | None = None,
) -> DerivedFiles:
    """Write `manifest` as `run.json`, then every file that is derived from the journal of the run in `folder`.

    Parameters
    ----------
    folder
        Folder of an ended run. The files follow it if it was moved while this process held it.
    manifest
        Content of `run.json`; its `missing` and `adoption` are set.
    announce
        Gets a line for each file, and for those that could not be made.
    omitted
        Names of files not to make: they are current, or nobody asked for them.
    signals
        Signals of the run; a deliberate one ends the making of files, and nothing else.

    Raises
    ------
    FolderLostError
        The folder was deleted, or `run.json` cannot be written; the message names a copy of it.
    """
    try:
        place = folder.located()
    except FolderLostError as error:
        raise _lost(folder, manifest, str(error), "its samples are lost") from None
    if place.path != folder.path:
        announce(f"the run's folder was moved: its files go to {place.path}")
    derived = DerivedFiles(place)
    steps = {name: step for name, step in _steps(manifest, derived).items() if name not in omitted}
    derived.missing = dict.fromkeys(steps, _NOT_YET)
    with contextlib.ExitStack() as stack:
        stop = _StopRequest()
        # The signals of the run are held beyond this block, until its last message is written.
        stack.enter_context((signals or stack.enter_context(RunSignals())).phase(stop))
        # From here on run.json names the missing files, also after a kill.
        with contextlib.suppress(OSError):
            place.write_manifest(manifest | {"missing": derived.missing})
        foreign = foreign_journal(place, manifest)
        for name, step in steps.items():
            if stop.received is None and foreign is None:
                announce(f"writing {name}")
            why = foreign or _made(step, stop)
            if why is None:
                del derived.missing[name]
            else:
                derived.missing[name] = why
        derived.stopped_by = stop.received
        manifest["missing"] = derived.missing
        try:
            place.write_manifest(manifest)
        except OSError as error:
            lost = FolderLostError(f"{place.path} cannot be written ({error.strerror})")
            rest = f"make it writable, then `{_command(place)}` makes the rest"
            raise _lost(place, manifest, str(lost), rest) from None
    if derived.missing:
        announce(missing_sentence(derived))
    return derived


def missing_sentence(derived: DerivedFiles) -> str:
    """Return a sentence about the missing files, the reasons, and the command that makes them."""
    what = "; ".join(f"{name} ({why})" for name, why in derived.missing.items())
    return f"not made: {what}; `{_command(derived.folder)}` makes them from the journal"


def _command(folder: RunFolder) -> str:
    from hil.run.session.terminal import invocation

    return f"{invocation()} report {shlex.quote(str(folder.path))}"


def _steps(manifest: dict[str, Any], derived: DerivedFiles) -> dict[str, Callable[[], None]]:
    """Return the steps by file, in order: later files show results of earlier ones."""
    folder = derived.folder

    def record() -> None:
        export_record(folder.journal, folder.record, {"uid": manifest["uid"], "started": manifest["started"]})

    def revision() -> None:
        profile = printable(Path(manifest["files"]["profile"]["path"]).name)
        made_by = f"hil run {profile} --network-mode controlled"
        derived.adopted = adopt(folder.twin, read_record(folder.record), _proposals(folder), made_by)
        manifest["adoption"] = adoption_manifest(derived.adopted)

    def review() -> None:
        from hil.review import write_review

        write_review(folder.journal, folder.review)

    def verdict() -> None:
        from hil.testing import TestPlanError, judge_run, read_plan

        test = manifest["files"]["test"]
        path = Path(test["path"])
        plan = read_plan(path)
        if plan.sha256 != test["sha256"]:
            judged = shlex.join(["hil", "test", str(path), "--on", str(folder.path)])
            raise TestPlanError(f"{path} is not what it was when the run began; judge the run with `{judged}`")
        manifest["verdict"] = judge_run(plan, folder).verdict

    def report() -> None:
        from hil.report import write_report

        left = {name: why for name, why in derived.missing.items() if name != REPORT}
        folder.write_manifest(manifest | {"missing": derived.missing})
        write_report(folder, missing=left)

    adopts = manifest["settings"].get("network_mode") == "controlled" and folder.twin.is_file()
    tests = "test" in manifest["files"]
    return (
        {RECORD: record}
        | ({REVISION: revision} if adopts else {})
        | ({VERDICT: verdict} if tests else {})
        | {REVIEW: review, REPORT: report}
    )


def _proposals(folder: RunFolder) -> list[Proposed]:
    reader = JournalReader(folder.journal)
    try:
        return [Proposed(row.calibrator, row.time_s, row.document) for row in reader.proposals()]
    finally:
        reader.close()


def _made(step: Callable[[], None], stop: _StopRequest) -> str | None:
    """Run one step; return why its file could not be made, or None."""
    try:
        with stop.armed():
            step()
    except _StoppedError:
        assert stop.received is not None
        return f"stopped by {stop.received.name}"
    except OSError as error:
        return error.strerror or str(error)
    except Exception as error:
        known = exit_code(error) is not None
        return str(error) if known else f"{type(error).__name__}: {error}; a defect of hil, please report it"
    return None


def _lost(folder: RunFolder, manifest: dict[str, Any], what: str, then: str) -> FolderLostError:
    """Return the error about a lost folder, with the end of the run and the place of the saved manifest."""
    rig = "the rig was left safe" if left_safe(manifest) else "the rig was NOT confirmed safe: look at it now"
    if manifest.get("untouched") and not left_safe(manifest):
        rig = "nothing was written to the rig"
    reason = f" ({manifest['reason']})" if manifest.get("reason") else ""
    copy = _last_copy(folder, manifest)
    where = f"how it ended stands in {copy}" if copy is not None else "run.json could be saved nowhere"
    return FolderLostError(f"{what}; the run {manifest['exit_status']}{reason}, {rig}; {where}; {then}")


def _last_copy(folder: RunFolder, manifest: dict[str, Any]) -> Path | None:
    """Write `run.json` beside the folder, else into a new temporary folder; return its path, or None."""
    beside = folder.path.absolute().parent
    for parent in (lambda: beside, lambda: Path(tempfile.mkdtemp(prefix="hil-run-"))):
        with contextlib.suppress(OSError):
            path = parent() / f"{folder.path.name}.run.json"
            with replacing(path) as unfinished:
                unfinished.write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
            return path
    return None
