"""Score tests of all candidates on one residual, as one quadratic form.

The record is divided into blocks. The response of every sensor to heat in every node during every block is whitened,
and tunables and initial state are projected out, with their commissioned distribution as prior. The result gives a Gram
matrix G, and with the residual a score vector g. A candidate of any law, time course and onset is a vector p of heat
(or of offset of a sensor) per place and block. Its score is z = p'g / sqrt(p'Gp) and its size p'g / p'Gp, so that any
number of candidates is tested without another simulation.

Source: score (Lagrange multiplier) test of Rao, Proc. Camb. Phil. Soc. 44 (1948) 50. The projection prevents that an
effect explains misfit that re-tuning removes (Plumlee, J. Am. Stat. Assoc. 112 (2017) 1274).
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import block_diag

from twin.discovery.effects.laws import CandidateLaw
from twin.discovery.effects.probe import FreeRun, Probe
from twin.discovery.records.grid import Grid, filled
from twin.discovery.records.noise import Noise, bands
from twin.gauss_newton import GaussianPrior
from twin.network import Array, TwinFileError

if TYPE_CHECKING:
    from twin.discovery.scoring.structure import Structure

MOST_BLOCKS = 240
LEAST_BLOCK_BINS = 6
FORGOTTEN = 0.05
ANCHOR = 6
"""Blocks on either side of a gap whose mean is an end point of its interpolation."""
MOST_SIMULATED = 64
"""Responses to the unknown times of input changes that are simulated, the largest ones."""
NARROW = 0.03
"""Standard deviations of noise along a direction below which the uncertainty of the known structure is negligible."""


def block_edges(bins: int, most: int = MOST_BLOCKS) -> np.ndarray:
    """Return the bins (b + 1,) at which blocks begin, of equal length within a bin."""
    blocks = max(min(most, bins // LEAST_BLOCK_BINS), 2)
    edges: np.ndarray = np.linspace(0, bins, blocks + 1).round().astype(np.intp)
    return edges


def narrowed(whitened: Array, opened: tuple[Array, Array]) -> Array:
    """Return whitened values (r, ...), also whitened for the structure's uncertainty.

    It lies along orthonormal directions (r, d), whose components shrink by the factors 1 - less (d,).
    """
    directions, less = opened
    flat = whitened.reshape(len(whitened), -1)
    out: Array = (flat - directions @ (less[:, None] * (directions.T @ flat))).reshape(whitened.shape)
    return out


def repeated(prior: GaussianPrior, q: int, segments: int) -> GaussianPrior:
    """Return a prior of [tunables z (q,), state] with the state's part repeated for each of several segments."""
    if segments == 1:
        return prior
    state = prior.precision[q:, q:]
    precision = block_diag(prior.precision[:q, :q], *[state] * segments)
    return GaussianPrior(np.concatenate([prior.mean[:q], np.tile(prior.mean[q:], segments)]), precision)


@dataclass(frozen=True)
class UsualErrors:
    """Errors of a record that are no effect, beside noise.

    Attributes:
        structure: model error present throughout, by its amplitudes of the `laws` on this record. Its mean is
            subtracted from the residual, and its uncertainty is noise. None if it is unknown.
        by_times: (c, n, k) W, heat by one standard deviation of the times at which each input changes, which is noise
            too; each change has its own. None if the times are known.
        after_changes: (n, m) K, standard deviation of errors after fast changes (`ChangeErrors`), which are noise too,
            each block's its own. None if there are none.
    """

    structure: Structure | None = None
    laws: Sequence[CandidateLaw] = ()
    by_times: Array | None = None
    after_changes: Array | None = None


@dataclass(frozen=True)
class JointEstimate:
    """Joint estimate of several effects.

    Attributes:
        sizes: (e,) in the candidates' units. covariance: (e, e). gain: fall of the weighted squares.
    """

    sizes: Array
    covariance: Array
    gain: float


class ScoreTest:
    """Score tests of candidates on one record: Gram matrix, score and residual.

    Args:
        noise: of a healthy residual, which is scaled to the variation of this run.
        prior: of [tunables z, initial state].
        usual: errors beside noise, which are no effect.

    Raises:
        TwinFileError: heat in the twin's nodes moves no reading, or its effect is not finite.

    Attributes:
        edges, hours: block edges, bins, and their beginnings, h from the record's. b, sites: numbers of blocks and of
            places, which are the k nodes and then the m sensors. begins: first whole block of each segment.
        total: weighted squares of the current run, and of its tunables against their prior.
        expected: misfit per block and sensor of noise alone.
        slopes: (b * m, q + s * k) whitened derivatives in tunables and the initial state of each segment.
        residual: (b * m,) whitened, of the current run.
        memory: blocks after which the response to a block of heat has decayed to a twentieth.
        gram: (sites * b, sites * b), the same for every run. score: (sites * b,). misfit: `total` less the part that
            tunables and initial state can still explain, to first order.
        memo: cached results of a search from `gram`.
    """

    def __init__(
        self,
        probe: Probe,
        grid: Grid,
        state: Array,
        run: FreeRun,
        noise: Noise,
        prior: GaussianPrior,
        usual: UsualErrors | None = None,
    ) -> None:
        self.probe, self.grid, self.prior = probe, grid, repeated(prior, probe.q, len(grid.begins))
        self.noise = noise.where_moved(run.readings, grid.step_s, grid.resolution)
        self.edges = block_edges(len(grid.time))
        self.b, self.k, self.m = len(self.edges) - 1, probe.k, probe.m
        self.sites = self.k + self.m
        self.step_s = grid.span_s / self.b
        self.present = np.isfinite(grid.measured)
        self.known = np.add.reduceat(self.present, self.edges[:-1], axis=0) >= 0.3 * np.diff(self.edges)[:, None]
        # A block that is begun anew in its midst has a mean of two segments.
        amid = [b for b in grid.begins[1:] if b not in self.edges]
        self.known[np.searchsorted(self.edges, amid) - 1] = False
        self.begins = tuple(int(b) for b in np.searchsorted(self.edges[:-1], grid.begins))
        self._seen = np.maximum(np.add.reduceat(self.present, self.edges[:-1], axis=0, dtype=np.intp), 1)
        self._measured = self.seen(grid.measured)
        heat = probe.blocks(grid, state, self.edges)
        # From the beginning of the longest segment, since nothing is remembered beyond a segment's end.
        longest = max(grid.segments, key=lambda rows: rows.stop - rows.start)
        begun = int(np.searchsorted(self.edges[:-1], longest.start))
        after = np.abs(heat[begun:, :, min(begun, self.b - 1), :]).sum(axis=(1, 2))
        if not np.isfinite(after).all() or not after.any():
            raise TwinFileError(
                "the twin's readings do not follow heat in any node, or not finitely; check the record's inputs and "
                "the twin's parameters for values that no rig has"
            )
        self.memory = int(np.flatnonzero(after > FORGOTTEN * after.max())[-1]) + 1
        onto = np.eye(self.b * self.m).reshape(self.b, self.m, self.b, self.m)
        # Columns go place by place, blocks within a place.
        columns = np.concatenate([heat, onto], axis=3).transpose(0, 1, 3, 2).reshape(self.b, self.m, -1)
        self._columns = self._white(filled(columns, self.known, ANCHOR)).reshape(self.b * self.m, -1)
        self._open: tuple[Array, Array] | None = None
        sensitivities = self.seen(np.moveaxis(probe.sensitivities(grid, state), 2, 0))
        self.slopes = self.features(np.moveaxis(sensitivities, 0, 2))
        usual = usual or UsualErrors()
        spread = [] if usual.by_times is None else [self._by_times(usual.by_times, run, state)]
        spread += [] if usual.after_changes is None else [self._after_changes(usual.after_changes)]
        self._open, self._less = self._left_by(usual.structure, usual.laws, spread)
        self._columns, self.slopes = self._narrowed(self._columns), self._narrowed(self.slopes)
        self._normal = self.slopes.T @ self.slopes + self.prior.precision
        cross = self.slopes.T @ self._columns
        self._taken = np.linalg.solve(self._normal, cross)
        self.memo: dict[Hashable, Any] = {}
        self.count = int(self.known.sum())
        self.expected = float(np.mean(self.noise.expected[bands(self.b, self.step_s)]))
        self.look_at(run)

    @property
    def gram(self) -> Array:
        """Return the Gram matrix, computed on first request: a score test that only weights fits needs none."""
        known: Array | None = self.memo.get("gram")
        if known is None:
            cross = self.slopes.T @ self._columns
            known = self.memo["gram"] = self._columns.T @ self._columns - cross.T @ self._taken
        return known

    def _means(self, values: Array) -> Array:
        """Return block means (b, ...) of values (n, ...)."""
        lengths = np.diff(self.edges).reshape(-1, *([1] * (values.ndim - 1)))
        means: Array = np.add.reduceat(values, self.edges[:-1], axis=0) / lengths
        return means

    def seen(self, values: Array) -> Array:
        """Return means (..., b, m) of values (..., n, m) over bins with a reading; 0 for a block without one."""
        there = values if self.present.all() else np.where(self.present, values, 0.0)
        means: Array = np.add.reduceat(there, self.edges[:-1], axis=-2) / self._seen
        return means

    def _white(self, values: Array) -> Array:
        return self.noise.whiten(values, self.step_s)

    def block_means(self, values: Array) -> Array:
        """Return block means (b, ...) of a series (n, ...) with NaN; NaN for a block without any value."""
        good = np.isfinite(values)
        count = np.add.reduceat(good, self.edges[:-1], axis=0)
        total = np.add.reduceat(np.where(good, values, 0.0), self.edges[:-1], axis=0)
        means: Array = np.where(count > 0, total / np.maximum(count, 1), np.nan)
        return means

    def left_over(self, vectors: Array, sizes: Array, moved: Array) -> Array:
        """Return block means (b, m), K, of the residual after effects of these sizes and a change of the tunables."""
        left = self.residual - self.slopes @ moved
        for vector, size in zip(vectors, sizes, strict=True):
            left = left - self._columns @ vector.ravel() * size
        return self.noise.colour(left.reshape(self.b, self.m), self.step_s)

    def features(self, means: Array) -> Array:
        """Return whitened values (b * m, ...) of block means (b, m, ...) by `seen`, of a residual or of signatures.

        Blocks without a reading are interpolated.
        """
        white = self._white(filled(means, self.known, ANCHOR))
        return self._narrowed(white.reshape(self.b * self.m, *means.shape[2:]))

    def residuals_of(self, readings: Array) -> Array:
        """Return whitened residuals (P, b * m): measured less `readings` (P, n, m), and less the known structure."""
        left = self.features(np.moveaxis(self._measured - self.seen(readings), 0, 2))
        return np.ascontiguousarray(left.T) - self._less

    def _left_by(
        self, structure: Structure | None, laws: Sequence[CandidateLaw], others: Sequence[Array]
    ) -> tuple[tuple[Array, Array] | None, Array]:
        """Return the uncertain directions of a structure and of `others`, their shrinkage, and the structure's mean.

        `others` are whitened responses (b * m, r) to one standard deviation each. Returned are orthonormal whitened
        directions (b * m, r), the shares (r,) by which their components shrink, and the structure's mean (b * m,),
        shrunk likewise; None in place of directions if there are none.
        """
        known = {law.candidate.id: law for law in laws}
        here = [] if structure is None else [i for i, c in enumerate(structure.candidates) if c.id in known]
        spread = np.hstack([np.zeros((self.b * self.m, 0)), *others])
        mean = np.zeros(self.b * self.m)
        if structure is not None and here:
            vectors = np.stack([self.vector(known[structure.candidates[i].id]) for i in here])
            signatures = self.signatures(vectors) + self.slopes[:, : self.probe.q] @ structure.moved(here, self.probe.q)
            values, axes = np.linalg.eigh(structure.covariance[np.ix_(here, here)])
            spread = np.hstack([spread, signatures @ (axes * np.sqrt(np.maximum(values, 0.0)))])
            mean = signatures @ structure.sizes[here]
        if not spread.size:
            return None, mean
        # By the eigenvectors of its square: LAPACK's divide and conquer fails on some finite matrices.
        squares, turned = np.linalg.eigh(spread.T @ spread)
        singular = np.sqrt(np.maximum(squares, 0.0))
        kept = singular > NARROW
        directions = spread @ (turned[:, kept] / singular[kept])
        opened = directions, 1.0 - 1.0 / np.sqrt(1.0 + singular[kept] ** 2)
        return opened, narrowed(mean, opened)

    def _by_times(self, heat: Array, run: FreeRun, state: Array) -> Array:
        """Return whitened responses (b * m, r) to heat (c, n, k), W, of the changes of each input in each block.

        The changes in a block are independent and warm in the same proportions, those of the strongest. Large responses
        are simulated, since heat that is spread over its block has another course.
        """
        sites = self._columns.reshape(self.b * self.m, self.sites, self.b)[:, : self.k]
        found, sources = [], []
        for of_input in heat:
            squares = (of_input**2).sum(axis=1)
            for block in np.flatnonzero(np.add.reduceat(squares, self.edges[:-1]) > 0.0):
                rows = slice(self.edges[block], self.edges[block + 1])
                strongest = rows.start + int(np.argmax(squares[rows]))
                warms = of_input[strongest] * np.sqrt(squares[rows].sum() / squares[rows].max())
                found.append(sites[:, :, block] @ warms / (rows.stop - rows.start))
                sources.append((strongest, warms))
        if not found:
            return np.zeros((self.b * self.m, 0))
        spread = np.array(found).T
        size = np.linalg.norm(spread, axis=0)
        for j in np.argsort(-size)[:MOST_SIMULATED]:
            if size[j] < 1.0:
                break
            injected = np.zeros_like(run.temperatures)
            injected[sources[j][0]] = sources[j][1]
            moved = self.probe.run(self.grid, state, injected=injected).readings - run.readings
            spread[:, j] = self.features(self.seen(moved))
        return np.asarray(spread[:, size > NARROW])

    def _after_changes(self, sd: Array) -> Array:
        """Return whitened responses (b * m, r) to errors of the readings with standard deviations (n, m), K.

        The errors in a block are alike, and those of two blocks or sensors independent. Errors below noise are left
        out.
        """
        onto = self._columns.reshape(self.b * self.m, self.sites, self.b)[:, self.k :]
        spread = (onto * np.sqrt(self._means(sd**2)).T).reshape(self.b * self.m, -1)
        return np.asarray(spread[:, np.linalg.norm(spread, axis=0) > 1.0])

    @property
    def share_of_noise(self) -> Array:
        """Return the share (b,) of each whitened coefficient's variance that is noise, not one of the `UsualErrors`."""
        if self._open is None:
            return np.ones(self.b)
        directions, less = self._open
        other = directions**2 @ (1.0 - (1.0 - less) ** 2)
        share: Array = 1.0 - other.reshape(self.b, self.m).mean(axis=1)
        return share

    def _narrowed(self, whitened: Array) -> Array:
        return whitened if self._open is None else narrowed(whitened, self._open)

    def look_at(self, run: FreeRun, moved: Array | None = None) -> None:
        """Set the residual to that of a run, whose tunables and state differ by `moved` (q + s * k,) from the prior's
        mean.
        """
        self.take(self.residuals_of(run.readings[None])[0], moved)

    def take(self, residual: Array, moved: Array | None = None) -> None:
        """Set the residual to a whitened one (b * m,); `moved` as in `look_at`."""
        self.residual = residual
        pull = self.slopes.T @ residual
        if moved is not None:
            pull = pull - self.prior.precision @ moved
        self._shift = np.linalg.solve(self._normal, pull)
        self.score = self._columns.T @ residual - self._taken.T @ pull
        self.misfit = float(residual @ residual - pull @ self._shift)
        away = 0.0 if moved is None else float(moved @ self.prior.precision @ moved)
        self.total = float(residual @ residual) + away

    @property
    def chi(self) -> float:
        """Return the misfit per block and sensor; about 1 or less for a twin as good as when it was commissioned."""
        return self.misfit / max(self.count, 1)

    @property
    def hours(self) -> Array:
        starts: Array = self.edges[:-1] * self.grid.step_s / 3600.0
        return starts

    def vector(self, law: CandidateLaw) -> Array:
        """Return the vector of a law at size 1: (sites, b)."""
        p = np.zeros((self.sites, self.b))
        if law.heat is not None:
            p[: self.k] = self._means(law.heat).T
        if law.reading is not None:
            p[self.k :] = self._means(law.reading).T
        return p

    def noise_scores(self, rng: np.random.Generator, draws: int) -> Array:
        """Return scores (sites * b, draws) of simulated records of noise alone."""
        white = rng.normal(0.0, 1.0, (self.b * self.m, draws))
        scores: Array = self._columns.T @ white - self._taken.T @ (self.slopes.T @ white)
        return scores

    def small(self, p: Array, scores: Array | None = None) -> tuple[Array, Array]:
        """Return Gram matrix (b, b) and score (b,) of one law's blocks, p (sites, b); of `scores` (sites * b, d): (b,
        d).
        """
        if scores is None:
            return self.small_gram(p), self.scored(p)
        active = np.flatnonzero(p.any(axis=1))
        drawn = scores.reshape(self.sites, self.b, -1)
        return self.small_gram(p), (drawn[active] * p[active][:, :, None]).sum(axis=0)

    def small_gram(self, p: Array) -> Array:
        """Return the Gram matrix (b, b) of one law's blocks, p (sites, b)."""
        active = np.flatnonzero(p.any(axis=1))
        sites = self.gram.reshape(self.sites, self.b, self.sites, self.b)
        gram = np.zeros((self.b, self.b))
        for k, one in enumerate(active):
            for other in active[k:]:
                part = sites[one, :, other] * p[other]
                part *= p[one][:, None]
                gram += part
                if other != one:
                    gram += part.T
        return gram

    def scored(self, p: Array) -> Array:
        """Return the score (b,) of one law's blocks, p (sites, b)."""
        score: Array = (self.score.reshape(self.sites, self.b) * p).sum(axis=0)
        return score

    def joint(self, vectors: Array) -> tuple[Array, Array]:
        """Return Gram matrix (e, e) and score (e,) of e effects, `vectors` (e, sites, b)."""
        seen = self.signatures(vectors)
        return self.across(seen), self.scores_of(seen)

    def estimate(self, vectors: Array) -> JointEstimate:
        """Estimate the sizes of e effects jointly."""
        if not len(vectors):
            return JointEstimate(np.empty(0), np.empty((0, 0)), 0.0)
        gram, score = self.joint(vectors)
        covariance: Array = np.asarray(np.linalg.pinv(gram, rcond=1e-10, hermitian=True), dtype=np.float64)
        sizes = covariance @ score
        return JointEstimate(sizes, covariance, float(sizes @ score))

    def bare(self, flat: Array) -> Array:
        """Return squared norms (e,) of signatures `flat` (e, sites * b) without projecting out the tunables."""
        squared: Array = ((self._columns @ flat.T) ** 2).sum(axis=0)
        return squared

    def signatures(self, vectors: Array) -> Array:
        """Return whitened signatures (b * m, e) of effects at size 1, `vectors` (e, sites, b), tunables not projected
        out.
        """
        found: Array = self._columns @ vectors.reshape(len(vectors), -1).T
        return found

    def seen_at(self, vector: Array, courses: Array) -> Array:
        """Return whitened signatures (b * m, c) of an effect, `vector` (sites, b), with time courses (b, c)."""
        found = np.zeros((len(self._columns), courses.shape[1]))
        for site in np.flatnonzero(vector.any(axis=1)):
            found += self._columns[:, site * self.b : (site + 1) * self.b] @ (vector[site][:, None] * courses)
        return found

    def onto(self, signatures: Array) -> Array:
        """Return products (sites * b, e) of a unit at each site and block with whitened signatures (b * m, e).

        Tunables and initial state are projected out.
        """
        found: Array = self._columns.T @ signatures - self._taken.T @ (self.slopes.T @ signatures)
        return found

    def scores_of(self, signatures: Array) -> Array:
        """Return the score (e,) of whitened signatures (b * m, e), tunables and initial state projected out."""
        score: Array = signatures.T @ (self.residual - self.slopes @ self._shift)
        return score

    def across(self, signatures: Array) -> Array:
        """Return the Gram matrix (e, e) of whitened signatures (b * m, e), tunables and initial state projected out."""
        return self.beside_tunables(signatures)[1]

    def beside_tunables(self, signatures: Array) -> tuple[Array, Array, Array]:
        """Project tunables and initial state out of whitened signatures (b * m, e).

        Returns changes (q + s * k, e) of tunables and state for a unit of each, the Gram matrix (e, e) and score (e,).
        """
        pull = self.slopes.T @ signatures
        moves = np.asarray(-np.linalg.solve(self._normal, pull), dtype=np.float64)
        gram: Array = signatures.T @ signatures + pull.T @ moves
        score: Array = signatures.T @ self.residual + moves.T @ (self.slopes.T @ self.residual)
        return moves, gram, score

    def moved(self, vectors: Array, sizes: Array) -> Array:
        """Return the change of [tunables z, initial state] (q + s * k,) that goes with effects of these sizes."""
        shift = np.array(self._shift, dtype=np.float64)
        for vector, size in zip(vectors, sizes, strict=True):
            shift -= self._taken @ vector.ravel() * size
        return shift
