"""Compiler and caller of the C reference, with the system's compiler."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hil.bench.kernel import Job
from hil.bench.peers import Absent
from hil.bench.peers.c_source import C_INPUTS, C_PARAMETERS, C_SOURCE
from twin import Array

# The options of -ffast-math without that flag: linked with it, a library disables denormal numbers for the whole
# process that loads it.
FAST_MATH = (
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fno-signed-zeros",
    "-fassociative-math",
    "-freciprocal-math",
    "-ffinite-math-only",
    "-ffp-contract=fast",
)
FLAGS = ("-O3", "-march=native", *FAST_MATH, "-std=gnu11", "-shared", "-fPIC", "-Wno-psabi")


@functools.cache
def library(lanes: int, order: int) -> Any:
    """Return the compiled reference; raise Absent without a compiler."""
    compiler = os.environ.get("CC") or shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        raise Absent("plain C: no compiler here")
    width = min(lanes, 8)
    with tempfile.TemporaryDirectory(prefix="hil-bench-") as folder:
        source, target = Path(folder) / "loop.c", Path(folder) / "loop.so"
        source.write_text(C_SOURCE, encoding="utf-8")
        defines = (f"-DLANES={lanes}", f"-DWIDTH={width}", f"-DORDER={order}")
        done = subprocess.run(
            [compiler, *FLAGS, *defines, str(source), "-o", str(target), "-lm"], capture_output=True, text=True
        )
        if done.returncode != 0:
            words = (done.stderr.strip() or "no message").splitlines()[0]
            raise Absent(f"plain C: {compiler} failed: {words}")
        return ctypes.CDLL(str(target))


def prepared(job: Job, lanes: int, order: int) -> tuple[Callable[[], Array], Callable[[], Array]]:
    """Return two calls: costs (P,) of all particles, and states (n, 4) of particle 0."""
    network = job.network
    with contextlib.suppress(ValueError):
        network.index(C_PARAMETERS)
    if network.nodes != ("heater", "modules", "radiator", "tank") or network.input_columns != C_INPUTS:
        raise Absent("plain C: only written for the four-volume loop")
    function = library(lanes, order).cost
    particles = np.ascontiguousarray(job.particles[:, network.index(C_PARAMETERS)])
    n, count = len(job.time), len(particles)
    state, inputs = np.ascontiguousarray(job.state), np.ascontiguousarray(job.inputs)
    measured, weight = np.ascontiguousarray(job.measured), np.ascontiguousarray(job.weight)

    def call(rows: Array, states: Array | None) -> Array:
        total = np.empty(len(rows))
        function(
            _at(rows),
            ctypes.c_long(len(rows)),
            _at(state),
            _at(inputs),
            _at(measured),
            _at(weight),
            ctypes.c_long(n),
            _at(total),
            None if states is None else _at(states),
        )
        return total

    def trace() -> Array:
        states = np.empty((n, 4))
        call(particles[:1], states)
        return states

    assert count > 0
    return (lambda: call(particles, None)), trace


def _at(array: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)
