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
    """Keep as JSON what was found out about a network, and `data` where it rests on some; nothing without a cache."""
    path = cached(name, network, *data)
    if path is None:
        return
    with contextlib.suppress(OSError):
        unfinished = path.with_suffix(f".{os.getpid()}")
        unfinished.write_text(json.dumps(found), encoding="utf-8")
        unfinished.replace(path)


def stored(name: str, network: Network, *data: Array) -> Any:
    """What was kept by `store`; None where nothing was, or it cannot be read."""
    path = cached(name, network, *data)
    if path is not None:
        with contextlib.suppress(OSError, ValueError):
            return json.loads(path.read_text(encoding="utf-8"))
    return None


def cached(name: str, network: Network, *data: Array) -> Path | None:
    """The file of what was found out about a network, and `data` where it rests on some; None without a cache."""
    folder = cache_folder(name)
    if folder is None:
        return None
    told = hashlib.sha256(f"{_code()} ".encode() + dump(network).split("\n[revision]")[0].encode())
    for values in data:
        told.update(repr(values.shape).encode() + np.ascontiguousarray(values).tobytes())
    return folder / f"{told.hexdigest()[:32]}.json"


@cache
def _code() -> str:
    """Of the elements and the search: another catalogue has other groups, another search other scores."""
    here = Path(__file__).parent
    files = [*sorted(here.rglob("*.py")), *sorted((here.parent / "elements").rglob("*.py"))]
    return hashlib.sha256(b"\0".join(p.read_bytes() for p in files)).hexdigest()
