"""Network as a contestant of `hil bench hiera`: alone, and as the prior of a fit. Needs torch and an ensemble."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from hil.bench.hiera.contestants import BlindPredictions, CaseInputs, Contestant, refit
from twin import NORMAL90
from twin.calibrators.hiera_unet import Ensemble, Features, ParameterPrior, Windows, load_ensemble
from twin.calibrators.hiera_unet.context_fit.evidence import estimate
from twin.calibrators.hiera_unet.context_fit.holding import NARROWEST
from twin.calibrators.hiera_unet.data.series import STEP_S
from twin.calibrators.hiera_unet.data.windows import concatenate
from twin.calibrators.hiera_unet.serve.service import one
from twin.calibrators.hiera_unet.training.score import NINETY, ScoredWindows, outcome
from twin.calibrators.hiera_unet.training.train import Physics
from twin.calibrators.hiera_unet.weights.binding import identity_of, physics_of
from twin.calibrators.hiera_unet.weights.ensemble import together


def contestants(card: Path, features: Features) -> dict[str, Contestant]:
    """Return the network alone, and the network with a fit, for the ensemble of a card.

    Raises
    ------
    HieraError
        There is none, or it belongs to another twin or channel table.
    """
    parts = (features.network, features.table, features.deviations)
    net = _NetworkContestant(load_ensemble(card, identity_of(*parts)), physics_of(*parts))
    return {"network": net.alone, "network, fit": net.then_fit}


class _NetworkContestant:
    """Ensemble with one evaluation for each case."""

    def __init__(self, ensemble: Ensemble, physics: Physics) -> None:
        self._ensemble, self._physics = ensemble, physics
        self._latest: tuple[CaseInputs, ScoredWindows, float] | None = None

    def _ask(self, features: Features, given: CaseInputs) -> tuple[ScoredWindows, float]:
        if self._latest is None or self._latest[0] is not given:
            windows = _windows(features, given)
            began = time.process_time()
            said = together(
                [
                    outcome(m.network, windows, self._physics.simulate, self._physics.told, causal=True)
                    for m in self._ensemble.members
                ]
            )
            said = replace(said, theta_sd=self._ensemble.calibrated(said.theta_sd, windows.meta))
            self._latest = (given, said, (time.process_time() - began) / len(windows))
        return self._latest[1], self._latest[2]

    def alone(self, features: Features, given: CaseInputs) -> BlindPredictions:
        """Return deviations and corrections of the network, target hidden, causal branch."""
        said, spent = self._ask(features, given)
        # Against a truth of zero, the errors are the predictions.
        certain = np.sqrt(np.mean((NINETY * said.scale) ** 2, axis=(1, 2)))
        calm = certain < features.network.rules.calibrated_K
        half = NINETY * said.scale
        if not np.isfinite(given.case.campaign.truth).any():
            # Intervals are for the rig; here only readings with their noise are known.
            half = np.hypot(half, NORMAL90 * features.network.sigma / np.sqrt(STEP_S))
        return BlindPredictions(said.error, said.theta, calm, sum(given.cpu_s) + spent, half, NORMAL90 * said.theta_sd)

    def then_fit(self, features: Features, given: CaseInputs) -> BlindPredictions:
        """Return least squares with the network's deviations and their spread as the prior."""
        said, spent = self._ask(features, given)
        least = NARROWEST * features.deviations.prior_sd
        began = time.process_time()
        found = tuple(
            estimate(features, frame, given.case.campaign.nominal, belief=ParameterPrior(theta, np.maximum(sd, least)))
            for frame, theta, sd in zip(given.frames, said.theta, said.theta_sd, strict=True)
        )
        spent += (time.process_time() - began) / max(len(found), 1)
        return refit(features, given, found, sum(given.cpu_s) + spent)


def _windows(features: Features, given: CaseInputs) -> Windows:
    nominal = given.case.campaign.nominal
    rows = [
        one(features, features.explained(frame, nominal, found.theta, found.steps), found, nominal)
        for frame, found in zip(given.frames, given.evidence, strict=True)
    ]
    windows = concatenate(rows)
    return replace(windows, truth=np.zeros_like(windows.truth))
