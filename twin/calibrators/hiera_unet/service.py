"""The network as a calibrator: a proposal every window from the causal branch, written only where all gates are open.

Modes: *shadow* computes and changes nothing; *advisory* says what it would do; *controlled* moves the live twin's
parameters. The commissioned values are never overwritten, and deviations are always from them.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from twin.calibrators.base import Calibration, Window
from twin.calibrators.hiera_unet import gates
from twin.calibrators.hiera_unet.channels import table
from twin.calibrators.hiera_unet.evidence import Evidence, estimate, step_noise
from twin.calibrators.hiera_unet.features import Features, Frame
from twin.calibrators.hiera_unet.gates import Evidently, Reason
from twin.calibrators.hiera_unet.history import History
from twin.calibrators.hiera_unet.members import Ensemble, Said
from twin.calibrators.hiera_unet.parameters import Deviations
from twin.calibrators.hiera_unet.windows import TARGET, Windows
from twin.calibrators.outcome import Report, conclude
from twin.calibrators.posterior import STATE_SD, weighted
from twin.gauss_newton import align
from twin.network import Array, Network

Mode = Literal["shadow", "advisory", "controlled"]
TRAINED = Path(__file__).resolve().parents[3] / "profiles" / "trained"


class HieraUNetCalibrator:
    """The network calibrator; satisfies `Calibrator`. Deterministic.

    Args:
        ensemble: trained for this twin's structure and channel table.
    """

    name = "hiera_unet"

    def __init__(self, network: Network, ensemble: Ensemble, features: Features, mode: Mode = "controlled") -> None:
        self.network, self.ensemble, self.features, self.mode = network, ensemble, features, mode
        self.ids = features.deviations.ids
        self.history = History(len(network.input_columns), len(network.sensors))
        self._leakage: float | None = None

    @classmethod
    def shipped(cls, network: Network, tunables: str = "nine", mode: Mode = "controlled") -> HieraUNetCalibrator:
        """With the small ensemble under `profiles/trained`.

        Raises:
            HieraError: torch is missing, or there is no ensemble for this twin.
            TwinFileError: no channel table fits the twin.
        """
        from twin.calibrators.hiera_unet.device import ready

        ready()
        from twin.calibrators.hiera_unet.binding import identity_of
        from twin.calibrators.hiera_unet.members import load_ensemble

        channels, deviations = table(network), Deviations.of(network, tunables)
        card = TRAINED / f"{channels.name}_small.json"
        ensemble = load_ensemble(card, identity_of(network, channels, deviations))
        return cls(network, ensemble, Features(network, channels, deviations), mode)

    def calibrate(self, window: Window) -> Calibration:
        self.history.push(window.time, window.inputs, window.measured)
        nominal = self.network.values
        series = self.history.series()
        frame = self.features.frame(series, len(series), nominal)
        evidence = estimate(self.features, frame, nominal)
        frame = self.features.explained(frame, nominal, evidence.theta, evidence.steps)
        row = one(frame, evidence, nominal)
        said = self.ensemble.ask(row)
        if self._leakage is None and frame.begin == 0:
            self._leakage = self.ensemble.leakage(row)
        found = gates.reasons(self._evidently(frame, evidence, said, row), self.ids)
        return self._concluded(window, evidence, said, found)

    def _evidently(self, frame: Frame, evidence: Evidence, said: Said, row: Windows) -> Evidently:
        needed = self.features.table.indices("u", "y", "r")
        half = self.ensemble.half_widths(said, int(row.regime[0, -1]))
        full = self.features.deviations.full(said.theta, row.nominal[0])
        time = np.arange(TARGET, dtype=np.float64) * 5.0
        twin = self.features.kernel.trace(full, frame.state, time, frame.held[-TARGET:])[0][0]
        error = frame.target - twin - said.delta
        good = np.isfinite(error)
        squares = np.where(good, error, 0.0) ** 2
        count = good.sum(axis=0)
        return Evidently(
            hidden=float(1.0 - frame.m[frame.begin :, needed].mean()),
            steps=len(frame.time) - frame.begin,
            measured=frame.target,
            noise=step_noise(self.features),
            condition=evidence.condition,
            told=evidence.told,
            half_width=half.mean(axis=0),
            missed=np.where(count > 0, np.sqrt(squares.sum(axis=0) / np.maximum(count, 1)), np.nan),
            sd=said.theta_sd,
            prior=self.features.deviations.prior_sd,
            distance=said.distance,
            leakage=self._leakage or 0.0,
        )

    def _concluded(self, window: Window, evidence: Evidence, said: Said, found: tuple[Reason, ...]) -> Calibration:
        network, deviations = self.network, self.features.deviations
        held = gates.held(found, self.ids)
        index = network.index(self.ids)
        now = window.parameters[index]
        proposed = np.where(held, now, deviations.values(said.theta, network.values))
        values = proposed if self.mode == "controlled" else now
        full = window.parameters.copy()
        full[index] = values
        data = weighted(window, network.sigma)
        start = align(self.features.kernel, full, window.state, data, max(window.error_K, STATE_SD))
        readings, end = self.features.kernel.trace(full, start, window.time, window.inputs)
        misses = (readings[0] - window.measured) / network.sigma
        good = np.isfinite(misses)
        slope = deviations.scaling(network.values).slope(deviations.values(said.theta, network.values))
        flags = [str(r) for r in found]
        if self.mode == "advisory" and not held.all():
            flags += [f"proposes {i} = {v:.4g}" for i, v, h in zip(self.ids, proposed, held, strict=True) if not h]
        report = Report(
            covariance=np.diag((said.theta_sd * slope) ** 2),
            flags=tuple(flags),
            frozen=tuple(i for i, h in zip(self.ids, held, strict=True) if h),
            condition=evidence.condition,
        )
        return conclude(
            network, window, self.ids, values, start, readings[0], end[0],
            cost=float(np.sqrt(np.mean(misses[good] ** 2))) if good.any() else 0.0,
            evaluations=evidence.evaluations + len(self.ensemble.members), report=report,
        )  # fmt: skip

    def state(self) -> dict[str, Any]:
        return {"history": self.history.state(), "leakage": self._leakage, "ensemble": self.ensemble.card["members"]}

    def restore(self, state: Mapping[str, Any]) -> None:
        self.history.restore(state["history"])
        self._leakage = state["leakage"]


def one(frame: Frame, evidence: Evidence, nominal: Array) -> Windows:
    """A window as a batch of one; truth, labels and what is not known of it are NaN."""
    count, sensors = len(evidence.theta), frame.target.shape[1]
    single = np.float32
    return Windows(
        x=frame.x[None].astype(single),
        m=frame.m[None],
        regime=frame.regime[None],
        clock=frame.clock[None].astype(single),
        meta=np.concatenate([frame.figures, evidence.tokens()])[None].astype(single),
        target=frame.target[None].astype(single),
        truth=np.full((1, TARGET, sensors), np.nan, dtype=single),
        base=frame.base[None].astype(single),
        state=frame.state[None],
        inputs=frame.held[None, -TARGET:],
        theta=np.full((1, count), np.nan, dtype=single),
        known=np.zeros((1, count), dtype=bool),
        changed=np.zeros(1, dtype=bool),
        nominal=nominal[None],
    )
