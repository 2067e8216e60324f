"""The diagnosis from end to end: residual, contest, fit, verdict, errors on data that the fit never saw."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from twin.commission import inflation, weak_prior
from twin.discovery import noise as noises
from twin.discovery.contest import Contest
from twin.discovery.diagnosis import Diagnosis, Fold, Rung, SensorError
from twin.discovery.equivalence import width
from twin.discovery.experiment import Limits
from twin.discovery.fitting import Fit, fit
from twin.discovery.forecast import Forecast, forecast, plan_of, too_little, unseen_kinds
from twin.discovery.grid import Grid, bridged, filled, on_grid
from twin.discovery.laws import Book, Law
from twin.discovery.members import Members, members
from twin.discovery.model import Model
from twin.discovery.null import FALSE_ALARMS, Null, null_scores
from twin.discovery.probe import Probe, Run, posterior
from twin.discovery.ranking import Finding, Ranked, enough, piled_up, rank
from twin.discovery.readings import Stuck, stuck
from twin.discovery.search import Entry, Structure, possible, refine, scan, structure_of, together
from twin.discovery.thermometers import explained_by_one
from twin.discovery.validation import validate
from twin.discovery.verdict import conclude
from twin.discovery.weighing import weigh
from twin.gauss_newton import Prior
from twin.network import Array, Network, TwinFileError
from twin.steady import steady_state

HELD_OUT = 0.25
WIDEN = 4.0
"""Factor on the variance that commissioning quotes for the tunables: what it quotes is of one record."""
LATE = 0.85
"""Share of the part that a fit sees, beyond which an onset leaves it too little of what follows."""
FINALISTS = 8
SECOND_SHARE = 0.06
"""A further effect must win this share of the first one's gain: a large effect is never of quite the form assumed."""
UNHEALTHY = 6.0
"""Times the noise of a bin that a healthy record's residual may reach."""
MOST_EFFECTS = 3
MORE_LEFT, MORE_SHARE = 4.0, 0.1
"""Misfit that the answer may leave in a later record, over what noise alone leaves, or of what there was: its steps
are harsher than those that the noise was learned from."""
PAIRED = 8
"""Single effects that are tried as one of a pair."""


@dataclass(frozen=True)
class Columns:
    """A record as a network sees it: time (N,) s, inputs (N, c), measured (N, m) degC.

    `members` holds the single thermometers (N, c) of every sensor that is the mean of several.
    """

    time_s: Array
    inputs: Array
    measured: Array
    members: Mapping[str, Array] = field(default_factory=dict)

    @classmethod
    def of(cls, network: Network, time_s: ArrayLike, columns: Mapping[str, ArrayLike]) -> Columns:
        """Select a network's columns; raises TwinFileError where some are missing."""
        inputs, measured = network.select(columns)
        single = {
            s.name: np.column_stack([np.asarray(columns[c], dtype=np.float64) for c in s.measured])
            for s in network.sensors
            if len(s.measured) > 1 and all(c in columns for c in s.measured)
        }
        return cls(np.asarray(time_s, dtype=np.float64), inputs, measured, single)


@dataclass(frozen=True)
class Basis:
    """What is known before the record is looked at; `tried` (2, c) are the lowest and highest inputs, but for short
    moments, of the healthy record, or of the record where there is none."""

    probe: Probe
    book: Book
    noise: noises.Noise
    prior: Prior
    warnings: tuple[str, ...]
    tried: Array
    structure: Mapping[str, Structure] = field(default_factory=dict)


def basis(network: Network, healthy: Columns | None, record: Grid) -> Basis:
    """Noise and prior from a healthy record, or from the record itself.

    Raises:
        TwinFileError: the healthy record does not fit the twin.
    """
    ids = network.tunables("commission" if "commission" in network.sets else None)
    if not ids:
        raise TwinFileError(f"twin {network.name!r} has no tunables; set the status of at least one parameter")
    probe, book = Probe(network, ids), Book(network)
    if healthy is not None:
        grid = on_grid(network, healthy.time_s, healthy.inputs, healthy.measured)
        state, run, residual, good = _free_run(probe, grid)
        rms = np.sqrt(np.nanmean(np.where(good, residual, np.nan) ** 2, axis=0))
        raw = network.sigma
        worst = int(np.nanargmax(rms / raw))
        if rms[worst] > UNHEALTHY * raw[worst]:
            raise TwinFileError(
                f"the healthy record does not fit the twin: {network.sensor_names[worst]} is off by {rms[worst]:.2f} K "
                f"(noise {raw[worst]:.2f} K); commission the twin on this record first, or give one that is healthy"
            )
        known = posterior(network, probe, grid, state, inflation(np.where(good, residual, np.nan), grid.sigma), WIDEN)
        learned = noises.learn(residual, grid.sigma, grid.step_s, run.readings)
        known_structure = structure_of(Contest(probe, grid, state, run, learned, known), book.laws(grid, run))
        if learned.step_s != record.step_s:
            learned = learned.at_step(record.step_s)
        return Basis(probe, book, learned, known, (), _tried(grid), known_structure)
    state, _, residual, good = _free_run(probe, record)
    prior = weak_prior(probe.scaling, network.values[probe.scaling.index], state, 0.3)
    learned = noises.learn(residual, record.sigma, record.step_s)
    warning = (
        "no healthy record was given: the noise floor is taken from this record itself, so small effects are not seen "
        "and parameters are trusted less; give --healthy for a sharper answer"
    )
    own = _from_itself(probe, book, record, state, learned, prior)
    return Basis(probe, book, own, prior, (warning,), _tried(record))


def _tried(grid: Grid) -> Array:
    tried: Array = np.percentile(grid.inputs, (2.0, 98.0), axis=0)
    return tried


def _from_itself(probe: Probe, book: Book, grid: Grid, state: Array, noise: noises.Noise, prior: Prior) -> noises.Noise:
    """Noise of what is left after the best three hypotheses have taken what they can, twice."""
    run = probe.run(grid, state)
    candidates = book.laws(grid, run)
    for _ in range(2):
        contest = Contest(probe, grid, state, run, noise, prior)
        chosen: list[Array] = []
        for _ in range(3):
            found = scan(contest, candidates, np.stack(chosen) if chosen else None)
            if not found or found[0].z < 3.0:
                break
            chosen.append(found[0].vector)
        sizes = contest.estimate(np.stack(chosen) if chosen else np.empty((0, contest.sites, contest.b))).sizes
        moved = contest.moved(np.array(chosen), sizes)
        left = contest.left_over(np.array(chosen), sizes, moved)
        noise = noises.learn_blocks(left, grid.sigma, contest.step_s, grid.step_s, noise)
    return noise


def _free_run(probe: Probe, grid: Grid) -> tuple[Array, Run, Array, np.ndarray]:
    state = probe.first_state(grid)
    run = probe.run(grid, state)
    off = grid.measured - run.readings
    good = np.isfinite(off)
    return state, run, filled(off, good), good


def diagnose(
    network: Network,
    record: Columns,
    healthy: Columns | None = None,
    *,
    more: tuple[Columns, ...] = (),
    say: Callable[[str], None] = lambda _: None,
    held_out: float = HELD_OUT,
    limits: Limits | None = None,
) -> Diagnosis:
    """Trace the residual of a record to an effect that the twin lacks, or say that there is none, or that none fits.

    Args:
        network: the commissioned twin. healthy: the record that it was commissioned on.
        more: records made later on the same rig, by which causes that this record cannot tell apart are weighed.
        say: called with what is being done. held_out: share of the record, at its end, that no fit sees.
        limits: of the rig, for the next experiment; by default it stays within what the record has seen.

    Raises:
        TwinFileError: a record too short or without readings, a healthy record that is not healthy.
    """
    say("reading")
    record, still = _without_stuck(network, record)
    grid = on_grid(network, record.time_s, record.inputs, record.measured)
    known = basis(network, healthy, grid)
    say("scanning")
    bins = len(grid.time)
    split = int(bins * (1.0 - held_out))
    train = _Part.of(known, grid.part(0, split))
    whole = _Part.of(known, grid)
    notes: list[str] = []
    finding: Finding | None = None
    if not _begins_late(whole, train, split):
        finding = _search(train, say)
    if finding is None or (finding.fit is None and whole.best_z >= train.threshold):
        top = whole.entries[0]
        onset = int(top.shape.onset_s / grid.step_s)
        later = min(max(split, (onset + bins) // 2), bins - 6)
        if later > split:
            split = later
            notes.append(
                f"something changed at {top.shape.onset_s / 3600.0:.1f} h, inside the part that was to be kept out of "
                f"the fit; the fit was given the record up to {split * grid.step_s / 3600.0:.1f} h"
            )
            train = _Part.of(known, grid.part(0, split))
            finding = None
    finding = finding or _search(train, say)
    if more and len(finding.ranked) > 1:
        say("comparing with further records")
        further = [_Part.of(known, on_grid(network, r.time_s, r.inputs, r.measured)) for r in more]
        finding, said = _weighed(finding, train, further)
        notes += said
    if finding.fit is None:
        poor = too_little(whole.contest, whole.laws, known.book.candidates)
        if poor:
            raise TwinFileError(poor)
        unseen = unseen_kinds(whole.contest, whole.laws, known.book.candidates)
        notes += [f"this record could not have shown any {' or '.join(unseen)}"] if unseen else []
    say("judging")
    single = _members(network, record, grid, healthy, whole.contest.edges)
    found = conclude(
        finding,
        network=network,
        known=known,
        whole=whole.contest,
        laws=whole.laws,
        grid=grid,
        split=split,
        errors=_errors(finding, network, record, grid, split),
        notes=tuple(notes),
        single=single,
        still=still,
        limits=limits,
    )

    def again(other: Columns) -> Diagnosis:
        return diagnose(network, other, healthy, more=more, say=say, held_out=held_out, limits=limits)

    return explained_by_one(found, network, record, single, again)


def _begins_late(whole: _Part, train: _Part, split: int) -> bool:
    """Whether what stands out in the whole record begins in the part that no fit was to see."""
    if not whole.entries or whole.best_z < train.threshold:
        return False
    late = whole.entries[0].shape.onset_s > LATE * split * whole.grid.step_s
    return train.best_z < train.threshold or (late and whole.best_z > 1.5 * train.best_z)


def _without_stuck(network: Network, record: Columns) -> tuple[Columns, tuple[Stuck, ...]]:
    """The record without the readings of thermometers that stand still, and what was taken out."""
    found: list[Stuck] = []
    measured = record.measured.copy()
    members = {name: each.copy() for name, each in record.members.items()}
    for j, sensor in enumerate(network.sensors):
        sigma = network.parameters[f"{sensor.name}.sigma"].value
        each = members.get(sensor.name)
        columns = measured[:, j : j + 1] if each is None else each
        names = sensor.measured if each is not None else sensor.measured[:1]
        spans = [s for i, name in enumerate(names) for s in stuck(name, record.time_s, columns[:, i], sigma)]
        for span in spans:
            columns[span.rows, names.index(span.column)] = np.nan
        if spans and each is not None:
            good = np.isfinite(each)
            total = np.where(good, each, 0.0).sum(axis=1)
            measured[:, j] = np.where(good.any(axis=1), total / np.maximum(good.sum(axis=1), 1), np.nan)
        found += spans
    return replace(record, measured=measured, members=members), tuple(found)


def _members(
    network: Network, record: Columns, grid: Grid, healthy: Columns | None, edges: np.ndarray
) -> tuple[Members, ...]:
    if healthy is None or not record.members:
        return ()
    known = on_grid(network, healthy.time_s, healthy.inputs, healthy.measured)

    def means(columns: Columns, on: Grid) -> dict[str, Array]:
        return {
            name: np.column_stack([_binned(one, columns.time_s, on) for one in each.T])
            for name, each in columns.members.items()
        }

    return members(network, means(record, grid), grid, means(healthy, known), known, edges)


def foresee(network: Network, record: Columns, healthy: Columns | None = None) -> Forecast:
    """What a record with these inputs could show; of its readings only the first ones are looked at.

    Raises:
        TwinFileError: as `diagnose`.
    """
    grid = on_grid(network, record.time_s, record.inputs, record.measured)
    known = basis(network, healthy, grid)
    return forecast(known.probe, known.book, known.noise, known.prior, grid)


def foresee_plan(network: Network, time: Array, inputs: Array, healthy: Columns) -> Forecast:
    """What a record of a planned profile could show, begun at rest under its first load.

    Args:
        time: (n,) s, evenly spaced. inputs: (n, c). healthy: the record that the twin was commissioned on, for noise.

    Raises:
        TwinFileError: as `basis`.
    """
    grid = plan_of(network, time, inputs)
    known = basis(network, healthy, grid)
    rest = steady_state(network, inputs[0]).reshape(-1)
    return forecast(known.probe, known.book, known.noise, known.prior, grid, rest)


@dataclass
class _Part:
    """A part of a record, ready to be searched."""

    basis: Basis
    grid: Grid
    state: Array
    run: Run
    contest: Contest
    laws: list[Law]
    entries: list[Entry]

    @classmethod
    def of(cls, known: Basis, grid: Grid) -> _Part:
        state, run, _, _ = _free_run(known.probe, grid)
        contest = Contest(known.probe, grid, state, run, known.noise, known.prior)
        found = known.book.laws(grid, run)
        entries = [refine(contest, e) for e in _varied(scan(contest, found, None, known.structure))]
        entries.sort(key=lambda e: -e.gain)
        return cls(known, grid, state, run, contest, found, entries)

    @property
    def best_z(self) -> float:
        return self.entries[0].z if self.entries else 0.0

    @cached_property
    def null(self) -> Null:
        return null_scores(self.contest, self.laws)

    @property
    def threshold(self) -> float:
        return self.null.quantile(FALSE_ALARMS)

    def reset(self) -> None:
        self.contest.look_at(self.run)


def _search(part: _Part, say: Callable[[str], None]) -> Finding:
    """Add effects one by one, each the best of the finalists after a joint fit, until nothing more is to be gained."""
    network, contest, threshold = part.basis.probe.network, part.contest, part.threshold
    ids = part.basis.probe.scaling.ids
    start_chi = contest.misfit / max(contest.count, 1)
    ladder = [Rung("as commissioned", start_chi, part.best_z)]
    part.reset()
    say("re-tuning")
    retuned = fit(contest, Model.of(network, (), ids), part.state)
    part.reset()
    chosen: tuple[Entry, ...] = ()
    best: Fit | None = None
    ranked: tuple[Ranked, ...] = ()
    entries, first_gain = part.entries, 0.0
    while entries and entries[0].z >= threshold and len(chosen) < MOST_EFFECTS:
        small = SECOND_SHARE * first_gain
        if best is not None and entries[0].gain < small and enough(best.chi, start_chi, contest):
            break
        finalists = _finalists(entries, chosen)
        if not finalists:
            break
        groups: list[tuple[Entry, ...]] = [(*chosen, e) for e in finalists]
        if len(chosen) == 1:
            groups += _pairs(part)
        say(f"fitting {len(groups)} hypotheses")
        start = ladder[0].chi * contest.count
        trials = _fitted(part, groups)
        if not chosen and start - min(f.total for f, _ in trials) < threshold**2:
            # A law at measured temperatures may promise what its element does not keep, and hide what would.
            others = [e for e in part.entries if e.z >= threshold and all(e is not f for f in finalists)]
            more = _finalists(others, ())
            say(f"fitting {len(more)} more")
            trials += _fitted(part, [(e,) for e in more])
        if best is not None and enough(best.chi, start_chi, contest):
            # What is well explained is not explained twice: a second effect at the same place would bend the first.
            trials = [t for t in trials if not piled_up(t[0].entries)]
            if not trials:
                break
        order = rank(trials, contest, start)
        winner = order[0].fit
        if best is None and start - winner.total < threshold**2:
            break
        if best is not None:
            need = threshold**2 if not enough(best.chi, start_chi, contest) else max(threshold**2, small)
            if best.total - winner.total < need:
                break
        best, ranked, chosen = winner, order, winner.entries
        if not first_gain:
            first_gain = max(ladder[0].chi * contest.count - winner.total, 1.0)
        part.reset()
        again = fit(contest, Model.of(network, chosen, ids), part.state, rounds=2)
        given = np.stack([e.placed(contest) for e in again.entries])
        entries = _varied(scan(contest, part.laws, given, part.basis.structure))
        entries.sort(key=lambda e: -e.gain)
        ladder.append(
            Rung(
                " + ".join(f"{e.candidate.kind} at {e.candidate.where}" for e in chosen),
                best.chi,
                entries[0].z if entries else 0.0,
            )
        )
    folds: tuple[Fold, ...] = ()
    if best is not None:
        say("leaving out blocks of time")
        folds = validate(contest, Model.of(network, best.entries, ids), best)
    part.reset()
    return Finding(
        entries=chosen,
        fit=best,
        retuned=retuned,
        ranked=ranked,
        scanned=tuple(part.entries),
        start=ladder[0].chi * contest.count,
        count=contest.count,
        ladder=tuple(ladder),
        contest=contest,
        state=part.state,
        null=part.null,
        folds=folds,
        beside=entries[0] if chosen and entries and entries[0].z >= threshold else None,
    )


def _fitted(part: _Part, groups: list[tuple[Entry, ...]]) -> list[tuple[Fit, tuple[Entry, ...]]]:
    """Each group of effects fitted, from the commissioned values."""
    network, ids = part.basis.probe.network, part.basis.probe.scaling.ids
    trials = []
    for group in groups:
        part.reset()
        trials.append((fit(part.contest, Model.of(network, group, ids), part.state), group))
    return trials


def _weighed(finding: Finding, first: _Part, later: list[_Part]) -> tuple[Finding, tuple[str, ...]]:
    """The finding with its hypotheses ranked by all records, and what is to be said of the later ones.

    What is said of the answer itself, its score and the blocks left out, stays that of the first record.
    """
    network, ids = first.basis.probe.network, first.basis.probe.scaling.ids
    weighed = weigh(finding.ranked, later, network, ids, finding.contest.grid.span_s)
    for part in later:
        part.reset()
    order = rank(
        [(w.fit, w.fit.entries) for w in weighed], finding.contest, finding.start + sum(p.contest.misfit for p in later)
    )
    at = next(i for i, w in enumerate(weighed) if w.fit is order[0].fit)
    best = finding.ranked[at].fit
    notes = [
        f"with the answer, later record {number} still leaves {chi:.2f} of misfit where noise alone leaves "
        f"{part.contest.expected:.2f}; there is more in it, so diagnose that record by itself"
        for number, (chi, part) in enumerate(zip(weighed[at].chis, later, strict=True), start=1)
        if chi > max(MORE_LEFT * part.contest.expected, MORE_SHARE * part.contest.chi)
    ]
    same = best is finding.fit
    folds = finding.folds if same else validate(first.contest, Model.of(network, best.entries, ids), best)
    first.reset()
    return replace(
        finding, ranked=order, fit=best, entries=best.entries, folds=folds, beside=finding.beside if same else None
    ), tuple(notes)


def _pairs(part: _Part) -> list[tuple[Entry, ...]]:
    """The best pairs that do not build on the best single effect, which may stand for the two of them."""
    firsts: dict[tuple[str, str], Entry] = {}
    for entry in part.entries:
        firsts.setdefault((entry.candidate.kind, entry.candidate.where), entry)
    part.reset()
    found: list[tuple[float, tuple[Entry, ...]]] = []
    for first in list(firsts.values())[:PAIRED]:
        seconds = scan(part.contest, part.laws, first.vector[None], part.basis.structure)[:3]
        for second in seconds:
            again = scan(part.contest, [first.law], second.vector[None])[:1]
            pair, fitted = together(part.contest, (again[0] if again else first, second))
            if possible(pair) and not piled_up(pair):
                found.append((fitted.gain, pair))
    found.sort(key=lambda f: -f[0])
    return [pair for _, pair in found[:3]]


def _varied(entries: list[Entry]) -> list[Entry]:
    """The best entries of a scan, one of each candidate and shape."""
    best: dict[tuple[str, str], Entry] = {}
    for entry in entries:
        best.setdefault((entry.candidate.id, entry.shape.name), entry)
    return list(best.values())[: 5 * FINALISTS]


def _finalists(entries: list[Entry], chosen: tuple[Entry, ...]) -> list[Entry]:
    """The entries worth a fit: the best of each candidate and shape, near the top by gain."""
    found: list[Entry] = []
    taken = {e.candidate.id for e in chosen}
    seen: set[tuple[str, str]] = set()
    places: dict[tuple[str, str], int] = {}
    for entry in entries:
        key = (entry.candidate.id, entry.shape.name)
        place = (entry.candidate.kind, entry.candidate.where)
        if key in seen or entry.candidate.id in taken:
            continue
        if entry.gain < entries[0].gain - max(width(entries[0].gain) * 10.0, 40.0) and len(found) >= 3:
            break
        if places.get(place, 0) >= 4:
            continue
        seen.add(key)
        places[place] = places.get(place, 0) + 1
        found.append(entry)
        if len(found) == FINALISTS:
            break
    # What grows is only believed where the same thing all at once does worse.
    for grown in [e for e in found if e.shape.name != "step"]:
        at_once = [e for e in entries if e.candidate.id == grown.candidate.id and e.shape.name == "step"]
        if at_once and at_once[0] not in found:
            found.append(at_once[0])
    return found


def _errors(finding: Finding, network: Network, record: Columns, grid: Grid, split: int) -> dict[str, SensorError]:
    """RMSE per sensor over the held-out part, of free runs from the record's beginning."""
    time, inputs = record.time_s, bridged(network, record.time_s, record.inputs)
    late = time >= grid.time[split]
    runs = []
    for values, state, entries in (
        (network.values, finding.state, ()),
        (finding.retuned.values, finding.retuned.state, ()),
        *(((finding.fit.values, finding.fit.state, finding.fit.entries),) if finding.fit else ()),
    ):
        model = Model.of(network, entries, finding.contest.probe.scaling.ids)
        sizes = np.array([[e.size for e in entries]])
        runs.append(model.run(time, inputs, state[None, : len(network.nodes)], values[None, :], sizes)[0])
    if finding.fit is None:
        runs.append(runs[1])
    out = {}
    for j, name in enumerate(network.sensor_names):
        off = [np.where(late, record.measured[:, j] - run[:, j], np.nan) for run in runs]
        raw = [_rms(x) for x in off]
        means = [_rms(_binned(x, time, grid)) for x in off]
        if np.isfinite(raw[0]):
            out[name] = SensorError(raw[0], raw[1], raw[2], float(network.sigma[j]), (means[0], means[1], means[2]))
    return out


def _binned(values: Array, time: Array, grid: Grid) -> Array:
    where = np.minimum(((time - grid.time[0]) / grid.step_s + 1e-9).astype(np.intp), len(grid.time) - 1)
    good = np.isfinite(values)
    count = np.bincount(where[good], minlength=len(grid.time))
    total = np.bincount(where[good], values[good], len(grid.time))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _rms(values: Array) -> float:
    good = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(good**2))) if good.size else float("nan")
