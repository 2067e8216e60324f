"""Conditions of a measurement: the manifest, CPU time, memory."""

from __future__ import annotations

import datetime
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from hil import __version__
from hil.bench.measure.measured_code import CodeState, commit_of, places_of

LIBRARIES = (
    "numpy",
    "scipy",
    "numba",
    "llvmlite",
    "torch",
    "jax",
    "numpyro",
    "pyswarms",
    "pymoo",
    "cma",
    "filterpy",
)
LEAST_CALL_S = 2e-3
"""Least duration of a measurement, s: shorter calls are repeated until they last this long, and divided."""


def manifest(command: str, seed: int, result: str = "", code: CodeState | None = None) -> dict[str, Any]:
    """Return the conditions of a measurement: command, seed, date, code, versions, machine and load.

    Parameters
    ----------
    command
        Command as typed.
    seed
        Seed of all random numbers.
    result
        Name of the result, by which the check of results knows its code.
    code
        State of the code when the measurement began; None for the present commit without digests.
    """
    versions = {"hil": __version__, "python": sys.version.split()[0]}
    for name in LIBRARIES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    places = places_of(result) or ()
    return {
        "command": command,
        **({"result": result} if result else {}),
        "seed": seed,
        "date": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "commit": commit_of() if code is None else code.commit,
        **(
            {}
            if code is None
            else {"digests": {place: code.digests[place] for place in places if place in code.digests}}
        ),
        "versions": versions,
        "machine": {"cpu": cpu_model(), "cores": os.cpu_count(), "system": f"{platform.system()} {platform.machine()}"},
        "load_average": [round(x, 2) for x in os.getloadavg()],
    }


def cpu_model() -> str:
    """Return the marketing name of the processor, with its widest vectors if known."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    facts = dict(_pair(line) for line in lines)
    vectors = [name for name in ("avx512f", "avx2") if name in facts.get("flags", "").split()]
    model = facts.get("model name", platform.machine())
    return f"{model} (family {facts.get('cpu family', '?')}{', ' + vectors[0] if vectors else ''})"


def _pair(line: str) -> tuple[str, str]:
    key, _, value = line.partition(":")
    return key.strip(), value.strip()


def cpu_s(function: Callable[[], object], *, repeats: int = 7, budget_s: float = 2.0, warm: bool = True) -> float:
    """Return the median CPU seconds (all threads of this process) of one call.

    The first call is not counted where `warm`. At least three repeats unless one alone spends `budget_s`.
    """
    if warm:
        function()
    began = time.process_time()
    function()
    once = time.process_time() - began
    inner = max(1, round(LEAST_CALL_S / max(once, 1e-7)))
    found: list[float] = [once] if once > budget_s else []
    spent = once
    while not found or (len(found) < repeats and spent < budget_s) or (len(found) < 3 and once <= budget_s / 2):
        began = time.process_time()
        for _ in range(inner):
            function()
        took = time.process_time() - began
        found.append(took / inner)
        spent += took
    return statistics.median(found)


def in_new_process(code: str, environment: dict[str, str] | None = None) -> list[float]:
    """Return the numbers that a Python program prints on its last line; raise RuntimeError with its last words."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env={**os.environ, **(environment or {})},
        cwd=Path(__file__).resolve().parents[3],
    )
    if done.returncode != 0:
        raise RuntimeError(done.stderr.strip().splitlines()[-1] if done.stderr.strip() else "ended without a word")
    return [float(word) for word in done.stdout.strip().splitlines()[-1].split()]


def median(values: Sequence[float]) -> float:
    """Return the median; NaN of an empty list."""
    return statistics.median(values) if values else float("nan")
