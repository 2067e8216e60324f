"""Errors that a user can correct, and their form in the terminal: plain sentences and an exit code."""

from __future__ import annotations

import contextlib
import errno
import sys
from collections.abc import Iterator

_EXHAUSTED = (errno.ENOMEM, errno.EMFILE, errno.ENFILE, errno.EAGAIN)
FOUND = 1
USAGE = 2


def exit_code(error: BaseException) -> int | None:
    """Return 2 for a wrong file or option, 1 for a fault found on the rig or in a run, None for a bug."""
    from drivers.signals import ConfigurationError, DriverError
    from hil.journal import JournalError
    from hil.run.locks import RigBusyError, RigLockError
    from hil.run_folder import FolderLostError, RunFolderError
    from hil.tracking import TrackingError

    if isinstance(error, ConfigurationError):
        return USAGE
    if isinstance(error, DriverError | JournalError | RigBusyError | RigLockError | TrackingError | FolderLostError):
        return FOUND
    if isinstance(error, RunFolderError):
        return USAGE
    names = {kind.__name__ for kind in type(error).__mro__}
    if names & {
        "ProfileError",
        "ScenarioError",
        "RecordError",
        "TwinFileError",
        "EffectFileError",
        "DiagnosingError",
        "SubjectError",
        "DiagnosisFolderError",
        "ExplanationError",
        "HieraError",
        "TestPlanError",
    }:
        return USAGE
    if names & {"VirtualRigError", "ViewerError", "ControlError", "PdfError", "TowerOutputError"}:
        return FOUND
    return None


def exhausted_resource(error: BaseException) -> str | None:
    """Return the resource that this machine lacks, as a sentence; None if an error has another cause."""
    exhausted = isinstance(error, OSError) and error.errno in _EXHAUSTED
    threads = isinstance(error, RuntimeError) and "can't start new thread" in str(error)
    if not (exhausted or threads or isinstance(error, MemoryError)):
        return None
    return (
        f"this machine has no memory, thread or file descriptor left ({error or type(error).__name__}); end other "
        "programs. A run that was under way has been made safe first: `hil report RUN` makes its files"
    )


@contextlib.contextmanager
def explained() -> Iterator[None]:
    """Report a user's error as sentences on standard error with its exit code; let bugs through."""
    try:
        yield
    except Exception as error:
        code, message = exit_code(error), str(error)
        if code is None and (reason := exhausted_resource(error)) is not None:
            code, message = FOUND, reason
        if code is None:
            raise
        from hil.files import on_terminal

        for sentence in message.splitlines():
            print(f"hil: {on_terminal(sentence)}", file=sys.stderr)
        sys.exit(code)
