"""Errors that a user can correct, and their form in the terminal: plain sentences and an exit code."""

from __future__ import annotations

import contextlib
import errno
import re
import resource
import sys
from collections.abc import Iterator

_EXHAUSTED = (errno.ENOMEM, errno.EMFILE, errno.ENFILE, errno.EAGAIN)
_DENIED = {
    errno.EACCES: "give this user the right to it, or choose another place",
    errno.EPERM: "give this user the right to it, or choose another place",
    errno.EROFS: "choose a place that can be written",
    errno.ENOSPC: "make room, or choose another place",
    errno.EDQUOT: "make room, or choose another place",
}
"""Refusals of the file system and their remedies."""
_UNMAPPED = re.compile(r"failed to map segment|cannot allocate memory|cannot map zero-fill", re.IGNORECASE)
"""Words of the dynamic loader (glibc) where it has no memory for a library."""
_AFTER = "A run that was under way has been made safe first: `hil report RUN` makes its files"
ADDRESS_SPACE = 4e9
"""Address space in bytes below which a command warns: a diagnosis of ten hours takes more than 2 GB of it."""
_LONGEST = 120
"""Characters of a library's sentence that a message repeats."""
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
    names = {kind.__name__ for kind in type(error).__mro__}
    if "HistorianError" in names:  # a store is an input, unless it fails while it is used
        return FOUND if "HistorianFailedError" in names else USAGE
    if isinstance(error, DriverError | JournalError | RigBusyError | RigLockError | TrackingError | FolderLostError):
        return FOUND
    if isinstance(error, RunFolderError):
        return USAGE
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
        "ExportError",
        "HieraError",
        "TestPlanError",
        "StreamError",
        "AlarmError",
        "PanelError",
        "FleetError",
        "ExecutorOptionError",
        "StartError",
    }:
        return USAGE
    if names & {
        "VirtualRigError",
        "ViewerError",
        "ControlError",
        "PdfError",
        "TowerOutputError",
        "StoreDownError",
        "NotSentError",
        "ExecutorError",
        "FleetFolderError",
    }:
        return FOUND
    return None


def exhausted_resource(error: BaseException) -> str | None:
    """Return the resource that this machine lacks, as a sentence; None if an error has another cause."""
    if (memory := _lack_of_memory(error)) is not None:
        return memory
    exhausted = isinstance(error, OSError) and error.errno in _EXHAUSTED
    threads = isinstance(error, RuntimeError) and "can't start new thread" in str(error)
    if not (exhausted or threads):
        return None
    return f"this machine has no thread or file descriptor left ({error}); end other programs. {_AFTER}"


def _lack_of_memory(error: BaseException) -> str | None:
    """Return the sentence on a lack of memory where that caused an error, however a library reports it; else None.

    The loader refuses a library for which no address space is left, numpy and Arrow raise a MemoryError of their own,
    and a library's reader may have made another error of it.
    """
    seen: set[int] = set()
    cause: BaseException | None = error
    while cause is not None and id(cause) not in seen:
        seen.add(id(cause))
        unloaded = isinstance(cause, ImportError | OSError) and _UNMAPPED.search(str(cause)) is not None
        if isinstance(cause, MemoryError) or unloaded or getattr(cause, "errno", None) == errno.ENOMEM:
            limit = address_space()
            within = "" if limit is None else f" within the {limit / 1e9:.1f} GB that `ulimit -v` allows"
            raised = "end other programs" if limit is None else "raise that limit"
            return f"there is not enough memory{within} ({_short(cause)}); {raised}. {_AFTER}"
        cause = cause.__cause__ or cause.__context__
    return None


def warn_of_little_memory() -> None:
    """Write one sentence to standard error where the limit of the address space is too low for some commands.

    A library in C++ that is refused memory ends the process, and no sentence can be written then.
    """
    limit = address_space()
    if limit is not None and limit < ADDRESS_SPACE:
        print(
            f"hil: `ulimit -v` allows {limit / 1e9:.1f} GB of memory, and some commands take {ADDRESS_SPACE / 1e9:g}; "
            "raise that limit if this one is aborted",
            file=sys.stderr,
        )


def address_space() -> int | None:
    """Return the limit of this process's address space in bytes, None without one."""
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    return None if limit in (resource.RLIM_INFINITY, -1) else limit


def _short(error: BaseException) -> str:
    said = " ".join(str(error).split()) or type(error).__name__
    return said if len(said) <= _LONGEST else f"{said[:_LONGEST]}..."


@contextlib.contextmanager
def explained() -> Iterator[None]:
    """Report a user's error as sentences on standard error with its exit code; let bugs through."""
    try:
        yield
    except Exception as error:
        if (lack := _lack_of_memory(error)) is not None:
            print(f"hil: {lack}", file=sys.stderr)  # Nothing is imported: that takes memory.
            sys.exit(FOUND)
        code, message = exit_code(error), str(error)
        if code is None and (reason := exhausted_resource(error)) is not None:
            code, message = FOUND, reason
        if code is None and isinstance(error, OSError) and error.errno in _DENIED:
            denied = error.filename or "a file"
            code, message = USAGE, f"{denied}: {error.strerror}; {_DENIED[error.errno]}"
        if code is None:
            raise
        from hil.files import on_terminal

        for sentence in message.splitlines():
            print(f"hil: {on_terminal(sentence)}", file=sys.stderr)
        sys.exit(code)
