"""Folder of a fleet: one result, one log and the files of each job.

A job is finished when its result file is there. That file is written last, whole, and never over another one, so that a
job has one result however often the command or a worker was killed.
"""

from __future__ import annotations

import contextlib
import datetime
import errno
import json
import os
import shutil
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from hil import __version__
from hil.files import held, plain, read_json, replacing
from hil.fleet.fleet_file import Fleet, FleetError

ABOUT = "fleet.json"
RESULTS, LOGS, FILES = "jobs", "logs", "files"
CANCEL = "cancel"
TABLE, TABLE_CSV = "results.parquet", "results.csv"


class FleetFolderError(RuntimeError):
    """Error of a folder that cannot be written; the message is one plain sentence."""


class FleetFolder:
    """Folder of a fleet at `path`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()

    @contextlib.contextmanager
    def held(self, fleet: Fleet) -> Iterator[None]:
        """Hold the folder for this process, and make it that of the fleet if it is new.

        Raises
        ------
        FleetError
            It is the folder of another fleet file, it has other content, or another process works on it.
        FleetFolderError
            It cannot be written.
        """
        with contextlib.ExitStack() as stack:
            try:
                stack.enter_context(held(self.path, FleetError))
                self._claim(fleet)
            except OSError as error:
                raise unwritable(self.path, error) from None
            yield

    def _claim(self, fleet: Fleet) -> None:
        about = {"id": fleet.id, "title": fleet.title, "file": str(fleet.path), "sha256": fleet.sha256}
        if (known := self.about()) is not None:
            if known["id"] != fleet.id:
                raise FleetError(
                    f"{self.path} is the folder of the fleet {plain(str(known['id']), 80)!r}, and {fleet.path} is "
                    f"{fleet.id!r}; give another folder with --out"
                )
        elif any(self.path.iterdir()):
            raise FleetError(f"{self.path} has files and is no folder of a fleet; give another folder with --out")
        for name in (RESULTS, LOGS, FILES):
            (self.path / name).mkdir(exist_ok=True)
        for left in (*(self.path / RESULTS).glob(".*.part"), *(self.path / FILES).glob(".*.part")):
            shutil.rmtree(left) if left.is_dir() else left.unlink()
        (self.path / CANCEL).unlink(missing_ok=True)
        with replacing(self.path / ABOUT) as unfinished:
            unfinished.write_text(json.dumps({**about, "hil": __version__}, indent=1) + "\n", encoding="utf-8")

    def about(self) -> dict[str, Any] | None:
        """Return `fleet.json`, None where there is none; raises FleetError where it is damaged."""
        try:
            found = read_json(self.path / ABOUT, FleetError)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise FleetError(f"{self.path / ABOUT} cannot be read ({error.strerror}); correct it") from None
        if not isinstance(found, dict) or not isinstance(found.get("id"), str):
            raise FleetError(f"{self.path / ABOUT} is damaged; give another folder with --out")
        return found

    def is_held(self) -> bool:
        """Return True while a process works on the folder; raises OSError."""
        try:
            with held(self.path, FleetError):
                return False
        except FleetError:
            return True

    def ask_to_cancel(self) -> None:
        """Ask the process that works on the folder to stop; raises OSError."""
        (self.path / CANCEL).touch()

    @property
    def is_cancelled(self) -> bool:
        """True once somebody has asked to stop."""
        return (self.path / CANCEL).exists()

    def result(self, job: str) -> dict[str, Any] | None:
        """Return the result of a job, None for one that is not finished; raises FleetError for a damaged file."""
        path = self._result(job)
        try:
            found = read_json(path, FleetError)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise FleetError(f"{path} cannot be read ({error.strerror}); take it away") from None
        if not isinstance(found, dict) or found.get("status") not in ("done", "failed") or "row" not in found:
            raise FleetError(f"{path} is damaged; take it away, and the job runs again")
        return found

    def write_result(self, job: str, document: Mapping[str, Any], files: Mapping[str, bytes]) -> bool:
        """Write the files of a job and then its result; return False, and write nothing, where there is one.

        Raises
        ------
        FleetFolderError
            They cannot be written.
        """
        target = self._result(job)
        if target.exists():
            return False
        try:
            if files:
                self._write_files(job, files)
            unfinished = target.with_name(f".{job}.part")
            with unfinished.open("w", encoding="utf-8") as handle:
                json.dump(document, handle, indent=1)
                handle.write("\n")
                handle.flush()
                os.fsync(handle.fileno())
            try:
                os.link(unfinished, target)  # refuses to replace a result
            except FileExistsError:
                return False
            finally:
                unfinished.unlink()
        except OSError as error:
            raise unwritable(target, error) from None
        return True

    def _write_files(self, job: str, files: Mapping[str, bytes]) -> None:
        part, target = self.path / FILES / f".{job}.part", self.path / FILES / job
        shutil.rmtree(part, ignore_errors=True)
        for name, content in files.items():
            path = part / name
            if not path.resolve().is_relative_to(part.resolve()):
                raise FleetFolderError(f"a worker returned a file {plain(name, 80)!r} outside of its folder; not used")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        shutil.rmtree(target, ignore_errors=True)  # of an attempt that was killed before its result was written
        part.rename(target)

    def forget(self, job: str) -> None:
        """Remove the result of a job, so that it runs again; raises FleetFolderError."""
        try:
            self._result(job).unlink(missing_ok=True)
        except OSError as error:
            raise unwritable(self._result(job), error) from None

    def log(self, job: str, text: str) -> None:
        """Append a line to the log of a job; any thread may call it. Raises FleetFolderError."""
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
        path = self.path / LOGS / f"{job}.log"
        try:
            with self._lock, path.open("a", encoding="utf-8") as file:
                file.writelines(f"{now} {plain(line)}\n" for line in text.splitlines() or [""])
        except OSError as error:
            raise unwritable(path, error) from None

    def _result(self, job: str) -> Path:
        return self.path / RESULTS / f"{job}.json"


def unwritable(path: Path, error: OSError) -> FleetFolderError:
    """Return the error of a file of the folder that cannot be written, with the remedy."""
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    remedy = "make room, and give the same command again" if full else "make it writable, or give another --out"
    return FleetFolderError(f"{path} cannot be written ({error.strerror}); {remedy}")
