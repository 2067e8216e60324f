"""Search for undeclared effects of a station's cells: scan, refit, held-out weeks, permutations.

The search sees the record without its held-out weeks. A class of effects is claimed if its posterior log odds against
no effect exceed `CLAIM`, if the refit with it predicts the held-out weeks better, and if circular shifts of its driver
do not reach its evidence.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from twin.tower.air import Array
from twin.tower.calibration import Fitted, fit_cell
from twin.tower.cell_observations import Label
from twin.tower.diagnosis.candidates import DECOYS, FAULT, FREE, EffectClass, candidates, decoys, onset_grid
from twin.tower.diagnosis.evidence import FORM_ERROR, Evidence
from twin.tower.diagnosis.validation import HeldOutBlocks, TimeSpans, held_out, held_out_parts, inside, predictive_gain
from twin.tower.effects import CellEffect, pattern, patterns
from twin.tower.estimates import Opening, Priors
from twin.tower.minutes import Minutes
from twin.tower.model import CellModel

CLAIM = 5.0
"""Posterior log odds from which an effect is claimed, if the checks below hold too: 150 to 1, very strong evidence by
Kass & Raftery 1995."""
RIVAL = 3.0
"""Log odds within which another class is a rival that the record does not exclude, a factor of 20."""
MOST_EFFECTS = 3
TRIED = 2
"""Classes that are refitted before a search gives up: the first may fail on the held-out weeks."""
SHIFTS = 199
"""Circular shifts: with 199 the least p-value is 0.005."""
LARGEST_P = 0.01
PHASES_H = tuple(float(h) for h in range(4, 21))
"""Hours from noon at which a sun would be none: an error of another time of day must have less evidence."""
REFITS = 1
LEAST_Z = 2.0
"""Standard deviations that a refitted size must be from 0."""
LEAST_GAIN = 3.0
"""Log predictive density of the held-out weeks that a refit must gain, a factor of 20."""
SEED = 20


@dataclass(frozen=True)
class CellCase:
    """A cell with what its calibration is made of; `columns` are those of its aligned record."""

    cell: int
    model: CellModel
    minutes: Minutes
    columns: Mapping[str, Array]
    priors: Priors
    labels: tuple[Label, ...]
    openings: tuple[Opening, ...]
    edges_s: Array

    def fit(self, effects: Sequence[CellEffect], held: NDArray[np.bool_]) -> Fitted:
        """Return the calibration with more effects, without the outlet readings of the held-out minutes."""
        every = (*self.model.effects, *effects)
        drivers = patterns(every, self.minutes.time_s, self.columns, self.model.design.m_w0)
        minutes = replace(
            self.minutes,
            operation=replace(self.minutes.operation, patterns=drivers),
            outlet=np.where(held, np.nan, self.minutes.outlet),
        )
        model = CellModel(self.model.design, self.model.site, every)
        return fit_cell(model, minutes, self.priors, self.labels, self.openings, self.edges_s)


@dataclass(frozen=True)
class CellHypothesis:
    """A class at some cells: posterior log odds against no effect, and its best form with sizes by cell."""

    candidate: EffectClass
    cells: tuple[int, ...]
    log_odds: float
    effects: Mapping[int, CellEffect]


@dataclass(frozen=True)
class ClaimedEffect:
    """A claimed effect: sizes by cell, evidence, p-value (None where the driver cannot be shifted), log predictive
    density that the held-out weeks gain, their errors by cell, and rivals."""

    hypothesis: CellHypothesis
    effects: Mapping[int, CellEffect]
    p_value: float | None
    held_out_gain: float
    before: Mapping[int, HeldOutBlocks]
    after: Mapping[int, HeldOutBlocks]
    rivals: tuple[CellHypothesis, ...]


@dataclass(frozen=True)
class TowerDiagnosis:
    """Result of a search.

    Attributes
    ----------
    findings
        Claimed effects, strongest first.
    rejected
        Sentence for each class that failed a check.
    leading
        Classes of the last scan, by their log odds.
    decoy
        Log odds of the best decoy in the first scan.
    held_s
        Start and end of each held-out part.
    before, after
        Errors of the outlet on them by cell.
    """

    findings: tuple[ClaimedEffect, ...]
    rejected: tuple[str, ...]
    leading: tuple[CellHypothesis, ...]
    decoy: float
    held_s: tuple[tuple[float, float], ...]
    before: Mapping[int, HeldOutBlocks]
    after: Mapping[int, HeldOutBlocks]


def search_effects(
    cases: Sequence[CellCase],
    timezone: str | None,
    jumps: Callable[[int, Fitted], tuple[Opening, ...]] = lambda cell, fitted: (),
    say: Callable[[str], None] = lambda text: None,
) -> TowerDiagnosis:
    """Return the undeclared effects of the cells of one station.

    Parameters
    ----------
    timezone
        Of the station, for the sun.
    jumps
        Those of a deviation that the first fit of a cell shows to be needed.
    say
        Called with each stage.

    Raises
    ------
    CalibrationError
        The record is too short to calibrate a cell without its held-out weeks.
    """
    parts = held_out_parts(cases[0].minutes.time_s)
    held = {c.cell: inside(c.minutes.time_s, parts) for c in cases}
    say("calibrating without the held-out weeks")
    fits = {c.cell: c.fit((), held[c.cell]) for c in cases}
    more = {c.cell: jumps(c.cell, fits[c.cell]) for c in cases}
    cases = [replace(c, openings=(*c.openings, *more[c.cell])) for c in cases]
    fits |= {c.cell: c.fit((), held[c.cell]) for c in cases if more[c.cell]}
    errors = {c.cell: held_out(fits[c.cell], c.minutes.outlet, parts) for c in cases}
    first = errors
    extra = {c.cell: decoys(c.columns, SEED + 10 * c.cell) for c in cases}
    known: dict[int, tuple[CellEffect, ...]] = {c.cell: () for c in cases}
    findings: list[ClaimedEffect] = []
    rejected: list[str] = []
    ranked: list[CellHypothesis] = []
    decoy = -np.inf
    while len(findings) < MOST_EFFECTS:
        say("comparing effects")
        evidence = {c.cell: Evidence(fits[c.cell], {**c.columns, **extra[c.cell]}) for c in cases}
        ranked = scan(cases, evidence, timezone, known)
        if not findings:
            decoy = max((one.log_odds for one in ranked if _is_decoy(one)), default=-np.inf)
        claimed = None
        for one in [h for h in ranked if h.log_odds >= CLAIM][:TRIED]:
            say(f"refitting with {one.candidate.name}")
            claimed, why, fits_new, errors_new = _checked(
                cases, parts, held, _Round(fits, errors, known, evidence, ranked), one
            )
            if claimed is not None:
                break
            rejected.append(f"{one.candidate.name}, cell {_listed(one.cells)}: {why}")
        if claimed is None:
            break
        findings.append(claimed)
        for cell, effect in claimed.effects.items():
            known[cell] = (*known[cell], effect)
        fits, errors = fits_new, errors_new
    return TowerDiagnosis(tuple(findings), tuple(rejected), tuple(ranked[:8]), float(decoy), parts, first, errors)


def scan(
    cases: Sequence[CellCase],
    evidence: Mapping[int, Evidence],
    timezone: str | None,
    known: Mapping[int, tuple[CellEffect, ...]],
) -> list[CellHypothesis]:
    """Return the classes at every cell and at each alone, by their posterior log odds, highest first."""
    time_s = cases[0].minutes.time_s
    onsets = onset_grid(float(time_s[0]), float(time_s[-1]))
    classes = {
        c.cell: {one.name: one for one in candidates(evidence[c.cell].columns, c.minutes.time_s, timezone)}
        for c in cases
    }
    names = list(dict.fromkeys(name for of in classes.values() for name in of))
    found: list[CellHypothesis] = []
    for name in names:
        tables, sizes = {}, {}
        for c in cases:
            if name not in classes[c.cell]:
                continue
            candidate = classes[c.cell][name]
            if any(_same(candidate.forms[0], one) for one in (*c.model.effects, *known[c.cell])):
                continue  # a freer form of an effect that is known is no further effect
            tables[c.cell], sizes[c.cell] = _table(evidence[c.cell], candidate, onsets)
        sites: list[tuple[int, ...]] = [(cell,) for cell in tables]
        if len(tables) == len(cases) > 1 and len({t.shape for t in tables.values()}) == 1:
            sites.append(tuple(tables))
        for site in sites:
            candidate = classes[site[0]][name]
            table = np.sum([tables[cell] for cell in site], axis=0)
            prior = np.log(FAULT / (1.0 - FAULT))
            prior += np.log(FREE) if candidate.sign == 0 else np.log((1.0 - FREE) / max(len(names) - 1, 1))
            if len(cases) > 1:
                prior += np.log(0.5) if len(site) > 1 else np.log(0.5 / len(cases))
            found += _hypotheses(candidate, site, table, sizes, onsets, float(prior))
    return sorted(found, key=lambda one: -one.log_odds)


def _table(evidence: Evidence, candidate: EffectClass, onsets: Sequence[float]) -> tuple[Array, Array]:
    """Return log Bayes factors and sizes of the forms by onset (1 + onsets, m); the first row is all along."""
    h = evidence.responses(candidate.forms)
    rows, sizes = [], []
    for onset in (None, *onsets):
        part = h if onset is None else h * (evidence.fitted.blocks.time_s >= onset)[:, None]
        scored = evidence.score(part, candidate.size_sd, candidate.sign)
        rows.append(scored.gain)
        sizes.append(scored.size)
    return np.array(rows), np.array(sizes)


def _hypotheses(
    candidate: EffectClass,
    site: tuple[int, ...],
    table: Array,
    sizes: Mapping[int, Array],
    onsets: Sequence[float],
    prior: float,
) -> list[CellHypothesis]:
    """Return a class at some cells, its forms and onsets marginalised; decoys of a free class apart."""
    weight = np.full(table.shape, -np.log(table.shape[1]))
    weight[0] += np.log(0.5)
    weight[1:] += np.log(0.5 / len(onsets))
    decoy = np.array([one.column in DECOYS for one in candidate.forms])
    found = []
    for rows in (~decoy, decoy):
        if not rows.any():
            continue
        joint = np.where(rows, table + weight, -np.inf)
        row, m = np.unravel_index(int(joint.argmax()), joint.shape)
        onset = None if row == 0 else onsets[int(row) - 1]
        effects = {
            cell: replace(candidate.forms[int(m)], onset_s=onset, size=float(sizes[cell][row, m])) for cell in site
        }
        found.append(CellHypothesis(candidate, site, prior + float(logsumexp(joint)), effects))
    return found


class _Round(NamedTuple):
    """One round of a search: fits, errors, effects and evidence so far by cell, and the classes of its scan."""

    fits: Mapping[int, Fitted]
    errors: Mapping[int, HeldOutBlocks]
    known: Mapping[int, tuple[CellEffect, ...]]
    evidence: Mapping[int, Evidence]
    ranked: Sequence[CellHypothesis]


def _checked(
    cases: Sequence[CellCase],
    parts: TimeSpans,
    held: Mapping[int, NDArray[np.bool_]],
    so_far: _Round,
    one: CellHypothesis,
) -> tuple[ClaimedEffect | None, str, dict[int, Fitted], dict[int, HeldOutBlocks]]:
    """Return the finding, or None and the reason, with fits and errors that include it."""
    fits, errors, known, evidence, ranked = so_far
    new_fits, new_errors = dict(fits), dict(errors)
    if _is_decoy(one):
        return None, "it is a decoy, so chance reaches this far", new_fits, new_errors
    refitted = {}
    for c in cases:
        if c.cell in one.cells:
            refitted[c.cell], new_fits[c.cell] = _refit(c, known[c.cell], one, held[c.cell])
            new_errors[c.cell] = held_out(new_fits[c.cell], c.minutes.outlet, parts)
    refitted = {cell: e for cell, e in refitted.items() if _lasts(e, one.candidate.sign)}
    if not refitted:
        return None, "the refit leaves nothing of it", dict(fits), dict(errors)
    for cell in set(one.cells) - set(refitted):
        new_fits[cell], new_errors[cell] = fits[cell], errors[cell]
    gained = sum(predictive_gain(fits[cell], errors[cell], new_errors[cell]) for cell in refitted)
    if gained < LEAST_GAIN:
        why = f"the held-out weeks are predicted no better with it, log predictive density {gained:+.1f}"
        return None, why, dict(fits), dict(errors)
    p = p_value(evidence, one)
    least = 1.0 / (len(PHASES_H) + 1) if one.candidate.forms[0].driver == "solar" else LARGEST_P
    if p is not None and p > least:
        return None, f"circular shifts of its driver reach its evidence, p = {p:.3f}", dict(fits), dict(errors)
    before, after = ({cell: e[cell] for cell in refitted} for e in (errors, new_errors))
    rivals = tuple(
        r
        for r in ranked
        if r.log_odds > one.log_odds - RIVAL and r.candidate.name != one.candidate.name and not _is_decoy(r)
    )
    return ClaimedEffect(one, refitted, p, gained, before, after, rivals), "", new_fits, new_errors


def _refit(
    case: CellCase, known: tuple[CellEffect, ...], one: CellHypothesis, held: NDArray[np.bool_]
) -> tuple[CellEffect, Fitted]:
    """Return an effect refitted as part of the cell's own physics: Gauss-Newton on size and form, all else
    marginalised."""
    effect = one.effects[case.cell]
    fitted = case.fit((*known, effect), held)
    for step in range(REFITS):
        evidence = Evidence(fitted, case.columns)
        forms = _near(effect, one.candidate, step)
        h = evidence.responses(forms)
        own = evidence.responses((effect,))[:, 0]
        offset = effect.size * (h.T @ evidence.solve(own[:, None])[:, 0])
        scored = evidence.score(h, np.full(len(forms), float(one.candidate.size_sd[0])), one.candidate.sign, offset)
        best = int(scored.gain.argmax())
        size = float(scored.size[best])
        # The law of an effect is simpler than the effect, and no reading shows that error of its size.
        effect = replace(forms[best], size=size, sd=float(np.hypot(scored.sd[best], FORM_ERROR * size)))
        fitted = case.fit((*known, effect), held)
    return effect, fitted


def _near(effect: CellEffect, candidate: EffectClass, step: int) -> tuple[CellEffect, ...]:
    """Return forms near an effect's, ever nearer."""
    if effect.form is None or len(candidate.forms) < 2:
        return (effect,)
    values = sorted({float(one.form or 0.0) for one in candidate.forms})
    width = min(np.diff(values)) * (1.0 if step == 0 else 0.3)
    shifts = np.linspace(-width, width, 9)
    if effect.driver == "wind_direction":
        return tuple(replace(effect, form=float((effect.form + s) % 360.0)) for s in shifts)
    return tuple(replace(effect, form=float(effect.form + s)) for s in shifts)


def p_value(evidence: Mapping[int, Evidence], one: CellHypothesis) -> float | None:
    """Return the share of circular shifts of the driver whose best form reaches the evidence of the class.

    A sun is moved to other hours of the day instead, so that 1/18 is its least value. None for what is always there,
    which a shift leaves as it is.
    """
    first = one.candidate.forms[0]
    chosen = next(iter(one.effects.values()))
    if first.driver == "always":
        return None
    if first.driver == "solar":
        moved = [replace(chosen, form=(float(chosen.form or 0.0) + h) % 24.0) for h in (0.0, *PHASES_H)]
        sd = np.full(len(moved), float(one.candidate.size_sd[0]))
        scores = [evidence[cell].score(evidence[cell].responses(moved), sd, one.candidate.sign) for cell in one.cells]
        gains = np.sum([found.gain for found in scores], axis=0)
        return float((1 + np.sum(gains[1:] >= gains[0])) / len(moved))
    forms = [f for f in one.candidate.forms if f.path == chosen.path and f.column == chosen.column]
    forms = forms[:: max(len(forms) // 12, 1)]
    onset = chosen.onset_s
    total = np.zeros((SHIFTS + 1, len(forms)))
    for cell in one.cells:
        e = evidence[cell]
        f, n = e.fitted, len(e.fitted.minutes.time_s)
        rng = np.random.default_rng(SEED)
        shifts = np.concatenate([[0], rng.integers(n // 20, n - n // 20, SHIFTS)])
        drivers = [pattern(form, f.minutes.time_s, e.columns, f.model.design.m_w0) for form in forms]
        slope = e.sensitivity(chosen.path)
        since = np.ones(len(slope)) if onset is None else (f.blocks.time_s >= onset).astype(float)
        sd = np.full(len(forms), float(one.candidate.size_sd[one.candidate.forms.index(forms[0])]))
        for k, shift in enumerate(shifts):
            h = np.stack([slope * since * e.block_means(np.roll(g, shift)) for g in drivers], axis=1)
            total[k] += e.score(h, sd, one.candidate.sign).gain
    best = total.max(axis=1)
    return float((1 + np.sum(best[1:] >= best[0])) / (SHIFTS + 1))


def _lasts(effect: CellEffect, sign: int) -> bool:
    """Return True if a refitted size is well away from 0, on the side that physics allows."""
    return (sign == 0 or sign * effect.size > 0.0) and abs(effect.size) > LEAST_Z * effect.sd


def _same(form: CellEffect, known: CellEffect) -> bool:
    """Return True if a class has the path and the driver of an effect, so that it is another form of it."""
    wind = {"wind_direction", "wind_speed"}
    return form.path == known.path and (form.driver == known.driver or {form.driver, known.driver} <= wind)


def _is_decoy(one: CellHypothesis) -> bool:
    return next(iter(one.effects.values())).column in DECOYS


def _listed(cells: Sequence[int]) -> str:
    return ", ".join(str(cell) for cell in cells)
