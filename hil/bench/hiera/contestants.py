"""Contestants of `hil bench hiera`: each predicts ten minutes from earlier data.

The network's calibrators take on what they find within windows, too, and predict the second half from there.
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.bench.hiera.cases import HieraCase
from twin import Array, Network, TwinTracker
from twin.calibrators import CALIBRATOR_NAMES, Calibration, Calibrator, make_calibrator
from twin.calibrators.hiera_unet import ContextFit, Features, Frame
from twin.calibrators.hiera_unet.context_fit.evidence import estimate, identifiable, least_error, step_noise
from twin.calibrators.hiera_unet.data.series import STEP_S
from twin.calibrators.hiera_unet.data.windows import CONTEXT, TARGET
from twin.calibrators.hiera_unet.simulated.campaigns import WindowLabel
from twin.quantiles import NORMAL90

TRAINED = Path(__file__).resolve().parents[3] / "profiles" / "trained" / "loop_small.json"
SAME = 0.03
"""Largest difference of equal deviations, for the start of a label."""


@dataclass(frozen=True)
class CaseInputs:
    """Input of all contestants for one case, and data for the scorer alone.

    Attributes
    ----------
    frames, evidence
        Of each target, made without looking at it.
    known, floor
        (n, P) which labels count, and the Cramer-Rao bound of each.
    theta
        (n, P) truth.
    labels
        As in training.
    cpu_s
        For one frame, and for one evidence.
    """

    case: HieraCase
    frames: tuple[Frame, ...]
    evidence: tuple[ContextFit, ...]
    known: np.ndarray
    floor: Array
    theta: Array
    labels: tuple[WindowLabel, ...]
    cpu_s: tuple[float, float]


@dataclass(frozen=True)
class BlindPredictions:
    """Predictions of one case's n targets.

    Attributes
    ----------
    readings
        (n, 120, Y) degC.
    theta
        (n, P) deviations that it believed in, NaN where it has none.
    half
        (n, 120, Y) K, half widths of its own 90 % intervals, or None.
    calibrated
        (n,) bool, what it said of itself before.
    cpu_s
        A window, features and all.
    """

    readings: Array
    theta: Array
    calibrated: np.ndarray
    cpu_s: float
    half: Array | None = None
    theta_half: Array | None = None


Contestant = Callable[[Features, CaseInputs], BlindPredictions]


def sheet(features: Features, case: HieraCase) -> CaseInputs:
    """Compute everything about a case that is needed once."""
    nominal, series = case.campaign.nominal, case.campaign.series
    ends = [TARGET * (k + 1) for k in case.targets]
    began = time.process_time()
    frames = tuple(features.frame(series, end, nominal) for end in ends)
    middle = time.process_time()
    evidence = tuple(estimate(features, frame, nominal) for frame in frames)
    done = time.process_time()
    rows = [_labelled(features, case, frame, end) for frame, end in zip(frames, ends, strict=True)]
    theta, known, floor = (np.stack([row[k] for row in rows]) for k in range(3))
    labels = tuple(
        WindowLabel(end, t, k, bool(case.campaign.amiss[end - TARGET : end].any()), e.kept())
        for end, t, k, e in zip(ends, theta, known, evidence, strict=True)
    )
    n = max(len(frames), 1)
    return CaseInputs(case, frames, evidence, known, floor, theta, labels, ((middle - began) / n, (done - middle) / n))


def _labelled(features: Features, case: HieraCase, frame: Frame, end: int) -> tuple[Array, np.ndarray, Array]:
    """Return true deviations (P,), a mask of those that count, and their Cramer-Rao bounds."""
    campaign = case.campaign
    rows = campaign.theta[end - TARGET : end]
    theta = rows.mean(axis=0)
    if not np.isfinite(theta).any():
        return theta, np.zeros(theta.size, dtype=bool), np.full(theta.size, np.inf)
    with np.errstate(invalid="ignore"):
        away = np.nanmax(np.abs(campaign.theta[:end] - theta), axis=1, initial=0.0) > SAME
    before = np.flatnonzero(away)
    since = (int(before[-1]) + 1 if before.size else 0) - (end - CONTEXT)
    known = identifiable(features, frame, campaign.nominal, since) & np.isfinite(theta)
    return theta, known, least_error(features, frame, campaign.nominal, theta, since)


def commissioned(features: Features, given: CaseInputs) -> BlindPredictions:
    """Return the predictions of the commissioned twin, begun at the state of the last readings."""
    readings = np.stack([frame.base for frame in given.frames])
    none = np.zeros((len(readings), len(features.deviations)))
    return BlindPredictions(readings, none, np.zeros(len(readings), dtype=bool), given.cpu_s[0])


def fitted(features: Features, given: CaseInputs) -> BlindPredictions:
    """Return the predictions of least squares over the last minutes to two hours: the evidence."""
    return refit(features, given, given.evidence, sum(given.cpu_s))


def refit(features: Features, given: CaseInputs, found: tuple[ContextFit, ...], cpu_s: float) -> BlindPredictions:
    """Return the predictions of fits of every target's context."""
    readings = np.stack([free_run(features, given, i, e.theta, e.state) for i, e in enumerate(found)])
    noise = float(np.sqrt(np.mean(step_noise(features) ** 2)))
    calibrated = np.array([np.sqrt(e.chi) * noise < features.network.rules.calibrated_K for e in found])
    half = np.stack([np.where(e.told, NORMAL90 * e.sd, np.nan) for e in found])
    return BlindPredictions(readings, np.stack([e.theta for e in found]), calibrated, cpu_s, theta_half=half)


def free_run(features: Features, given: CaseInputs, i: int, theta: Array, state: Array) -> Array:
    """Return readings (120, Y) over target `i`."""
    frame, nominal = given.frames[i], given.case.campaign.nominal
    full = features.deviations.full(theta, nominal)
    return features.kernel.trace(full, state, frame.time[-TARGET:], frame.held[-TARGET:])[0][0]


def tracked(name: str) -> Contestant:
    """Return the predictions of a calibrator of `hil track` over the whole record, always ahead."""

    def contestant(features: Features, given: CaseInputs) -> BlindPredictions:
        campaign, targets = given.case.campaign, given.case.targets
        values = dict(zip(features.network.ids, campaign.nominal.tolist(), strict=True))
        own = {k: v for k, v in values.items() if not features.network.parameters[k].same_as}
        network = features.network.with_values(own)
        tracker = TwinTracker(network, _calibrator(name, network, given.case.seed))
        stop = TARGET * (targets[-1] + 1)
        part = campaign.series.part(0, min(stop, len(campaign.series)))
        began = time.process_time()
        update = tracker.push(part.time, part.inputs, part.measured)
        spent = (time.process_time() - began) * TARGET / len(part)
        done = {_number(c, part.time[0]): c for c in update.calibrations}
        readings = np.stack([update.tracked[TARGET * k : TARGET * (k + 1)] for k in targets])
        theta, half, calibrated = zip(*(_before(features, campaign.nominal, done, k) for k in targets), strict=True)
        return BlindPredictions(readings, np.stack(theta), np.array(calibrated), spent, theta_half=np.stack(half))

    return contestant


def _calibrator(name: str, network: Network, seed: int) -> Calibrator:
    """Return a calibrator with the noise of its rows, which are means over a step's readings.

    The network knows that of itself: its steps are such means whatever it is fed with.
    """
    noise = {f"{s.name}.sigma": network.parameters[f"{s.name}.sigma"].value / np.sqrt(STEP_S) for s in network.sensors}
    steps = network.with_values(noise)
    if name == "hiera_unet":
        return make_calibrator(name, network)
    if name == "hiera_ls":
        from twin.calibrators.hiera_unet import HieraUNetCalibrator, RefinedCalibrator

        return RefinedCalibrator(steps, HieraUNetCalibrator.shipped(network))
    return make_calibrator(name, steps, seed=seed)


def _number(calibration: Calibration, origin: float) -> int:
    return round((calibration.start_s - origin) / (TARGET * STEP_S) - 0.02)


def _before(features: Features, nominal: Array, done: dict[int, Calibration], target: int) -> tuple[Array, Array, bool]:
    """Return the tracker's deviations and half widths (P,) for a target, and its own calibrated flag before it."""
    earlier = [k for k in done if k < target]
    unknown = np.full(len(features.deviations), np.nan)
    if not earlier:
        return unknown, unknown, False
    last, deviations = done[max(earlier)], features.deviations
    there = np.array([name in last.values for name in deviations.ids])
    own = nominal[deviations.index]
    values = np.array([last.values.get(name, v) for name, v in zip(deviations.ids, own.tolist(), strict=True)])
    theta = np.where(there, deviations.theta(values, nominal), np.nan)
    if last.covariance is None:
        return theta, unknown, bool(last.calibrated)
    spread = dict(zip(last.values, np.sqrt(np.diag(last.covariance)).tolist(), strict=True))
    told = np.array([spread[i] if i in spread and i not in last.frozen else np.nan for i in deviations.ids])
    return theta, NORMAL90 * told / deviations.scaling(nominal).slope(values), bool(last.calibrated)


def _shipped() -> tuple[str, ...]:
    """Return the network's calibrators, if a trained ensemble and its libraries are installed."""
    there = TRAINED.is_file() and all(importlib.util.find_spec(name) for name in ("torch", "safetensors"))
    return ("hiera_unet", "hiera_ls") if there else ()


def roster(names: tuple[str, ...] = ()) -> dict[str, Contestant]:
    """Return name -> contestant, in the order of the tables; `names` of the trackers, by default all that are
    installed.
    """
    trackers = names or tuple(n for n in ("pso", "least_squares", "kalman", *_shipped()) if n in CALIBRATOR_NAMES)
    return {"commissioned": commissioned, **{n.replace("_", " "): tracked(n) for n in trackers}, "fit of 2 h": fitted}
