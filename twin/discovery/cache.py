"""Cache of results that take long to compute for a twin: beside its kernels, until twin or code change."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from twin.kernel import cache_folder
from twin.network import Array, Network
from twin.twinfile import dump


def store(name: str, found: object, network: Network, *data: Array) -> None:
    """Write a result about a network, and about `data` if it depends on some, as JSON; do nothing if there is no
    cache.
    """
    path = cached(name, network, *data)
    if path is None:
        return
    with contextlib.suppress(OSError):
        unfinished = path.with_suffix(f".{os.getpid()}")
        unfinished.write_text(json.dumps(found), encoding="utf-8")
        unfinished.replace(path)


def stored(name: str, network: Network, *data: Array) -> Any:
    """Return what `store` has written; None if nothing was written or the file cannot be read."""
    path = cached(name, network, *data)
    if path is not None:
        with contextlib.suppress(OSError, ValueError, RecursionError):
            return json.loads(path.read_text(encoding="utf-8"))
    return None


def cached(name: str, network: Network, *data: Array) -> Path | None:
    """Return the file of a result about a network, and about `data` if it depends on some; None if there is no
    cache.
    """
    folder = cache_folder(name)
    if folder is None:
        return None
    told = hashlib.sha256(f"{_code()} ".encode() + dump(network).split("\n[revision]")[0].encode())
    for values in data:
        told.update(repr(values.shape).encode() + np.ascontiguousarray(values).tobytes())
    return folder / f"{told.hexdigest()[:32]}.json"


@cache
def _code() -> str:
    """Return a digest of the code of elements and search: with other code a result may differ."""
    here = Path(__file__).parent
    files = [*sorted(here.rglob("*.py")), *sorted((here.parent / "elements").rglob("*.py"))]
    return hashlib.sha256(b"\0".join(p.read_bytes() for p in files)).hexdigest()
