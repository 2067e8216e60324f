"""Which errors are a user's to mend, and how they reach the terminal: plain sentences and an exit code."""

from __future__ import annotations

import contextlib
import errno
import sys
from collections.abc import Iterator

_EXHAUSTED = (errno.ENOMEM, errno.EMFILE, errno.ENFILE, errno.EAGAIN)
FOUND = 1
USAGE = 2


def exit_code(error: BaseException) -> int | None:
    """2 for a file or an option that is wrong, 1 for a fault found on the rig or in a run, None for a bug."""
    from drivers.signals.points import ConfigurationError, DriverError
    from hil.journal.writer import JournalError
    from hil.run.locks.lock_folder import RigLockError
    from hil.run.locks.rig_lock import RigBusyError
    from hil.run_folder.folder import FolderLostError, RunFolderError
    from hil.tracking.process import TrackingError

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
        "HieraError",
    }:
        return USAGE
    if names & {"VirtualRigError", "ViewerError", "ControlError", "TowerOutputError"}:
        return FOUND
    return None


def lacking(error: BaseException) -> str | None:
    """Return what this machine lacks, as a sentence; None where an error has another cause."""
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
    """Turn a user's error into its sentences on standard error and its exit code; let bugs through."""
    try:
        yield
    except Exception as error:
        code, said = exit_code(error), str(error)
        if code is None and (lack := lacking(error)) is not None:
            code, said = FOUND, lack
        if code is None:
            raise
        for sentence in said.splitlines():
            print(f"hil: {sentence}", file=sys.stderr)
        sys.exit(code)
