"""The shipped loop with an untrained ensemble that says what the evidence says, and records of the loop."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")
pytest.importorskip("safetensors", reason="safetensors is not installed: trained networks cannot be read")

from twin.calibrators.hiera_unet.data.channels import table  # noqa: E402
from twin.calibrators.hiera_unet.data.features import Features  # noqa: E402
from twin.calibrators.hiera_unet.data.parameters import Deviations  # noqa: E402
from twin.calibrators.hiera_unet.model.network import HieraUNet  # noqa: E402
from twin.calibrators.hiera_unet.serve.members import Ensemble  # noqa: E402
from twin.calibrators.hiera_unet.serve.service import HieraUNetCalibrator  # noqa: E402
from twin.calibrators.hiera_unet.weights.binding import config_for, identity_of  # noqa: E402
from twin.calibrators.hiera_unet.weights.checkpoint import Member, load, save  # noqa: E402
from twin.calibrators.hiera_unet.weights.envelope import Envelope  # noqa: E402
from twin.kernel import simulate  # noqa: E402
from twin.twinfile import load as load_twin  # noqa: E402

LOOP = load_twin(Path(__file__).resolve().parents[3] / "profiles" / "twins" / "loop.toml")
DEVIATIONS = Deviations.of(LOOP)
TABLE = table(LOOP)
IDENTITY = identity_of(LOOP, TABLE, DEVIATIONS)
HOURS = 1.2


def untrained(seed: int = 0) -> Member:
    """Says what the evidence says, and that it is sure of it."""
    torch.manual_seed(seed)
    net = HieraUNet(config_for("small", LOOP, TABLE, DEVIATIONS)).eval()
    with torch.no_grad():
        net.parameter_head.out.bias[len(DEVIATIONS) : 2 * len(DEVIATIONS)] = -8.0
    width = 2 * net.config.channels
    return Member(net, IDENTITY, Envelope(np.zeros(width), np.eye(width), 1e6), {"leakage": 0.0, "seed": seed})


def ensemble_card(folder: Path, **other: Any) -> Path:
    for seed in (0, 1):
        save(replace(untrained(seed), card={"leakage": 0.0, **other}), folder / f"loop_small_{seed}.safetensors")
    names = {f"loop_small_{s}.safetensors" for s in (0, 1)}
    factors = {"confidence": 0.9, "overall": [2.0] * 4, "binned": {}, "counts": {}, "method": "split conformal"}
    document = {
        "format": 2,
        "name": "loop_small",
        "members": {n: load(folder / n).card["weights"]["sha256"] for n in sorted(names)},
        "modes": {"online": {"outputs": factors, "parameters": None}},
    }
    card = folder / "loop_small.json"
    card.write_text(json.dumps(document))
    return card


def record(change: dict[str, float], hours: float = HOURS, seed: int = 0) -> tuple[Any, Any, Any]:
    """The loop, excited, with values that changed before the record began."""
    rng = np.random.default_rng(seed)
    n = int(hours * 3600)
    t = np.arange(n, dtype=np.float64)
    level = lambda low, high, every: np.repeat(rng.uniform(low, high, n // every + 1), every)[:n]  # noqa: E731
    u = np.column_stack([level(400, 900, 700), level(60, 100, 1100), level(30, 90, 900), np.full(n, 22.0)])
    clean = simulate(LOOP.with_values(change), t, u, np.array([35.0, 32.0, 29.0, 30.0]))
    return t, u, clean + 0.05 * rng.standard_normal(clean.shape)


def calibrator(ensemble: Ensemble) -> HieraUNetCalibrator:
    return HieraUNetCalibrator(LOOP, ensemble, Features(LOOP, TABLE, DEVIATIONS))


CHANGE = {"fins.UA_100": 45.0, "tank_loss.hA": 8.0}


def fouling(onset: int, hours: float = HOURS) -> tuple[Any, Any, Any]:
    """The loop as commissioned, and with a fouled radiator from second `onset` on."""
    t, u, _ = record({}, hours)
    start = np.array([35.0, 32.0, 29.0, 30.0])
    before = simulate(LOOP, t[: onset + 1], u[: onset + 1], start)
    after = simulate(LOOP.with_values({"fins.UA_100": 45.0}), t[onset:], u[onset:], before[-1])
    clean = np.vstack([before[:-1], after])
    return t, u, clean + 0.05 * np.random.default_rng(0).standard_normal(clean.shape)


def lying(hours: float = 2.4, since_s: float = 6000.0) -> tuple[Any, Any, Any, Any]:
    """A healthy record in which the tank's thermometer reads 0.6 K more from a moment on; what it ought to read."""
    t, u, y = record({}, hours)
    true = y.copy()
    y[t >= since_s, TANK] += 0.6
    return t, u, y, true


TANK = LOOP.sensor_names.index("T_tank_C")
