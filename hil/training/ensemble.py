"""Ensemble of the members of a folder: calibrated intervals, and scores on held-out windows.

`<name>.json` names the members with their checksums, the conformal factors, and the scores on the test split, with
those of the baselines.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from hil.training.data import TrainingData

MODES = {"blind": (False, True), "online": (True, False)}
"""Modes: symmetric with the target hidden, as a report may use it; causal with the target as input, as the service
runs.
"""
RESAMPLES = 200


def assemble(data: TrainingData, folder: Path, name: str) -> Path | None:
    """Write the card of the ensemble of all members `<name>_<seed>` in `folder`; return None if there is none.

    Members of other data or another leakage than is allowed are left out, and the card reports it.
    """
    from twin.calibrators.hiera_unet import conformal
    from twin.calibrators.hiera_unet.serve.members import FORMAT, chances
    from twin.calibrators.hiera_unet.weights.binding import identity_of, physics_of
    from twin.calibrators.hiera_unet.weights.checkpoint import load
    from twin.calibrators.hiera_unet.weights.leakage import ALLOWED

    identity = identity_of(data.network, data.table, data.deviations)
    physics = physics_of(data.network, data.table, data.deviations)
    found = {path: load(path, identity) for path in sorted(folder.glob(f"{name}_[0-9]*.safetensors"))}
    left_out = {
        path.name: "trained on other data" if m.card["data"]["sha256"] != data.digest else "its parameters leak"
        for path, m in found.items()
        if m.card["data"]["sha256"] != data.digest or m.card["leakage"] > ALLOWED
    }
    members = {path: m for path, m in found.items() if path.name not in left_out}
    if not members:
        return None
    networks = [m.network for m in members.values()]
    rng, blind = np.random.default_rng(0), None
    document: dict[str, Any] = {
        "format": FORMAT,
        "name": name,
        "members": {path.name: m.card["weights"]["sha256"] for path, m in members.items()},
        "left_out": left_out,
        "data": data.digest,
        "modes": {},
    }
    for mode, (causal, hidden) in MODES.items():
        unseen = _outputs(networks, data.conformal, physics, causal, hidden)
        outputs = conformal.fit(conformal.one_a_window(unseen.error, unseen.scale, rng), data.conformal.regime[:, -1])
        chance = chances(networks[0].config, data.conformal.meta, unseen.theta.shape[1])
        factors = conformal.fit_parameters(unseen.theta_error, unseen.theta_sd, chance)
        test = _outputs(networks, data.test, physics, causal, hidden)
        blind = test if mode == "blind" else blind
        width = outputs.of(data.test.regime[:, -1])[:, None, :] * test.scale
        document["modes"][mode] = {
            "outputs": outputs.document(),
            "parameters": None if factors is None else factors.document(),
            "test": test.metrics()
            | {"interval90": _coverage(test.error, width, data.test.regime[:, -1])}
            | {
                "parameter_interval90": _parameters(
                    test, factors, chances(networks[0].config, data.test.meta, chance.shape[1])
                )
            },
        }
    document["rivals"] = _rivals(networks, data, physics, blind)
    card = folder / f"{name}.json"
    card.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return card


def _rivals(networks: list[Any], data: TrainingData, physics: Any, blind: Any) -> dict[str, Any]:
    """Return parameters and outputs of the evidence, its baselines, and the networks with and without channels.

    On the test split, target hidden; outputs: mean absolute error, K.
    """
    from hil.training.baselines import estimates, judged, noisy, shuffled
    from twin.calibrators.hiera_unet.training.score import missed

    test, config = data.test, networks[0].config
    true = test.theta.astype(np.float64)
    found: dict[str, Any] = {}
    for name, (theta, sd) in estimates(config, data.train, test).items() if config.evidence else ():
        error = missed(physics.simulate, theta, test)
        found[name] = judged(theta, sd, true, test.known) | {"outputs": float(np.nanmean(np.abs(error)))}
    other = {
        f"channels {name}": _outputs(networks, change(test), physics, *MODES["blind"])
        for name, change in (("shuffled", shuffled), ("noise", noisy))
    }
    for name, said in {"network": blind, **other}.items():
        least = np.maximum(said.theta_sd, 1e-6)
        found[name] = judged(said.theta, least, true, test.known) | {"outputs": float(np.nanmean(np.abs(said.error)))}
    return found


def _outputs(networks: list[Any], windows: Any, physics: Any, causal: bool, hidden: bool) -> Any:
    from twin.calibrators.hiera_unet.training.score import outcome
    from twin.calibrators.hiera_unet.weights.ensemble import together

    return together(
        [outcome(n, windows, physics.simulate, physics.told, causal=causal, hidden=hidden) for n in networks]
    )


def _coverage(error: np.ndarray, half: np.ndarray, regime: np.ndarray) -> dict[str, Any]:
    """Return coverage and mean width of intervals, with a bootstrap over windows; by regime as well."""
    found = _inside(error, half)
    rng = np.random.default_rng(0)
    shares = [
        _inside(error[rows], half[rows])["share"] for rows in rng.integers(0, len(error), (RESAMPLES, len(error)))
    ]
    known = [s for s in shares if s is not None]
    found["share_interval90"] = [float(v) for v in np.quantile(known, [0.05, 0.95])] if known else None
    found["by_regime"] = {str(r): _inside(error[regime == r], half[regime == r]) for r in np.unique(regime)}
    return found


def _parameters(test: Any, factors: Any, chance: np.ndarray) -> dict[str, Any] | None:
    """Return coverage and mean widths of parameters: all, deviating, unchanged, and by bin; None without factors."""
    from twin.calibrators.hiera_unet.training.score import MOVED
    from twin.calibrators.hiera_unet.weights.conformal import by_chance

    if factors is None:
        return None
    bins = by_chance(chance)
    half = test.theta_sd * factors.of(bins.reshape(-1)).reshape(bins.shape)
    moved = np.abs(test.theta - test.theta_error) > MOVED
    which = {"all": np.isfinite(half), "moved": moved, "stayed": ~moved} | {
        f"bin {b}": bins == b for b in np.unique(bins)
    }
    return {name: _inside(test.theta_error[rows], half[rows]) for name, rows in which.items()}


def _inside(error: np.ndarray, half: np.ndarray) -> dict[str, Any]:
    good = np.isfinite(error) & np.isfinite(half)
    if not good.any():
        return {"share": None, "width": None, "windows": len(error)}
    inside = np.abs(error) <= half
    return {"share": float(inside[good].mean()), "width": float(2.0 * half[good].mean()), "windows": len(error)}
