"""Where what takes long to find out about a twin is kept: beside its kernels, until twin or code change."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

import numpy as np

from twin.kernel import cache_folder
from twin.network import Array, Network
from twin.twinfile import dump


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
    files = sorted(p for p in Path(__file__).parents[1].rglob("*.py") if p.parent.name in ("elements", "discovery"))
    return hashlib.sha256(b"\0".join(p.read_bytes() for p in files)).hexdigest()
