"""Folder of a run: `runs/<utc>-<profile>/` with journal, record, review, twin, report and `run.json`."""

from __future__ import annotations

import contextlib
import datetime
import fcntl
import json
import os
import platform
import shlex
import shutil
import sys
import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

from drivers.rig_file import file_sha256
from hil import __version__
from hil.files import (
    ENDINGS,
    LONGEST_DATABASE_PATH,
    longest_name,
    read_json,
    replacing,
    require_plain,
    safe_file_name,
    take_lock,
)
from hil.run_folder.manifest_check import checked_manifest
from hil.run_folder.room import RunSize

LIBRARIES = ("pymodbus", "python-can", "cantools", "numpy", "scipy", "llvmlite", "pyarrow", "rerun-sdk")
LIVE_REVIEW_S = 180.0
"""Age that the review of a run may have against its journal, s: the last rows of a run follow its last tick."""


class RunFolderError(Exception):
    """Run folder that cannot be made or read; the message states the remedy."""


class FolderLostError(RunFolderError):
    """Folder of a run that was deleted, or cannot be written any more; the message states the rest of the run."""


def _damaged(sentence: str) -> RunFolderError:
    return RunFolderError(f"{sentence}; the journal beside it still holds the run")


@dataclass(frozen=True, slots=True)
class RunFolder:
    """Paths of one run, and the lock on its folder."""

    path: Path
    _held: list[int] = field(default_factory=list, compare=False, repr=False)
    """Open directory while this process holds the folder: it stays valid after somebody moved the folder."""

    @property
    def journal(self) -> Path:
        """SQLite journal, the source of all derived files."""
        return self.path / "journal.sqlite"

    @property
    def record(self) -> Path:
        """Parquet record derived from the journal."""
        return self.path / "record.parquet"

    @property
    def review(self) -> Path:
        """Rerun recording derived from the journal."""
        return self.path / "review.rrd"

    @property
    def twin(self) -> Path:
        """Twin file with which the run began."""
        return self.path / "twin.toml"

    @property
    def report(self) -> Path:
        """HTML report."""
        return self.path / "report.html"

    @property
    def notes(self) -> Path:
        """Notes on the run, and changes of its labels, a line of JSON each."""
        return self.path / "notes.jsonl"

    @property
    def alarms(self) -> Path:
        """Acts of operators on alarms, a line of JSON each."""
        return self.path / "alarms.jsonl"

    @property
    def verdict(self) -> Path:
        """Results of test plans on the run, where it was judged."""
        return self.path / "verdict.json"

    @property
    def junit(self) -> Path:
        """The same as JUnit XML, for other programs."""
        return self.path / "junit.xml"

    @property
    def diagnosis(self) -> Path:
        """Folder with the diagnosis of the run, where there is one."""
        return self.path / "diagnosis"

    @property
    def control(self) -> Path:
        """Socket on which a live run listens to `hil ctl`."""
        return self.path / "control.sock"

    @property
    def manifest(self) -> Path:
        """Identity, hashes, versions and exit status."""
        return self.path / "run.json"

    def read_manifest(self) -> dict[str, Any]:
        """Return `run.json`, checked; raises RunFolderError for another folder, or one with links to the outside."""
        try:
            self.manifest.lstat()  # before the folder is searched: it may be anybody's home
            require_plain(self.path, RunFolderError)
            document = read_json(self.manifest, _damaged)
        except FileNotFoundError:
            raise RunFolderError(f"{self.path} is not a run folder (no run.json); give one of runs/*") from None
        except OSError as error:
            raise RunFolderError(f"{self.manifest} cannot be read ({error.strerror}); give one of runs/*") from None
        return checked_manifest(document, self.manifest, RunFolderError)

    def is_current(self, made: Path, within_s: float = 0.0) -> bool:
        """Return True for a derived file that exists and is at most `within_s` seconds older than the last row."""
        log = self.journal.with_name(f"{self.journal.name}-wal")
        try:
            newest = max(path.stat().st_mtime for path in (self.journal, log) if path.is_file())
            return made.stat().st_mtime >= newest - within_s
        except (OSError, ValueError):
            return made.is_file()

    def is_review_current(self, *, finished: bool) -> bool:
        """Return True for a review that shows the whole journal and the diagnosis of the run.

        `finished` states that `run.json` has the end of the run: the process that writes the review live closes it
        before the journal gets its last rows, about that end.
        """
        curves = self.diagnosis / "diagnosis.parquet"
        try:
            is_older = curves.is_file() and curves.stat().st_mtime > self.review.stat().st_mtime
        except OSError:
            return False
        return not is_older and self.is_current(self.review, LIVE_REVIEW_S if finished else 0.0)

    @property
    def was_cut(self) -> bool:
        """True for an interrupted run, which has not ended and is not live: it was killed, or the power failed."""
        try:
            return self.read_manifest()["exit_status"] == "running" and not self.is_held
        except (RunFolderError, KeyError):
            return False

    @property
    def is_held(self) -> bool | None:
        """True if a process holds the folder for its run; None where the file system has no locks, or it is gone.

        The question is a shared lock of a moment: any number of readers may ask, and `owned` waits for it.
        """
        try:
            handle = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY)
        except OSError:
            return None
        try:
            fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            return None
        finally:
            os.close(handle)
        return False

    @contextlib.contextmanager
    def owned(self) -> Iterator[None]:
        """Lock the folder for the run of this process; raises RunFolderError where another process holds it.

        The kernel releases the lock at the end of the process. A file system without locks is accepted.
        """
        handle = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY)
        try:
            try:
                take_lock(handle)
            except BlockingIOError:
                raise RunFolderError(self._why_held()) from None
            except OSError:
                pass
            self._held.append(handle)
            yield
        finally:
            if handle in self._held:
                self._held.remove(handle)
            os.close(handle)

    def _why_held(self) -> str:
        """Return the sentence on a folder that another process holds: a live run, or a command on an ended one."""
        with contextlib.suppress(RunFolderError, OSError):
            if self.read_manifest().get("exit_status") != "running":
                return f"{self.path}: another process makes the files of this run; wait until it has ended"
        asked = f"ask it with `hil ctl status {shlex.quote(str(self.path))}`"
        return f"{self.path} is a run that still goes on; {asked}"

    def located(self) -> RunFolder:
        """Return the folder at its present path, which differs if somebody moved it while it was locked.

        Raises
        ------
        FolderLostError
            The folder was deleted.
        """
        if not self._held:
            if self.path.is_dir():
                return self
            raise FolderLostError(f"{self.path} is gone; it was deleted or moved")
        held = os.fstat(self._held[-1])
        for path in (self.path, Path(os.readlink(f"/proc/self/fd/{self._held[-1]}"))):
            with contextlib.suppress(OSError):
                if os.path.samestat(path.stat(), held):
                    return self if path == self.path else RunFolder(path, self._held)
        raise FolderLostError(f"{self.path} was deleted")

    def copy_twin(self, files: Sequence[Path]) -> None:
        """Copy the twin file of a run, and then its earlier revisions, newest first.

        A healthy record may belong to one of these.
        """
        for age, file in enumerate(files):
            shutil.copyfile(file, self.path / f"twin.before-{age}.toml" if age else self.twin)

    def write_manifest(self, document: dict[str, Any]) -> None:
        """Write `run.json` atomically; raises OSError."""
        with replacing(self.manifest) as temporary:
            temporary.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def create_run_folder(parent: Path, profile_name: str, size: RunSize) -> RunFolder:
    """Make a new, empty run folder under `parent`, named by time and profile, and return it.

    Runs that begin in the same second get folders of their own. Characters of `profile_name` that a terminal or a
    library would refuse are replaced in the folder's name, and a long name is cut.

    Raises
    ------
    RunFolderError
        `parent` is no folder or takes no new one, its path is too long for a journal, or its disk has no room for a
        run of this `size`.
    """
    try:
        parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        why = "it is there, but is no folder" if isinstance(error, FileExistsError) else error.strerror
        raise RunFolderError(f"{parent} cannot be made ({why}); choose another folder with --runs") from error
    stamp = datetime.datetime.now(datetime.UTC).strftime("%Y%m%dT%H%M%SZ")
    room = LONGEST_DATABASE_PATH - len(os.fsencode(parent.resolve() / f"{stamp}--99/journal.sqlite"))
    if room < 1:
        raise RunFolderError(
            f"{parent} is too long: SQLite takes {LONGEST_DATABASE_PATH} bytes for the path of a journal; "
            "choose a shorter folder with --runs"
        )
    path = _made(
        parent, f"{stamp}-{safe_file_name(profile_name, min(longest_name(parent) - len(stamp) - ENDINGS, room))}"
    )
    try:
        _require(path, size.bytes_needed, "use --runs")
    except RunFolderError:
        path.rmdir()
        raise
    return RunFolder(path)


def _made(parent: Path, name: str) -> Path:
    """Make and return a folder of this name, with a number after it where the name is taken."""
    for suffix in ("", *(f"-{n}" for n in range(2, 100))):
        path = parent / f"{name}{suffix}"
        try:
            path.mkdir()
            return path
        except FileExistsError:
            continue
        except OSError as error:
            raise RunFolderError(
                f"{path} cannot be made ({error.strerror}); choose another folder with --runs"
            ) from error
    raise RunFolderError(f"{parent / name} and 98 more are there already; choose another folder with --runs")


def require_room(folder: RunFolder, size: RunSize) -> None:
    """Check that the disk has room for the rest of a run of this `size`; raises RunFolderError.

    The journal grows on; all other files are made anew, and replace the old ones when they are complete.
    """
    held = folder.journal.stat().st_size if folder.journal.is_file() else 0
    _require(folder.path, max(size.bytes_needed - held, 0), "move the run's folder to another disk")


def _require(path: Path, needed: int, otherwise: str) -> None:
    free = shutil.disk_usage(path).free
    if free < needed:
        raise RunFolderError(
            f"{path.parent} has {free / 1e6:.0f} MB free, this run may need {needed / 1e6:.0f} MB; "
            f"free some or {otherwise}"
        )


def new_manifest(files: dict[str, Path | None], **settings: Any) -> dict[str, Any]:
    """Return the manifest of a run at its begin: identity, versions, host, hash of every file that it depends on."""
    return {
        "uid": str(uuid.uuid4()),
        "started": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "ended": None,
        "exit_status": "running",
        "reason": "",
        "host": platform.node(),
        "versions": {
            "hil": __version__,
            "python": sys.version.split()[0],
            **{name: metadata.version(name) for name in LIBRARIES},
        },
        "files": {
            name: {"path": str(path.absolute()), "sha256": file_sha256(path)}
            for name, path in files.items()
            if path is not None
        },
        "settings": settings,
        "segments": [],
    }
