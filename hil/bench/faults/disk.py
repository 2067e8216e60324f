"""Disk for one case, which can be filled: a tmpfs in a mount namespace of its holder.

Where the system does not let us have one, the harness's files may not grow instead (RLIMIT_FSIZE).
"""

from __future__ import annotations

import contextlib
import os
import resource
import subprocess
import time
from pathlib import Path

SIZE_MB = 64
_START_S = 5.0


class OwnDisk:
    """Disk of one case: `inside` is its path for the harness, `path` the same path from outside."""

    def __init__(self, inside: Path) -> None:
        inside.mkdir()
        self.inside = inside
        self.path = inside
        self._holder = self._mount(inside)
        if self._holder is not None:
            self.path = Path(f"/proc/{self._holder.pid}/root{inside}")

    @property
    def real(self) -> bool:
        """Return True if it is a file system of its own."""
        return self._holder is not None

    def _mount(self, inside: Path) -> subprocess.Popen[bytes] | None:
        mount = 'mount -t tmpfs -o size="$1"m none "$2" && echo mounted && exec sleep 600'
        try:
            holder = subprocess.Popen(
                ["unshare", "-U", "-r", "-m", "sh", "-c", mount, "sh", str(SIZE_MB), str(inside)],
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
        except OSError:
            return None
        assert holder.stdout is not None
        if holder.stdout.readline() == b"mounted\n":
            return holder
        holder.wait(_START_S)
        holder.stdout.close()
        return None

    def command(self, command: list[str]) -> list[str]:
        """Return the command that runs `command` with access to the disk."""
        if self._holder is None:
            return command
        return ["nsenter", "-t", str(self._holder.pid), "-U", "-m", "--preserve-credentials", "--", *command]

    def fill(self, pid: int) -> None:
        """Fill the disk; `pid` is the process that writes there."""
        if self._holder is None:
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (4096, resource.RLIM_INFINITY))
            return
        with contextlib.suppress(OSError), (self.path / "ballast").open("ab", buffering=0) as ballast:
            deadline = time.monotonic() + _START_S
            while time.monotonic() < deadline:
                size = 1 << 20
                while size:
                    try:
                        ballast.write(bytes(size))
                    except OSError:
                        size //= 2
                break

    def clear(self) -> None:
        """Free the disk."""
        with contextlib.suppress(OSError):
            (self.path / "ballast").unlink()

    def copied(self, journal: Path, to: Path) -> Path:
        """Copy the present journal: SQLite would resolve the path to another namespace in our own.

        The database before its log: a short run never folds the one into the other before it ends.
        """
        to.mkdir(exist_ok=True)
        for name in (journal.name, f"{journal.name}-wal"):
            try:
                (to / name).write_bytes(journal.with_name(name).read_bytes())
            except OSError:
                (to / name).unlink(missing_ok=True)
        return to / journal.name

    def close(self) -> None:
        """Release the disk."""
        if self._holder is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._holder.pid, 9)
            self._holder.wait()
            assert self._holder.stdout is not None
            self._holder.stdout.close()
            self._holder = None
