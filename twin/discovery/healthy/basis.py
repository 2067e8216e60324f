"""Prior knowledge of a diagnosis: noise, tunables and their uncertainty, known structure."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from twin.commissioning import weak_prior
from twin.discovery.effects.input_times import heat_by_input_times
from twin.discovery.effects.laws import Book, CandidateLaw
from twin.discovery.effects.operating import offsets
from twin.discovery.effects.probe import FreeRun, Probe, free_run
from twin.discovery.healthy.claim_threshold import Bootstrap, kept
from twin.discovery.healthy.health import Health, NotHealthyError
from twin.discovery.healthy.law_amplitudes import HealthyResidual, MissingInHealth
from twin.discovery.records import noise as noises
from twin.discovery.records.grid import Grid, on_grid, sample_period
from twin.discovery.records.transients import Transients
from twin.discovery.scoring.score_tests import ScoreTest, UsualErrors
from twin.discovery.scoring.search import scan
from twin.discovery.scoring.structure import Structure
from twin.gauss_newton import GaussianPrior
from twin.network import Array, Network, TwinFileError

ROUNDING = 1e-9
"""Share of a value by which means of equal samples may differ."""
BETTER = 0.9
"""Ratio of squares on a healthy record below which an older twin replaces a newer one."""


@dataclass(frozen=True)
class Columns:
    """Record in the columns of a network: time (N,) s, inputs (N, c), measured (N, m) degC.

    `members` holds the single thermometers (N, c) of every sensor that is the mean of several, NaN where one is
    missing.
    """

    time_s: Array
    inputs: Array
    measured: Array
    members: Mapping[str, Array] = field(default_factory=dict)

    @classmethod
    def of(cls, network: Network, time_s: ArrayLike, columns: Mapping[str, ArrayLike]) -> Columns:
        """Select a network's columns.

        Raises:
            TwinFileError: some columns are missing.
        """
        inputs, measured = network.select(columns)
        nothing = np.full(len(measured), np.nan)
        single = {
            s.name: np.column_stack([np.asarray(columns.get(c, nothing), dtype=np.float64) for c in s.measured])
            for s in network.sensors
            if len(s.measured) > 1
        }
        return cls(np.asarray(time_s, dtype=np.float64), inputs, measured, single)

    def part(self, rows: slice) -> Columns:
        """Return some rows of the record."""
        members = {name: each[rows] for name, each in self.members.items()}
        return replace(
            self, time_s=self.time_s[rows], inputs=self.inputs[rows], measured=self.measured[rows], members=members
        )


@dataclass(frozen=True)
class CommissionedRecord(Columns):
    """Healthy record, with the twins `before` each adopted effect that the record does not hold, newest first.

    Those of `before` have the columns of the present twin.
    """

    before: tuple[Network, ...] = ()


@dataclass(frozen=True)
class Basis:
    """Prior knowledge about a rig, before its record is used.

    Attributes:
        tried: (2, c) lowest and highest inputs, without short excursions, of the healthy record, or of the record if
            there is none.
        structure: model error, as estimated from the healthy record. plain: the noise if no model error is known.
        bootstrap: results on simulated healthy records of this twin, if there are any (`bootstrap`).
        earlier: the twin that the healthy record belongs to if it is not the present one, or None.
        health: the healthy record, or None. missing: laws that the twin lacked already in health, by both records.
        transients: errors after fast changes in the healthy record, or None if there is none.
        period_s: interval between the record's samples, s; 0 if its inputs change at known times.
    """

    probe: Probe
    book: Book
    noise: noises.Noise
    prior: GaussianPrior
    warnings: tuple[str, ...]
    tried: Array
    plain: noises.Noise | None = None
    structure: Structure | None = None
    bootstrap: Bootstrap | None = None
    earlier: Network | None = None
    health: HealthyResidual | None = None
    missing: MissingInHealth | None = None
    transients: Transients | None = None
    period_s: float = 0.0

    @property
    def sentence(self) -> str:
        """Return a sentence about the twin that the healthy record belongs to, or "" if it is the present one."""
        if self.earlier is None:
            return ""
        silent = [s.name for s in self.probe.network.sensors if len(s.measured) > 1 and s.node in self.taken_up]
        return (
            f"the healthy record is of the rig before the twin's last changes: noise and how far tunables are trusted "
            f"are what its revision {self.earlier.revision.number} makes of it"
        ) + (f"; the single thermometers of {' and '.join(silent)} are not compared with it" if silent else "")

    @cached_property
    def taken_up(self) -> frozenset[str]:
        """Return the nodes at which an effect has been adopted since the healthy record."""
        if self.earlier is None:
            return frozenset()
        now, then = self.probe.network, self.earlier
        free = {*then.tunables("commission" if "commission" in then.sets else None)}
        new = {
            p.element
            for p in now.parameters.values()
            if p.id not in free and (p.id not in then.parameters or p.value != then.parameters[p.id].value)
        }
        return frozenset(node for e in now.elements if e.name in new for node in e.nodes())

    def score_test(self, grid: Grid, state: Array, run: FreeRun, laws: list[CandidateLaw]) -> ScoreTest:
        """Return the score test of a record with these laws."""
        structure = self.structure
        if structure is not None:
            here = offsets(self.probe.network, laws, grid)
            structure, laws = structure.beyond(here), [*laws, *here]
        times = heat_by_input_times(self.book, grid, run, self.period_s) if self.period_s else None
        transient = None if self.transients is None else self.transients.errors(grid, run.readings)
        usual = UsualErrors(structure, laws, times, transient)
        return ScoreTest(self.probe, grid, state, run, self.noise, self.prior, usual)

    def assumed(self, grid: Grid) -> frozenset[str]:
        """Return the temperatures among the inputs that nobody measured: the same in all of the record, and in health.

        No thermometer of theirs can have failed.
        """
        columns = self.probe.network.input_columns
        every = np.vstack([grid.inputs, self.tried])
        alike = np.ptp(every, axis=0) <= ROUNDING * np.abs(every).max(axis=0)
        return frozenset(c for c, same in zip(columns, alike, strict=True) if same and c.endswith("_C"))

    @property
    def claim(self) -> float:
        """Return the log posterior odds that a bootstrap of this twin requires for a claim; 0 without one."""
        return 0.0 if self.bootstrap is None else self.bootstrap.claim


def basis(network: Network, healthy: Columns | None, record: Grid, period_s: float = 0.0) -> Basis:
    """Return noise and prior from a healthy record, or from the record itself.

    Args:
        period_s: interval of the record's samples, to which the healthy record is thinned. Between two samples the time
            of a load change is unknown, and a twin driven by them has the same error in health; 0 if the times of a
            planned record are known.

    Raises:
        NotHealthyError: the healthy record does not fit the twin. TwinFileError: a twin without tunables.
    """
    ids = network.tunables("commission" if "commission" in network.sets else None)
    if not ids:
        raise TwinFileError(f"twin {network.name!r} has no tunables; set the status of at least one parameter")
    probe, book = _asked(network, ids, healthy is not None)
    if healthy is not None:
        thinned = _as_often(healthy, period_s)
        try:
            health, of = _healthy(network, probe, book, thinned)
        except NotHealthyError:
            if thinned is healthy:
                raise
            # So few samples that what happened between them looks like a fault of the healthy rig.
            health, of = _healthy(network, probe, book, healthy)
        same = health.noise.step_s == record.step_s
        return Basis(
            probe=probe,
            book=book,
            noise=health.less if same else health.less.at_step(record.step_s),
            plain=health.noise if same else health.noise.at_step(record.step_s),
            prior=_about(health.prior, of, probe),
            warnings=(health.rough,) if health.rough else (),
            tried=_tried(health.grid),
            structure=health.structure,
            bootstrap=kept(network, healthy.time_s, healthy.inputs, healthy.measured),
            earlier=None if of is probe else of.network,
            health=health.itself,
            transients=health.transients,
            period_s=period_s,
        )
    state, _, residual, _ = free_run(probe, record)
    prior = weak_prior(probe.scaling, network.values[probe.scaling.index], state[: probe.k], 0.3)
    learned = noises.learn(residual, record.sigma, record.step_s)
    warning = (
        "no healthy record was given: the noise floor is taken from this record itself, so small effects are not seen "
        "and parameters are trusted less; give --healthy for a sharper answer"
    )
    own = _from_itself(probe, book, record, state, learned, prior)
    return Basis(probe, book, own, prior, (warning,), _tried(record), period_s=period_s)


def _asked(network: Network, ids: tuple[str, ...], late_at_once: bool) -> tuple[Probe, Book]:
    """Return probe and book of a network; those of the last few are cached, as one twin serves several records."""
    for known, tunables, late, probe, book in _last:
        if known is network and tunables == ids and late == late_at_once:
            return probe, book
    new = Probe(network, ids), Book(network, late_at_once=late_at_once)
    _last.append((network, ids, late_at_once, *new))
    return new


_last: deque[tuple[Network, tuple[str, ...], bool, Probe, Book]] = deque(maxlen=2)


def _as_often(healthy: Columns, period_s: float) -> Columns:
    """Return a healthy record with samples `period_s` apart, or unchanged if that is no coarser."""
    every = round(period_s / sample_period(healthy.time_s)) if len(healthy.time_s) > 1 else 1
    if every < 2:
        return healthy
    rows = slice(None, None, every)
    members = {name: values[rows] for name, values in healthy.members.items()}
    time_s, inputs, measured = healthy.time_s[rows], healthy.inputs[rows], healthy.measured[rows]
    return replace(healthy, time_s=time_s, inputs=inputs, measured=measured, members=members)


def _healthy(network: Network, probe: Probe, book: Book, healthy: Columns) -> tuple[Health, Probe]:
    """Return what the twin that fits a healthy record best learns from it, and its probe; of equals the newest."""
    before = healthy.before if isinstance(healthy, CommissionedRecord) else ()
    best, least = probe, np.inf
    for then in (network, *before) if before else ():
        of = (
            probe
            if then is network
            else Probe(then, then.tunables("commission" if "commission" in then.sets else None))
        )
        _, _, residual, good = free_run(of, grid := on_grid(then, healthy.time_s, healthy.inputs, healthy.measured))
        left = float(np.nansum((np.where(good, residual, 0.0) / grid.sigma) ** 2))
        if left < BETTER * least:
            best, least = of, left
    return Health.of(best.network, best, book if best is probe else Book(best.network), healthy), best


def _about(prior: GaussianPrior, of: Probe, now: Probe) -> GaussianPrior:
    """Return the prior of an earlier twin's tunables, centred on the values of the present one."""
    if of is now:
        return prior
    shared = [i for i, name in enumerate(of.scaling.ids) if name in now.scaling.ids]
    places = [now.scaling.ids.index(of.scaling.ids[i]) for i in shared]
    rows = np.concatenate([shared, of.q + np.arange(of.k)]).astype(int)
    at = np.concatenate([places, now.q + np.arange(now.k)]).astype(int)
    covariance = np.linalg.inv(prior.precision)
    # What it has now is no better known for being new.
    wide = np.concatenate([now.scaling.prior_sd() ** 2, np.ones(now.k)])
    own = np.diag(wide)
    own[np.ix_(at, at)] = covariance[np.ix_(rows, rows)]
    mean = np.concatenate([now.scaling.to_z(now.network.values[now.scaling.index]), prior.mean[of.q :]])
    return GaussianPrior(mean, np.linalg.inv(own))


def _tried(grid: Grid) -> Array:
    tried: Array = np.percentile(grid.inputs, (2.0, 98.0), axis=0)
    return tried


def _from_itself(
    probe: Probe, book: Book, grid: Grid, state: Array, noise: noises.Noise, prior: GaussianPrior
) -> noises.Noise:
    """Return the noise of the record after its best three hypotheses have been subtracted, in two iterations."""
    run = probe.run(grid, state)
    candidates = book.laws(grid, run)
    for _ in range(2):
        score_test = ScoreTest(probe, grid, state, run, noise, prior)
        chosen: list[Array] = []
        for _ in range(3):
            found = scan(score_test, candidates, np.stack(chosen) if chosen else None)
            if not found or found[0].z < 3.0:
                break
            chosen.append(found[0].vector)
        sizes = score_test.estimate(np.stack(chosen) if chosen else np.empty((0, score_test.sites, score_test.b))).sizes
        moved = score_test.moved(np.array(chosen), sizes)
        left = score_test.left_over(np.array(chosen), sizes, moved)
        noise = noises.learn_blocks(left, grid.sigma, score_test.step_s, grid.step_s, noise)
    return noise
