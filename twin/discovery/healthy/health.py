"""Healthy record of a twin: estimates of the noise, of the tunables and of the model error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from twin.commissioning import variance_inflation
from twin.discovery.effects.laws import Book, CandidateLaw
from twin.discovery.effects.operating import offsets
from twin.discovery.effects.probe import FreeRun, Probe, free_run, posterior
from twin.discovery.healthy.law_amplitudes import HealthyResidual
from twin.discovery.records import noise as noises
from twin.discovery.records.change_errors import ChangeErrors
from twin.discovery.records.grid import Grid, on_grid
from twin.discovery.records.noise import Noise
from twin.discovery.scoring.score_tests import ScoreTest, UsualErrors
from twin.discovery.scoring.structure import Structure, structure_of
from twin.gauss_newton import GaussianPrior
from twin.network import Array, Network, TwinFileError

if TYPE_CHECKING:
    from twin.discovery.healthy.basis import Columns

WIDEN = 1.0
"""Factor on the variance of the tunables from commissioning, which the colour of its residual has already increased."""
HELD = 1.0e9
"""Precision of fixed tunables."""
RETURNING = 0.5
"""Share of the model error that returns in another record; the rest is noise."""
UNHEALTHY, AS_LEFT = 6.0, 1.5
"""Ratio of a healthy record's residual to a thermometer's noise, and to the error when commissioned, up to which it is
healthy. The larger limit counts: the model error of a lumped twin is no fault."""


class NotHealthyError(TwinFileError):
    """Error for a record that is declared healthy and is not, or not of this twin; the message is about that record."""


@dataclass(frozen=True)
class Health:
    """Estimates from a healthy record: its noise, the noise `less` its known model error, and that model error.

    `itself` is the record for further estimates; `change_errors` are those after fast changes; `rough` is a sentence
    about a residual far above noise, else "".
    """

    grid: Grid
    noise: Noise
    less: Noise
    prior: GaussianPrior
    structure: Structure
    itself: HealthyResidual
    change_errors: ChangeErrors
    rough: str = ""

    @classmethod
    def of(cls, network: Network, probe: Probe, book: Book, healthy: Columns) -> Health:
        """Estimate noise, prior and model error from a healthy record with the twin that was commissioned on it.

        Raises:
            NotHealthyError: the record does not fit the twin.
        """
        grid = on_grid(network, healthy.time_s, healthy.inputs, healthy.measured)
        state, run, residual, good = free_run(probe, grid)
        known = np.where(good, residual, np.nan)
        rms = np.sqrt((np.where(good, residual, 0.0) ** 2).sum(axis=0) / np.maximum(good.sum(axis=0), 1))
        rough = _rough(network, rms)
        prior = posterior(network, probe, grid, state, variance_inflation(known, grid.sigma), WIDEN)
        noise = noises.learn(residual, grid.sigma, grid.step_s, run.readings, grid.resolution)
        laws, held = book.laws(grid, run), _held(prior, probe.q)
        here = offsets(network, laws, grid)
        structure = structure_of(ScoreTest(probe, grid, state, run, noise, held), laws, here)
        amount = _readings(structure, probe, grid, state, run, noise, held, [*laws, *here])
        less = noises.learn(residual - RETURNING * amount, grid.sigma, grid.step_s, run.readings, grid.resolution)
        structure = structure_of(ScoreTest(probe, grid, state, run, less, held), laws, here)
        itself = HealthyResidual(probe, book, grid, state, run, noise)
        return cls(grid, noise, less, prior, structure, itself, ChangeErrors.of(grid, run.readings), rough)


def _rough(network: Network, rms: Array) -> str:
    """Return a sentence about a twin with RMSE (m,), K, far above noise on its healthy record; else "".

    Raises:
        NotHealthyError: the RMSE is larger than when the twin was commissioned.
    """
    single = np.array([network.parameters[f"{s.name}.sigma"].value for s in network.sensors])
    then = (network.revision.error_after_K, network.revision.error_fitted_K)
    usual = np.array([max(errors.get(s.name, 0.0) for errors in then) for s in network.sensors])
    most = np.maximum(UNHEALTHY * single, AS_LEFT * usual)
    worst = int(np.argmax(rms / most))
    if rms[worst] > most[worst]:
        raise NotHealthyError(
            f"the healthy record does not fit the twin: {network.sensor_names[worst]} is off by {rms[worst]:.2f} K "
            f"(noise {single[worst]:.2f} K); commission the twin on this record first, or give one that is healthy"
        )
    worst = int(np.argmax(rms / single))
    if rms[worst] <= UNHEALTHY * single[worst]:
        return ""
    return (
        f"of its own healthy record the twin leaves {rms[worst]:.2f} K at {network.sensor_names[worst]} (noise "
        f"{single[worst]:.2g} K): what is less is hardly seen, and forms are told less surely; a twin of more volumes "
        "may leave less"
    )


def _held(prior: GaussianPrior, q: int) -> GaussianPrior:
    """Return the prior with its q tunables fixed.

    Tunables and structure can explain the same misfit, and only their sum is identifiable. With a separate uncertainty
    for each, the sum would be uncertain too, and hide the effect of a later record.
    """
    precision = prior.precision.copy()
    precision[:q, :q] += HELD * np.eye(q)
    return GaussianPrior(prior.mean, precision)


def _readings(
    structure: Structure,
    probe: Probe,
    grid: Grid,
    state: Array,
    run: FreeRun,
    noise: Noise,
    prior: GaussianPrior,
    laws: list[CandidateLaw],
) -> Array:
    """Return the change of the readings (n, m), K, by the model error and the tunables that go with it."""
    score_test = ScoreTest(probe, grid, state, run, noise, prior, UsualErrors(structure, laws))
    size = dict(zip((c.id for c in structure.candidates), structure.sizes, strict=True))
    heat, reading = np.zeros_like(run.temperatures), np.zeros_like(run.readings)
    for law in laws:
        if law.candidate.id in size:
            heat = heat if law.heat is None else heat + size[law.candidate.id] * law.heat
            reading = reading if law.reading is None else reading + size[law.candidate.id] * law.reading
    changed = probe.run(grid, state, injected=heat).readings - run.readings + reading
    moved = score_test.moved(np.empty((0, score_test.sites, score_test.b)), np.empty(0))
    amount: Array = changed + probe.sensitivities(grid, state) @ moved
    return amount
