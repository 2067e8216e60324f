"""Compiled simulation of one network: build once, cache on disk, call with arrays.

Generated source is written to the user's cache folder and compiled by numba there, so that a second process
loads machine code in a fraction of a second. Writers hold a file lock and replace files atomically.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import hashlib
import importlib.util
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from twin.codegen import LANES, Mode, kernel_source
from twin.network import Array, Network, TwinFileError


@dataclass(frozen=True)
class GaussNewton:
    """What one linearisation yields, for q varied quantities and m sensors.

    Attributes:
        jtj: (q, q) of the noise-weighted residuals.
        jtr: (q,) gradient of half the cost.
        sse: (m,) weighted squared residuals at the centre, per sensor.
        end: (k,) state at the last sample, at the centre.
    """

    jtj: Array
    jtr: Array
    sse: Array
    end: Array


class Kernel:
    """The simulation of one network with `lane_ids` free to differ between particles.

    Parameter vectors are always full ones, (p,) or (P, p) in the order of ``network.ids``; columns outside
    `lane_ids` must be the same for all particles of a call.

    Arrays: time (n,) s, not decreasing; inputs (n, c); measured (n, m) degC with NaN where masked; state (k,)
    or (P, k) degC at the first sample. Inputs hold from a sample to the next; NaN in an input holds the last
    good value (the network's nominal before the first).
    """

    def __init__(self, network: Network, lane_ids: tuple[str, ...] | None = None) -> None:
        self.network = network
        self.lane_ids = network.ids if lane_ids is None else tuple(dict.fromkeys(lane_ids))
        self.lane = network.index(self.lane_ids)
        self._variants: dict[Mode, Callable[..., None]] = {}

    def _variant(self, mode: Mode) -> Callable[..., None]:
        if mode not in self._variants:
            self._variants[mode] = compiled(kernel_source(self.network, mode, self.lane_ids))
        return self._variants[mode]

    def cost(
        self, parameters: Array, state: Array, time: Array, inputs: Array, measured: Array, weight: Array
    ) -> tuple[Array, Array]:
        """Sum of squared weighted residuals per particle and sensor (P, m), and end states (P, k).

        Args:
            measured, weight: (n, m); entries of weight 0 are ignored (`masked` makes both).
        """
        lanes, start, count = self._blocks(parameters, state)
        blocks, k, m = start.shape[0], len(self.network.nodes), len(self.network.sensors)
        sse, end = np.empty((blocks, m, LANES)), np.empty((blocks, k, LANES))
        self._variant("cost")(self._base(parameters), lanes, start, time, inputs, measured, weight, sse, end)
        return _particles(sse, count), _particles(end, count)

    def trace(self, parameters: Array, state: Array, time: Array, inputs: Array) -> tuple[Array, Array]:
        """Readings (P, n, m) at every sample, and end states (P, k)."""
        lanes, start, count = self._blocks(parameters, state)
        blocks, k, m = start.shape[0], len(self.network.nodes), len(self.network.sensors)
        readings, end = np.empty((blocks, time.size, m, LANES)), np.empty((blocks, k, LANES))
        self._variant("trace")(self._base(parameters), lanes, start, time, inputs, readings, end)
        return np.moveaxis(readings, 3, 1).reshape(-1, time.size, m)[:count], _particles(end, count)

    def linearise(
        self,
        parameters: Array,
        state: Array,
        steps: Array,
        time: Array,
        inputs: Array,
        measured: Array,
        weight: Array,
    ) -> GaussNewton:
        """Normal equations by forward differences across lanes: row 0 is the centre, row a differs by steps[a - 1].

        Args:
            parameters: (1 + q, p). state: (1 + q, k). steps: (q,), the size of each row's difference.
            measured, weight: (n, m) as `cost`. q is at most LANES - 1.
        """
        lanes, start, count = self._blocks(parameters, state)
        if count > LANES:
            raise ValueError(f"at most {LANES - 1} quantities can be varied at once, got {count - 1}")
        k, m = len(self.network.nodes), len(self.network.sensors)
        gram, sse, end = np.empty((1, LANES, LANES)), np.zeros((1, m)), np.empty((1, k, LANES))
        self._variant("gram")(
            self._base(parameters), lanes, start, time, inputs, measured, weight, count, gram, sse, end
        )
        inner = gram[0, 1:count, 1:count] / np.outer(steps, steps)
        return GaussNewton(inner, gram[0, 0, 1:count] / steps, sse[0], end[0, :, 0].copy())

    def _base(self, parameters: Array) -> Array:
        return np.array(np.atleast_2d(parameters)[0])

    def _blocks(self, parameters: Array, state: Array) -> tuple[Array, Array, int]:
        """Particles laid out in blocks of lanes; a last partial block repeats its final particle."""
        parameters, state = np.atleast_2d(parameters), np.atleast_2d(state)
        count = max(parameters.shape[0], state.shape[0])
        lanes = _laid_out(parameters[:, self.lane], count)
        start = _laid_out(state, count)
        if not (np.isfinite(lanes).all() and np.isfinite(start).all()):
            raise ValueError("parameters and initial states must be finite")
        return lanes, start, count


def simulate(
    network: Network, time: ArrayLike, inputs: ArrayLike, state: ArrayLike, parameters: ArrayLike | None = None
) -> Array:
    """Free-running readings (n, m) in degC of a network from an initial state.

    Args:
        time: (n,) s. inputs: (n, c) in the order of ``network.input_columns``. state: (k,) degC.
        parameters: full vector (p,), the network's own by default.
    """
    values = network.values if parameters is None else np.asarray(parameters, dtype=np.float64)
    t, u = clean_time(time), held(network, inputs)
    return Kernel(network, ()).trace(values, np.asarray(state, dtype=np.float64), t, u)[0][0]


def held(network: Network, inputs: ArrayLike, last: Array | None = None) -> Array:
    """Inputs (n, c) with NaN replaced by the last good value; before the first, by `last` or the nominal."""
    u = np.ascontiguousarray(np.atleast_2d(np.asarray(inputs, dtype=np.float64)))
    if u.shape[1] != len(network.inputs):
        raise TwinFileError(f"expected {len(network.inputs)} input columns, got {u.shape[1]}")
    good = np.isfinite(u)
    if good.all():
        return u
    before = network.nominal_inputs if last is None else last
    filled = np.vstack([before, np.where(good, u, 0.0)])
    row = np.where(good, np.arange(1, len(u) + 1)[:, None], 0)
    latest = np.maximum.accumulate(row, axis=0)
    return np.ascontiguousarray(np.take_along_axis(filled, latest, axis=0))


def clean_time(time: ArrayLike) -> Array:
    """Time (n,) as contiguous floats.

    Raises:
        TwinFileError: not finite, or going back.
    """
    t = np.ascontiguousarray(np.asarray(time, dtype=np.float64).ravel())
    if not np.isfinite(t).all() or (np.diff(t) < 0.0).any():
        raise TwinFileError("time must be finite and must not go back; sort the record or drop those rows")
    return t


def masked(measured: ArrayLike, sigma: Array | float = 1.0) -> tuple[Array, Array]:
    """Measurements with NaN replaced by 0, and weights 1/sigma with 0 where there was NaN; both (n, m)."""
    y = np.atleast_2d(np.asarray(measured, dtype=np.float64))
    good = np.isfinite(y)
    weight = np.where(good, 1.0 / np.broadcast_to(np.asarray(sigma, dtype=np.float64), y.shape), 0.0)
    return np.ascontiguousarray(np.where(good, y, 0.0)), np.ascontiguousarray(weight)


def _laid_out(rows: Array, count: int) -> Array:
    """(P or 1, q) -> (blocks, q, LANES)."""
    blocks = -(-count // LANES)
    if rows.shape[0] == 1:
        laid: Array = np.repeat(rows[0][None, :], blocks * LANES, axis=0).reshape(blocks, LANES, -1)
        return np.array(laid.transpose(0, 2, 1), order="C")
    take = np.minimum(np.arange(blocks * LANES), count - 1).reshape(blocks, LANES)
    return np.array(rows[take].transpose(0, 2, 1), order="C")


def _particles(lanes: Array, count: int) -> Array:
    """(blocks, q, LANES) -> (P, q)."""
    return lanes.transpose(0, 2, 1).reshape(-1, lanes.shape[1])[:count]


@functools.lru_cache(maxsize=64)
def compiled(source: str) -> Callable[..., None]:
    """Machine code for a generated source, from the disk cache where possible.

    A cache that cannot be read is thrown away and rebuilt; without any writable folder the source is compiled
    in a temporary one.
    """
    import numba

    key = hashlib.sha256(f"{numba.__version__}\n{sys.version}\n{source}".encode()).hexdigest()[:24]
    root = _cache_root()
    if root is None:
        with tempfile.TemporaryDirectory(prefix="hil-twin-") as temporary:
            return _import(Path(temporary), key, source)
    folder = root / key
    with _locked(root / f"{key}.lock"):
        try:
            return _import(folder, key, source)
        except Exception:
            # Truncated or foreign cache files raise whatever unpickling raises; a rebuild tells a broken
            # cache from broken source.
            shutil.rmtree(folder, ignore_errors=True)
            return _import(folder, key, source)


def _import(folder: Path, key: str, source: str) -> Callable[..., None]:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"kernel_{key}.py"
    # numba compares the stamp of the source with that in its index, so an existing file stays untouched.
    if not path.exists() or path.read_text(encoding="utf-8") != source:
        with tempfile.NamedTemporaryFile("w", dir=folder, suffix=".tmp", delete=False, encoding="utf-8") as f:
            f.write(source)
        os.replace(f.name, path)
    spec = importlib.util.spec_from_file_location(f"hil_twin_kernel_{key}", path)
    if spec is None or spec.loader is None:
        raise ImportError(f"cannot import {path}")
    module: Any = importlib.util.module_from_spec(spec)
    # numba's cached code refers to its module by name while it is being loaded.
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    kernel: Callable[..., None] = module.kernel
    return kernel


def _cache_root() -> Path | None:
    """A folder of this user's own, or None. Nobody else may write there: numba executes what it finds."""
    base = os.environ.get("XDG_CACHE_HOME")
    candidates = [Path(base) / "hil-twin"] if base else []
    with contextlib.suppress(RuntimeError):
        candidates.append(Path.home() / ".cache" / "hil-twin")
    candidates.append(Path(tempfile.gettempdir()) / f"hil-twin-{os.getuid()}")
    for folder in candidates:
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            status = folder.stat()
        except OSError:
            continue
        private = status.st_uid == os.getuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
        if private and os.access(folder, os.W_OK):
            return folder
    return None


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    with path.open("w") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
