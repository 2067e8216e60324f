"""Seeded windows of the benchmark: one of each rig, healthy or after a change.

The rigs are those of `hil bench hiera`, on which no twin was tuned: simulated networks with more in them than the twin,
and the plant of the virtual rig.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np

from hil.bench.hiera import HieraCase, cases
from hil.training import features_of
from twin import Array, Network, TwinTracker
from twin.calibrators import Calibration, Window
from twin.calibrators.hiera_unet import Family, Features
from twin.calibrators.hiera_unet.data.series import STEP_S
from twin.calibrators.hiera_unet.data.windows import TARGET
from twin.calibrators.least_squares import LeastSquares
from twin.calibrators.posterior import WindowPrior

WINDOWS_AFTER = (1, 3)
"""Whole windows after the change, in turn: the first, whose prior knows nothing of the change, and the third."""
HEALTHY_WINDOW = 15
"""Number of the window of a healthy rig, from 0: two and a half hours into the record."""


@dataclass(frozen=True)
class PosteriorWindow:
    """Window with its prior and its truth.

    Attributes
    ----------
    rig, state
        Kind of the rig, and healthy or changed.
    network
        Twin of the rig with the noise of its rows.
    window
        The window.
    known
        What the calibrator had estimated before it: mean (q,) and covariance (q, q) in z, not yet opened.
    before
        The same, opened for the window.
    truth
        (q,) true values in their own units, NaN where there is none.
    """

    rig: str
    state: str
    network: Network
    window: Window
    known: WindowPrior
    before: WindowPrior
    truth: Array


class _Recorder(LeastSquares):
    """Least squares that keeps the windows that it received, with what it knew before each."""

    def __init__(self, network: Network) -> None:
        super().__init__(network)
        self.seen: dict[int, tuple[Window, WindowPrior, WindowPrior]] = {}

    def calibrate(self, window: Window) -> Calibration:
        """Keep the window, and fit it."""
        belief = self._parameters
        known = WindowPrior(belief.mean.copy(), belief.covariance.copy(), window.state)
        self.seen[round(float(window.time[0]) / (TARGET * STEP_S))] = window, known, belief.before(window)
        return super().calibrate(window)


def posterior_windows(simulated: int, virtual: int, seed: int) -> Iterator[PosteriorWindow]:
    """Return one window of each of so many simulated and virtual rigs."""
    features = features_of()
    family = Family(features.network, features.deviations)
    every = chain(cases.simulated(family, seed, simulated), cases.virtual(features, seed, virtual))
    for number, case in enumerate(every):
        yield _window(features, case, WINDOWS_AFTER[number % len(WINDOWS_AFTER)])


def _window(features: Features, case: HieraCase, after: int) -> PosteriorWindow:
    campaign = case.campaign
    values = dict(zip(features.network.ids, campaign.nominal.tolist(), strict=True))
    noise = {s.name: f"{s.name}.sigma" for s in features.network.sensors}
    own = {k: v for k, v in values.items() if not features.network.parameters[k].same_as}
    own |= {i: features.network.parameters[i].value / np.sqrt(STEP_S) for i in noise.values()}
    network = features.network.with_values(own)
    changed = case.kind != "healthy"
    wanted = case.first_after + after - 1 if changed else HEALTHY_WINDOW
    part = campaign.series.part(0, TARGET * (wanted + 1))
    recorder = _Recorder(network)
    TwinTracker(network, recorder).push(part.time - part.time[0], part.inputs, part.measured)
    window, known, before = recorder.seen[wanted]
    theta = campaign.theta[TARGET * wanted : TARGET * (wanted + 1)].mean(axis=0)
    ids = features.deviations.ids
    true = dict(zip(ids, features.deviations.values(theta, campaign.nominal).tolist(), strict=True))
    truth = np.array([true.get(i, np.nan) for i in recorder.ids])
    return PosteriorWindow(case.rig, "changed" if changed else "healthy", network, window, known, before, truth)
