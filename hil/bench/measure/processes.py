"""Data of other processes from Linux (`/proc`), empty for a process that has gone."""

from __future__ import annotations

import contextlib
from pathlib import Path

MARKER = "HIL_BENCH_CASE"
"""Variable of the environment by which the processes of a case are found, whatever started them."""


def children(pid: int) -> list[int]:
    """Return the processes that any of its threads has started."""
    found: list[int] = []
    with contextlib.suppress(OSError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            with contextlib.suppress(OSError):  # The thread has just ended.
                found += map(int, (task / "children").read_text().split())
    return found


def marked(marker: str) -> list[int]:
    """Return the processes whose environment has `marker` as variable `MARKER`, without ended ones."""
    word = f"{MARKER}={marker}".encode()
    found = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        with contextlib.suppress(OSError):
            if word in (entry / "environ").read_bytes() and not _is_zombie(entry):
                found.append(int(entry.name))
    return found


def _is_zombie(entry: Path) -> bool:
    return (entry / "stat").read_bytes().rpartition(b")")[2].split()[0] == b"Z"


def command(pid: int) -> bytes:
    """Return its command line, words ended by zero bytes."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def descriptors(pid: int) -> list[int]:
    """Return its open descriptors; an empty list if it has gone."""
    try:
        return [int(entry.name) for entry in Path(f"/proc/{pid}/fd").iterdir()]
    except OSError:
        return []


def address_space_bytes(pid: int) -> int:
    """Return the size of its address space; 0 if it has gone."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) << 10 for line in lines if line.startswith("VmSize")), 0)


def resident_MB(pid: int) -> float:
    """Return the resident memory, MB (2^20 bytes)."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines()
    except OSError:
        return 0.0
    return next((float(line.split()[1]) / 1024.0 for line in lines if line.startswith("VmRSS")), 0.0)


def ran_s(pid: int) -> float:
    """Return the processor time of its threads that live, s; 0 if the kernel does not report it."""
    total = 0
    with contextlib.suppress(OSError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            with contextlib.suppress(OSError, IndexError, ValueError):  # the thread has just ended
                total += int((task / "schedstat").read_text().split()[0])
    return total * 1e-9


def waited_s(pid: int) -> float:
    """Return the time for which the main thread was ready to run and did not, s; 0 if the kernel does not report it."""
    try:
        return int(Path(f"/proc/{pid}/schedstat").read_text().split()[1]) * 1e-9
    except (OSError, IndexError, ValueError):
        return 0.0


def is_stopped(pid: int) -> bool:
    """Return True if a process stands still by SIGSTOP, or has ended and not been waited for."""
    try:
        return Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[0] in (b"T", b"Z", b"X")
    except OSError:
        return True
