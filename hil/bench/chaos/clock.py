"""Wall clock for one process: a library loaded before libc shifts the time that the process reads.

The clock of the machine is never touched. Monotonic time stays as it is, as it does when a real wall clock is set.
"""

from __future__ import annotations

import mmap
import os
import shutil
import struct
import subprocess
from pathlib import Path

VARIABLE = "HIL_BENCH_CLOCK"
_SOURCE = r"""
#define _GNU_SOURCE
#include <fcntl.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static volatile long long *offset;

__attribute__((constructor)) static void begin(void) {
    const char *path = getenv("HIL_BENCH_CLOCK");
    int file = path ? open(path, O_RDONLY | O_CLOEXEC) : -1;
    if (file < 0) return;
    void *memory = mmap(0, sizeof *offset, PROT_READ, MAP_SHARED, file, 0);
    close(file);
    if (memory != MAP_FAILED) offset = memory;
}

int clock_gettime(clockid_t id, struct timespec *t) {
    int result = (int)syscall(SYS_clock_gettime, id, t);
    if (result == 0 && offset && (id == CLOCK_REALTIME || id == CLOCK_REALTIME_COARSE)) t->tv_sec += *offset;
    return result;
}

int gettimeofday(struct timeval *t, void *zone) {
    struct timespec now;
    (void)zone;
    if (clock_gettime(CLOCK_REALTIME, &now)) return -1;
    t->tv_sec = now.tv_sec;
    t->tv_usec = now.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *t) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (t) *t = now.tv_sec;
    return now.tv_sec;
}
"""


class NoCompilerError(RuntimeError):
    """Error of a missing C compiler for the library."""


def need_compiler() -> str:
    """Return the path of a C compiler; raise NoCompilerError."""
    found = shutil.which("gcc") or shutil.which("cc")
    if found is None:
        raise NoCompilerError("a wall clock for one process needs a C compiler, and none is installed; install gcc")
    return found


class SteppedClock:
    """Wall clock of one run, whose files are in `place`; `offset_s` is its lead over the machine's, whole s."""

    def __init__(self, place: Path) -> None:
        source, self._library, self._path = place / "clock.c", place / "clock.so", place / "clock.offset"
        source.write_text(_SOURCE, encoding="utf-8")
        command = [need_compiler(), "-O1", "-shared", "-fPIC", "-o", str(self._library), str(source)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise NoCompilerError(f"the library for a stepped clock was not compiled: {done.stderr.strip()[-300:]}")
        self._path.write_bytes(struct.pack("<q", 0))
        self.offset_s = 0

    @property
    def environment(self) -> dict[str, str]:
        """Return the variables of a process with this clock."""
        return {"LD_PRELOAD": str(self._library), VARIABLE: str(self._path)}

    def step(self, seconds: int) -> None:
        """Set the clock forward by this number of seconds, back if negative."""
        self.offset_s += seconds
        handle = os.open(self._path, os.O_RDWR)
        try:
            with mmap.mmap(handle, 8) as memory:
                memory[:8] = struct.pack("<q", self.offset_s)
        finally:
            os.close(handle)
