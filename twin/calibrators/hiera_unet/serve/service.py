"""Network calibrator: a proposal every five minutes from the causal branch, with gates before its adoption.

The live twin adopts proposals that pass every gate, within windows as at their ends. It belongs to the network: it runs
beside the other twins and controls nothing. Any further use of accepted parameters is the caller's choice. The
commissioned values are never overwritten, and deviations are always from them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from twin.calibrators.base import Calibration, FilteredReadings, Window, from_json, to_json
from twin.calibrators.hiera_unet.context_fit import contradicted
from twin.calibrators.hiera_unet.context_fit.contradicted import Doubt
from twin.calibrators.hiera_unet.context_fit.evidence import ContextFit, estimate, read_by_estimate, step_noise
from twin.calibrators.hiera_unet.context_fit.holding import NARROWEST, taken
from twin.calibrators.hiera_unet.data.channels import table
from twin.calibrators.hiera_unet.data.features import Features, Frame
from twin.calibrators.hiera_unet.data.parameters import Deviations
from twin.calibrators.hiera_unet.data.series import STEP_S, ResampledSeries
from twin.calibrators.hiera_unet.data.windows import CONTEXT, TARGET, Windows, joined
from twin.calibrators.hiera_unet.serve import agreement, gates
from twin.calibrators.hiera_unet.serve.agreement import Spoken
from twin.calibrators.hiera_unet.serve.gates import Evidently, Reason
from twin.calibrators.hiera_unet.serve.history import History
from twin.calibrators.hiera_unet.serve.proposal import Proposal
from twin.calibrators.posterior import STATE_SD, window_data
from twin.calibrators.results import CalibrationReport, WindowFit, fitted_calibration
from twin.calibrators.windows import WindowSamples, make_window
from twin.gauss_newton import fit_initial_state
from twin.network import Array, Network
from twin.quantiles import NORMAL90

if TYPE_CHECKING:  # These need torch; `HieraUNetCalibrator.shipped` reports its absence.
    from twin.calibrators.hiera_unet.serve.members import Ensemble, Said

CYCLE_S = 300.0
RECORDS = 288
"""Proposals in memory: a day's."""
LIVED = 7
"""Cycles for which the live twin's values are kept: half an hour. Values of another calibrator that shares the windows
are not kept."""
FITS = 2 * round(TARGET * STEP_S / CYCLE_S) + 2
"""Fits of contexts that are kept: the two of each cycle until the target of the first has come."""
LATEST, FAR_OFF = 60, 4.0
"""Latest steps over which the live twin is compared with a fit, and the ratio of their mean squares from which it is
adrift."""
DRIVEN, DELIVERED = "level", ("level", "reading")
"""Formula of the channels that are inputs; formulas of inputs and thermometers as recorded. All others are derived from
these, or from an optional meter."""
TRAINED = Path(__file__).resolve().parents[4] / "profiles" / "trained"


class _WindowReading(NamedTuple):
    """Window as the network reads it, and the prediction."""

    frame: Frame
    evidence: ContextFit
    row: Windows
    said: Said


class HieraUNetCalibrator:
    """Network calibrator; satisfies `Calibrator`, `Follower` and `Proposer`. Deterministic.

    `records`: the latest proposals as plain data, those at the ends of windows included.

    Args:
        ensemble: trained for this twin's structure and channel table.
    """

    name = "hiera_unet"
    cycle_s = CYCLE_S

    def __init__(self, network: Network, ensemble: Ensemble, features: Features) -> None:
        self.network, self.ensemble, self.features = network, ensemble, features
        self.ids = features.deviations.ids
        self.history = History(len(network.input_columns), len(network.sensors))
        self.records: deque[dict[str, Any]] = deque(maxlen=RECORDS)
        self._untold: list[dict[str, Any]] = []
        self._spoken: tuple[Spoken, ...] = ()
        self._aside: tuple[Doubt, ...] = ()
        self._lived: deque[Array] = deque(maxlen=LIVED)
        self._fits: dict[bytes, ContextFit] = {}
        self._leakage: float | None = None
        self._spread = np.full(len(network.sensors), np.nan)

    @classmethod
    def shipped(cls, network: Network, tunables: str = "nine", card: Path | None = None) -> HieraUNetCalibrator:
        """Return the calibrator with the small ensemble under `profiles/trained`, or that of another card.

        Raises:
            HieraError: torch is missing, or there is no ensemble for this twin.
            TwinFileError: no channel table fits the twin.
        """
        from twin.calibrators.hiera_unet.weights.device import ready

        ready(threads=1)  # a forward pass is a few milliseconds; the other cores belong to whoever runs the rig
        from twin.calibrators.hiera_unet.serve.members import load_ensemble
        from twin.calibrators.hiera_unet.weights.binding import identity_of

        channels, deviations = table(network), Deviations.of(network, tunables)
        ensemble = load_ensemble(
            card or TRAINED / f"{channels.name}_small.json", identity_of(network, channels, deviations)
        )
        return cls(network, ensemble, Features(network, channels, deviations))

    def calibrate(self, window: Window) -> Calibration:
        self._lived.append(window.parameters.copy())
        proposal = self.propose(window)
        return self._concluded(self.trusted(window), proposal)

    def propose(self, window: Window) -> Proposal:
        """Return the proposal at the end of a window, or of the part of it that has passed."""
        self.history.push(window.time, np.where(window.read, window.inputs, np.nan), window.measured)
        return self._propose(window.parameters)

    def between(self, window: Window) -> tuple[Array, Array] | None:
        """Propose within a window; return the live twin's new values and state, None if the record is unreadable.

        The state is updated also while a change of parameters waits for the agreement of the next proposal.
        """
        self._lived.append(window.parameters.copy())
        proposal = self.propose(window)
        if proposal.closed.all() and not proposal.adrift:
            return None
        values, _, _, end = self._taken_on(self.trusted(window), proposal)
        return values, end

    def trusted(self, window: Window) -> Window:
        """Return the window without the thermometers that the latest proposal excludes."""
        if not self._aside:
            return window
        left = contradicted.without(window.time, window.measured, self._aside)
        found = make_window(
            window.number,
            WindowSamples(window.time, window.inputs, left, window.read),
            window.state,
            window.parameters,
            window.live,
            self.network.rules,
        )
        return replace(found, kind=window.kind) if found.kind == "skipped" else found

    def series(self) -> ResampledSeries:
        """Return the record so far, without the thermometers that the latest proposal excludes."""
        return contradicted.trusted(self.history.series(), self._aside)

    def take(self) -> tuple[dict[str, Any], ...]:
        told, self._untold = tuple(self._untold), []
        return told

    def follow(self, time: Array, inputs: Array, measured: Array, read: np.ndarray, state: Array) -> FilteredReadings:
        """Add samples; the spread is that of the latest proposal.

        `filtered` is NaN: between windows the live twin's own readings are used.
        """
        self.history.push(time, np.where(read, inputs, np.nan), measured)
        nothing = np.full((len(time), len(self.network.sensors)), np.nan)
        return FilteredReadings(nothing, np.broadcast_to(self._spread, nothing.shape).copy())

    def _propose(self, live: Array) -> Proposal:
        """Compute one cycle on all samples; `live` is the full vector (p,) of the live twin."""
        nominal, deviations = self.network.values, self.features.deviations
        before = self._lived[0] if self._lived else live
        twins = (live, before) if (before != live).any() else (live,)
        whole = self.history.series()
        self._aside = contradicted.reviewed(self.features, whole, twins, self._aside)
        # A target is hidden from the fit that is evidence: what is proposed is of one that is still to come.
        past, ahead = self._read(contradicted.trusted(whole, self._aside))
        if self._leakage is None and len(past.frame.time) - past.frame.begin >= gates.SHORTEST_STEPS:
            # Loading only compares the card's own number: the network itself is asked before any gate can open.
            self._leakage = self.ensemble.leakage(past.row)
        _, evidence, _, said = ahead
        seen = self._evidently(past, ahead)
        alone = gates.reasons(seen, self.ids)
        closed = gates.held(alone, self.ids)
        now = live[deviations.index]
        own = deviations.theta(now, nominal)
        found = (*alone, *self._doubts(alone, said, ~closed, own))
        held, values = gates.held(found, self.ids), deviations.values(said.theta, nominal)
        adrift = all(r.parameter for r in found) and self._adrift(ahead, own)
        stays = held & (not adrift)
        took = taken(self.features, ahead.frame, nominal, said.theta, said.theta_sd, stays, own)
        proposal = Proposal(
            time_s=self.history.last_s,
            said=values,
            sd=said.theta_sd * deviations.scaling(nominal).slope(values),
            closed=closed,
            held=held,
            values=np.where(stays, now, deviations.values(took.theta, nominal)),
            reasons=found,
            half_width=seen.half_width,
            condition=evidence.condition,
            attention=said.attention,
            evaluations=sum(e.evaluations for e in (past.evidence, evidence, took)) + 2 * len(self.ensemble.members),
            adrift=adrift,
            doubts=self._aside,
        )
        self._spread = seen.half_width / NORMAL90
        self.records.append(proposal.document(self.network, self.ids))
        self._untold.append(self.records[-1])
        return proposal

    def _adrift(self, ahead: _WindowReading, live: Array) -> bool:
        """Return True if the twin with deviations `live` (P,) has a large error over the latest minutes, which the
        latest fit explains.
        """
        noise, squares = step_noise(self.features), []
        for theta in (live, ahead.evidence.theta):
            left = _rms(self._misses(ahead, theta)[-LATEST:] / noise)
            squares.append(float(np.nanmean(left**2)) if np.isfinite(left).any() else 0.0)
        return squares[0] > FAR_OFF * max(squares[1], 1.0)

    def _doubts(self, alone: tuple[Reason, ...], said: Said, allowed: np.ndarray, live: Array) -> tuple[Reason, ...]:
        """Return the gates that earlier proposals close; the proposal of an unreadable record is not kept."""
        if any(r.code in gates.UNREADABLE for r in alone):
            self._spoken = ()
            return ()
        half = NORMAL90 * np.maximum(said.theta_sd, NARROWEST * self.features.deviations.prior_sd)
        now = Spoken(self.history.last_s, said.theta, half, allowed)
        before = agreement.lately(self._spoken, now.time_s)
        self._spoken = (*before, now)
        return agreement.doubts(before, now, live, self.ids)

    def _read(self, series: ResampledSeries) -> tuple[_WindowReading, _WindowReading]:
        """Return fit and prediction of the window that ends with a series, and of the one that ends a target later.

        The later one has no corrections.
        """
        nominal, found = self.network.values, []
        for part in (series, series.ahead(TARGET)):
            frame = self.features.frame(part, len(part), nominal)
            evidence = self._fitted(frame)
            frame = self.features.explained(frame, nominal, evidence.theta, evidence.steps)
            found.append((frame, evidence, one(self.features, frame, evidence, nominal)))
        # Both at once: half of what a member costs does not depend on how many windows it is asked about.
        said = self.ensemble.ask(joined([row for _, _, row in found]), corrected=1)
        past, ahead = (_WindowReading(*read, told) for read, told in zip(found, said, strict=True))
        return past, ahead

    def _fitted(self, frame: Frame) -> ContextFit:
        """Return the fit of a window's context; the latest are kept, for when their targets have come."""
        read = read_by_estimate(frame)
        found = self._fits.pop(read, None) or estimate(self.features, frame, self.network.values)
        if found.evaluations:  # without data, the result depends on more of the window
            self._fits[read] = found
        while len(self._fits) > FITS:
            del self._fits[next(iter(self._fits))]
        return found

    def _evidently(self, past: _WindowReading, ahead: _WindowReading) -> Evidently:
        """Return the evidence for the gates: of the record and its past predictions, and of the parameters at present.

        A prediction error before an unpredictable change counts only if no fit since explains it.
        """
        frame, said = past.frame, past.said
        # What is made of a reading is hidden with it, and would count it several times.
        needed = [k for k, c in enumerate(self.features.table.channels) if c.formula in DELIVERED]
        half = self.ensemble.half_widths(said, int(past.row.regime[0, -1]))
        full = self.features.deviations.full(past.evidence.theta, past.row.nominal[0])
        time = np.arange(TARGET, dtype=np.float64) * STEP_S
        twin = self.features.kernel.trace(full, frame.state, time, frame.held[-TARGET:])[0][0]
        return Evidently(
            hidden=float(1.0 - frame.m[frame.begin :, needed].mean()),
            steps=len(frame.time) - frame.begin,
            measured=frame.measured[frame.begin :],
            noise=step_noise(self.features),
            condition=ahead.evidence.condition,
            told=ahead.evidence.told,
            half_width=half.mean(axis=0),
            missed=_rms(frame.target - twin - said.delta),
            left=self._left(ahead),
            tolerated=self.network.rules.calibrated_K,
            lost=self._lost(frame),
            sd=ahead.said.theta_sd,
            prior=self.features.deviations.prior_sd,
            distance=ahead.said.distance,
            leakage=self._leakage or 0.0,
        )

    def _lost(self, frame: Frame) -> tuple[str, ...]:
        """Return the columns of inputs that were hidden for most of the target."""
        inputs = [(k, c.of[0]) for k, c in enumerate(self.features.table.channels) if c.formula == DRIVEN]
        return tuple(column for k, column in inputs if frame.m[-TARGET:, k].mean() < 0.5)

    def _left(self, ahead: _WindowReading) -> Array:
        """Return the root mean square (Y,), K, of a fit's residual over its latest segment, of ten minutes at most."""
        return _rms(self._misses(ahead, ahead.evidence.theta)[-TARGET:])

    def _misses(self, ahead: _WindowReading, theta: Array) -> Array:
        """Return measured minus simulated by deviations (P,) over the latest fitted segment (n, Y), K."""
        frame, found, last = ahead.frame, ahead.evidence, CONTEXT - TARGET
        rows = slice(max(last - found.steps, frame.begin), last)
        full = self.features.deviations.full(theta, ahead.row.nominal[0])
        run = self.features.kernel.trace(full, found.start, frame.time[rows], frame.held[rows])[0][0]
        return np.asarray(frame.measured[rows] - run)

    def _taken_on(self, window: Window, proposal: Proposal) -> tuple[Array, Array, Array, Array]:
        """Return the window with the accepted parameters: values (q,), initial state, readings (n, m), final state."""
        index = self.network.index(self.ids)
        full = window.parameters.copy()
        full[index] = proposal.values
        data = window_data(window, self.network.sigma)
        start = fit_initial_state(self.features.kernel, full, window.state, data, max(window.error_K, STATE_SD))
        readings, end = self.features.kernel.trace(full, start, window.time, window.inputs)
        return full[index], start, readings[0], end[0]

    def _concluded(self, window: Window, proposal: Proposal) -> Calibration:
        values, start, readings, end = self._taken_on(window, proposal)
        misses = (readings - window.measured) / self.network.sigma
        good = np.isfinite(misses)
        report = CalibrationReport(
            covariance=np.diag(proposal.spread**2),
            flags=(*(d.sentence(self.network) for d in proposal.doubts), *(str(r) for r in proposal.reasons)),
            frozen=tuple(i for i, h in zip(self.ids, proposal.held, strict=True) if h),
            condition=proposal.condition,
        )
        cost = float(np.sqrt(np.mean(misses[good] ** 2))) if good.any() else 0.0
        fit = WindowFit(values, start, readings, end, cost, proposal.evaluations)
        return fitted_calibration(self.network, window, self.ids, fit, report)

    def state(self) -> dict[str, Any]:
        return {
            "history": self.history.state(),
            "leakage": self._leakage,
            "spread": to_json(self._spread),
            "spoken": [s.plain() for s in self._spoken],
            "doubts": [d.plain() for d in self._aside],
            "lived": [to_json(values) for values in self._lived],
            "records": list(self.records),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        self.history.restore(state["history"])
        self._leakage = state["leakage"]
        self._spread = from_json(state["spread"])
        self._spoken = tuple(Spoken.restored(s) for s in state.get("spoken", ()))
        self._aside = tuple(Doubt.restored(d) for d in state.get("doubts", ()))
        self._lived = deque((from_json(values).reshape(-1) for values in state.get("lived", ())), maxlen=LIVED)
        self.records = deque(state["records"], maxlen=RECORDS)


def _rms(left: Array) -> Array:
    """Return root mean squares (Y,) of residuals (n, Y); NaN where nothing was measured."""
    good = np.isfinite(left)
    count = good.sum(axis=0)
    squares = np.where(good, left, 0.0) ** 2
    return np.where(count > 0, np.sqrt(squares.sum(axis=0) / np.maximum(count, 1)), np.nan)


def one(features: Features, frame: Frame, evidence: ContextFit, nominal: Array) -> Windows:
    """Return a window as a batch of one; truth and labels are NaN."""
    count, sensors = len(evidence.theta), frame.target.shape[1]
    single = np.float32
    return Windows(
        x=frame.x[None].astype(single),
        m=frame.m[None],
        regime=frame.regime[None],
        clock=frame.clock[None].astype(single),
        meta=np.concatenate([frame.figures, evidence.tokens(features.deviations)])[None].astype(single),
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
