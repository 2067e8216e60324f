"""A twin's healthy record: what it says of the noise, of the tunables and of what the twin's structure leaves."""

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
from twin.discovery.records.grid import Grid, on_grid
from twin.discovery.records.noise import Noise
from twin.discovery.scoring.score_tests import ScoreTest
from twin.discovery.scoring.structure import Structure, structure_of
from twin.gauss_newton import GaussianPrior
from twin.network import Array, Network, TwinFileError

if TYPE_CHECKING:
    from twin.discovery.healthy.basis import Columns

WIDEN = 1.0
"""Factor on the variance that commissioning quotes for the tunables, which what its residual is like has widened."""
HELD = 1.0e9
"""Precision of tunables that are held where they are."""
FORETOLD = 0.5
"""Share of what the structure amounts to that is thought to come back as it was; the rest is noise."""
UNHEALTHY, AS_LEFT = 6.0, 1.5
"""Times the noise of a thermometer that a healthy record's residual may reach, or what the twin left when it was
commissioned, where that is more: a rig of which a lumped twin tells no more is no less healthy for it."""


class NotHealthyError(TwinFileError):
    """The record that is said to be healthy is not, or not of this twin; the message is about that record."""


@dataclass(frozen=True)
class Health:
    """What a healthy record says: noise as it is, `less` of it where the structure is known, and the rest.

    `itself` is the record for further questions; `rough` says what the twin leaves of it, where that is far more than
    noise, else "".
    """

    grid: Grid
    noise: Noise
    less: Noise
    prior: GaussianPrior
    structure: Structure
    itself: HealthyResidual
    rough: str = ""

    @classmethod
    def of(cls, network: Network, probe: Probe, book: Book, healthy: Columns) -> Health:
        """Read a healthy record with a twin that was commissioned on it.

        Raises:
            NotHealthyError: the record does not fit the twin.
        """
        grid = on_grid(network, healthy.time_s, healthy.inputs, healthy.measured)
        state, run, residual, good = free_run(probe, grid)
        known = np.where(good, residual, np.nan)
        rms = np.sqrt((np.where(good, residual, 0.0) ** 2).sum(axis=0) / np.maximum(good.sum(axis=0), 1))
        rough = _rough(network, rms)
        prior = posterior(network, probe, grid, state, variance_inflation(known, grid.sigma), WIDEN)
        noise = noises.learn(residual, grid.sigma, grid.step_s, run.readings)
        laws, held = book.laws(grid, run), _held(prior, probe.q)
        here = offsets(network, laws, grid)
        structure = structure_of(ScoreTest(probe, grid, state, run, noise, held), laws, here)
        amount = _readings(structure, probe, grid, state, run, noise, held, [*laws, *here])
        less = noises.learn(residual - FORETOLD * amount, grid.sigma, grid.step_s, run.readings)
        structure = structure_of(ScoreTest(probe, grid, state, run, less, held), laws, here)
        return cls(grid, noise, less, prior, structure, HealthyResidual(probe, book, grid, state, run, noise), rough)


def _rough(network: Network, rms: Array) -> str:
    """What is to say of a twin that leaves so much (m,), K, of its healthy record; "" where it is of a size with noise.

    Raises:
        NotHealthyError: it is more than the twin left when it was commissioned.
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
    """The prior with its q tunables held.

    What tunables and structure can both take up is told by their sum; with each of the two as open as the other leaves
    it, the sum would be open as well, and a later record's effect lost in it.
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
    """What a structure, and the tunables with it, amount to in the readings (n, m), K."""
    score_test = ScoreTest(probe, grid, state, run, noise, prior, structure, laws)
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
