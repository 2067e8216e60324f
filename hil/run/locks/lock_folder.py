"""Lock files of one user and the trusted folders that hold them.

A lock folder is used only where no other user could have made it first. It lies inside a base folder that belongs to
this user and that no other user can write to. Bases are the home folder of the user's passwd entry, `HOME` and
`XDG_RUNTIME_DIR`. A run takes its locks in every one of them. A run of cron has no `XDG_RUNTIME_DIR` and still meets a
run of the desktop. A run with another `HOME` meets both.

A base of the environment that belongs to another user means that the run has another user's environment. A lock folder
that belongs to another user or cannot be written to means that its locks prove nothing. Both are errors, not warnings.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import pwd
import socket
import stat
from dataclasses import dataclass
from pathlib import Path

from hil.files import parse_json

UNDER_HOME = Path(".local/state/hil/locks")
"""Place of the lock folder in a home folder (state data of the XDG base directory specification)."""
UNDER_RUNTIME = Path("hil/locks")
"""Place of the lock folder in `XDG_RUNTIME_DIR`."""


class RigLockError(Exception):
    """Lock that other runs would not respect; the message names the folder and the remedy."""


@dataclass(frozen=True, slots=True)
class LockBase:
    """Folder that should be this user's own. `named` is the environment variable that names it, or empty."""

    path: Path
    under: Path
    named: str = ""


def bases() -> tuple[LockBase, ...]:
    """Return the folders in which runs of this user look for one another, each once."""
    found: dict[Path, LockBase] = {}
    with contextlib.suppress(KeyError):  # a container's user may have no passwd entry
        home = Path(pwd.getpwuid(os.getuid()).pw_dir)
        found[home] = LockBase(home, UNDER_HOME)
    for name, under in (("HOME", UNDER_HOME), ("XDG_RUNTIME_DIR", UNDER_RUNTIME)):
        path = Path(os.environ.get(name, ""))
        if path.is_absolute():
            found.setdefault(path, LockBase(path, under, name))
    return tuple(found.values())


class LockFolder:
    """Open, trusted folder of lock files."""

    def __init__(self, path: Path, handle: int) -> None:
        self.path = path
        self._handle = handle

    def take(self, name: str) -> LockFile | None:
        """Return the lock file `name`, locked; None where another process holds it.

        Raises
        ------
        OSError
            The file cannot be made, or the file system has no locks.
        """
        while True:
            handle = os.open(name, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600, dir_fd=self._handle)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(handle)
                return None
            except OSError:
                os.close(handle)
                raise
            if self._is_current(name, handle):
                return LockFile(self._handle, name, handle)
            os.close(handle)  # its owner removed it between our two calls

    def holder(self, name: str) -> LockHolder | None:
        """Return the holder in the lock file `name`, or None where that is not known."""
        try:
            handle = os.open(name, os.O_RDONLY | os.O_NOFOLLOW, dir_fd=self._handle)
        except OSError:
            return None
        try:
            return LockHolder.read(os.pread(handle, 10_000, 0))
        except OSError:
            return None
        finally:
            os.close(handle)

    def close(self) -> None:
        """Close the folder; harmless when repeated."""
        if self._handle >= 0:
            os.close(self._handle)
            self._handle = -1

    def _is_current(self, name: str, handle: int) -> bool:
        """Return True where the locked file is still the one that others find under its name."""
        with contextlib.suppress(FileNotFoundError):
            return os.path.samestat(os.fstat(handle), os.stat(name, dir_fd=self._handle, follow_symlinks=False))
        return False


class LockFile:
    """Lock that this process holds. The kernel releases it at the end of the process, by any cause."""

    def __init__(self, folder: int, name: str, handle: int) -> None:
        self._folder, self._name, self._handle = folder, name, handle

    def fileno(self) -> int:
        """Return the descriptor: a process with a copy of it holds the lock, too."""
        return self._handle

    def write(self, holder: LockHolder) -> None:
        """Write the holder. On a full disk a refused run does not learn the holder's name."""
        text = holder.as_bytes()
        with contextlib.suppress(OSError):
            os.pwrite(self._handle, text, 0)
            os.ftruncate(self._handle, len(text))

    def release(self) -> None:
        """Remove the file and release its lock."""
        # In this order: a process that opened the file before detects the removal, see `LockFolder.take`.
        with contextlib.suppress(OSError):
            os.unlink(self._name, dir_fd=self._folder)
        os.close(self._handle)


@dataclass(frozen=True, slots=True)
class LockHolder:
    """Process that holds a lock, and the folder of its run once there is one."""

    pid: int
    machine: str
    folder: str | None = None

    @classmethod
    def own(cls, folder: Path | None) -> LockHolder:
        """Return this process as a holder."""
        return cls(os.getpid(), socket.gethostname(), None if folder is None else str(folder.absolute()))

    @classmethod
    def read(cls, text: bytes) -> LockHolder | None:
        """Return the holder that `as_bytes` wrote, or None."""
        try:
            found = parse_json(text)
            return cls(int(found["pid"]), str(found["machine"]), found["folder"])
        except (ValueError, KeyError, TypeError, OverflowError):
            return None

    def as_bytes(self) -> bytes:
        """Return the text of a lock file."""
        return json.dumps({"pid": self.pid, "machine": self.machine, "folder": self.folder}).encode()


def open_folders() -> tuple[list[LockFolder], list[RigLockError]]:
    """Open every lock folder of this user and make the missing ones; return them with the errors of the others.

    The case without any folder is an error, too.
    """
    found: list[LockFolder] = []
    errors: list[RigLockError] = []
    tried = bases()
    for base in tried:
        try:
            folder = _open(base)
        except RigLockError as error:
            errors.append(error)
        else:
            found += [] if folder is None else [folder]
    if not found and not errors:
        listed = ", ".join(str(base.path) for base in tried) or "no home folder, and XDG_RUNTIME_DIR is not set"
        errors.append(RigLockError(f"no folder of your own for rig locks ({listed}); set XDG_RUNTIME_DIR to one"))
    return found, errors


def _open(base: LockBase) -> LockFolder | None:
    """Return the lock folder in `base`, None where there is no such base; raises RigLockError."""
    try:
        status = base.path.stat()
    except OSError:
        return None
    problem = _why_untrusted(status)
    if problem is not None:
        if not base.named:
            return None  # a service's home may be `/`: every run of that user sees it so
        raise RigLockError(f"{base.named} is {base.path}, which {problem}; set it to a folder of your own, or unset it")
    path = base.path / base.under
    try:
        return _opened(path)
    except OSError as error:
        raise RigLockError(
            f"{path}, the folder of rig locks, cannot be used ({error.strerror or error}); "
            "have it given back to you, writable, or removed"
        ) from error


def _opened(path: Path) -> LockFolder:
    """Return the folder at `path`, private to this user; raises OSError where it is not this user's own."""
    path.parent.parent.mkdir(parents=True, exist_ok=True)
    handles = []
    try:
        for folder in (path.parent, path):
            with contextlib.suppress(FileExistsError):
                folder.mkdir(mode=0o700)
            handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            handles.append(handle)
            status = os.fstat(handle)
            if status.st_uid != os.getuid():
                raise PermissionError(f"{folder} belongs to {user_name(status.st_uid)}")
            if stat.S_IMODE(status.st_mode) != 0o700:
                os.fchmod(handle, 0o700)
        # systemd-tmpfiles leaves a locked folder alone, however old its files are.
        fcntl.flock(handles[-1], fcntl.LOCK_SH | fcntl.LOCK_NB)
        return LockFolder(path, handles.pop())
    finally:
        for handle in handles:
            os.close(handle)


def _why_untrusted(status: os.stat_result) -> str | None:
    """Return why a base is not this user's own, or None."""
    if not stat.S_ISDIR(status.st_mode):
        return "is not a folder"
    if status.st_uid != os.getuid():
        return f"belongs to {user_name(status.st_uid)}"
    if status.st_mode & stat.S_IWOTH:
        return f"every user may write to (mode {stat.S_IMODE(status.st_mode):04o})"
    return None


def user_name(uid: int) -> str:
    """Return the name of a user, or its number where it has none."""
    try:
        return f"user {pwd.getpwuid(uid).pw_name}"
    except KeyError:
        return f"user {uid}"
