"""Shared material: the shipped loop, drivers that move, and where the development data lie."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from twin.network import Network
from twin.twinfile import load

ROOT = Path(__file__).resolve().parents[2]
LOOP = ROOT / "profiles" / "twins" / "loop.toml"
START = np.array([37.0, 36.8, 34.5, 34.0])


@pytest.fixture(scope="session")
def loop() -> Network:
    return load(LOOP)


@pytest.fixture(scope="session")
def loop_text() -> str:
    return LOOP.read_text(encoding="utf-8")


def drive(n: int, seed: int = 0, every: bool = False, step_s: float = 1.0) -> tuple[NDArray, NDArray]:
    """Stamps (n,) and inputs (n, 4): power, pump, fan, ambient, in steps or (`every`) new each sample."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) * step_s
    hold = 1 if every else 300

    def levels(draw: NDArray) -> NDArray:
        return np.repeat(draw, hold)[:n]

    count = n // hold + 1
    power = levels(rng.uniform(600.0, 900.0, count))
    pump = levels(rng.uniform(70.0, 100.0, count)) if every else np.full(n, 100.0)
    fan = levels(rng.choice([40.0, 60.0, 80.0, 100.0], count))
    return t, np.column_stack([power, pump, fan, 22.0 + np.sin(t / 3000.0)])


@pytest.fixture(scope="session")
def stranger() -> Path:
    folder = Path(os.environ.get("HIL_DATA", ROOT.parent / "shared" / "data")) / "stranger"
    if not folder.is_dir():
        pytest.skip(f"no development data at {folder}; set HIL_DATA to the folder that holds 'stranger'")
    return folder
