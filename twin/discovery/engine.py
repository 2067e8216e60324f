"""The diagnosis from end to end: residual, contest, fit, verdict, errors on data that the fit never saw."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from twin.discovery.basis import Columns, basis
from twin.discovery.catalogue import LATE as LATE_DRIVERS
from twin.discovery.caution import as_commissioned, first_alone, nothing, unconfirmed, weak
from twin.discovery.contest import Contest
from twin.discovery.diagnosis import Diagnosis, SensorError
from twin.discovery.experiment import Limits
from twin.discovery.fitting import Fit, fit
from twin.discovery.forecast import Forecast, forecast, plan_of, too_little, unseen_kinds
from twin.discovery.grid import Grid, on_grid
from twin.discovery.held_out import binned, contradicted, errors, far_off
from twin.discovery.ladder import SECOND_SHARE, search, weighed
from twin.discovery.members import Members, members
from twin.discovery.model import Model
from twin.discovery.part import Part
from twin.discovery.ranking import Finding, enough
from twin.discovery.readings import Stuck, stuck
from twin.discovery.thermometers import explained_by_one
from twin.discovery.validation import holds
from twin.discovery.verdict import conclude
from twin.network import Array, Network, TwinFileError
from twin.steady import steady_state

HELD_OUT = 0.25
STILL_HELD = 0.4
"""Share of the part held out that stays so where it showed what the rest had not."""
FORETELLS_SHARE, FORETELLS = 0.15, 0.5
"""Of the squares in the part that no fit saw, in what is usual there, the share and the amount that a lesser further
effect has to take, to be told all the same."""
LATE = 0.85
"""Share of the part that a fit sees, beyond which an onset leaves it too little of what follows."""


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
    whole = Part.of(known, grid)
    other_forms = whole.sharpened()

    def part(of: Grid) -> Part:
        made = Part.of(known, of)
        made.add(other_forms)
        return made

    def on_unseen(finding: Finding) -> dict[str, SensorError]:
        return errors(finding, network, record, grid, split, known.plain)

    whole.add(other_forms)
    train = part(grid.part(0, split))
    notes = [told.sentence for told in (known.structure, known.bootstrap) if told is not None and told.sentence]
    finding: Finding | None = None
    doubted = False
    if not _begins_late(whole, train, split):
        finding, doubted = _searched(train, say)
        finding = _foretelling(finding, train, network, record, grid, split)
    most = max(split, int(bins * (1.0 - held_out * STILL_HELD)))
    later, why = split, ""
    if finding is None or (finding.fit is None and whole.best_z >= train.threshold):
        onset_s = whole.entries[0].shape.onset_s
        later = min((int(onset_s / grid.step_s) + bins) // 2, bins - 6)
        why = f"something changed at {onset_s / 3600.0:.1f} h, inside the part that was to be kept out of the fit"
        if later <= split:
            later, why = most, "what stands out does so in the part that was to be kept out of the fit"
    elif finding.fit is not None and far_off(seen := on_unseen(finding), network):
        later, doubted = most, contradicted(seen, network) and not weak(finding)
        why = "on the part that was to be kept out of the fit the best answer was off by more than is usual"
    elif any(e.shape.onset_s > LATE * split * grid.step_s for e in finding.entries):
        later, why = most, "an effect begins so late that the fit saw little of it"
    if later > split:
        split, finding = later, None
        notes.append(f"{why}; the fit was given the record up to {split * grid.step_s / 3600.0:.1f} h")
        train = part(grid.part(0, split))
    if finding is None:
        finding, doubted = _searched(train, say, doubted)
        if finding.fit is None and split < most and whole.best_z >= train.threshold:
            # What grows shows late.
            split, train = most, part(grid.part(0, most))
            notes.append(f"it showed nothing yet; so the fit was given {split * grid.step_s / 3600.0:.1f} h")
            finding, doubted = _searched(train, say, doubted)
        finding = _foretelling(finding, train, network, record, grid, split)
    if finding.fit is not None and finding.beside is not None and not doubted:
        say("asking whether lesser effects foretell")
        lesser = _as_used(search(train, say, 0.0), train)
        before, after = (_left_late(f, train, network, record, grid, split) for f in (finding, lesser))
        if _may_be_told(lesser) and before - after > max(FORETELLS_SHARE * before, FORETELLS):
            finding = lesser
    answers = [e.candidate for r in finding.ranked for e in r.entries]
    whole.know(answers)
    further: list[Part] = []
    if more and len(finding.ranked) > 1:
        say("comparing with further records")
        further = [part(on_grid(network, r.time_s, r.inputs, r.measured)) for r in more]
        for each in further:
            each.know(answers)
        finding, said = weighed(finding, train, further)
        notes += said
    off = on_unseen(finding)
    good_as_ever = healthy is None and as_commissioned(network, off)
    if good_as_ever or (finding.fit is not None and not more and unconfirmed(finding, off)):
        finding = nothing(finding)
        off = {name: replace(e, after=e.before, means=(*e.means[:2], e.means[1])) for name, e in off.items()}
    elif healthy is None and finding.fit is not None and not more:
        finding = first_alone(finding, train)
        off = on_unseen(finding)
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
        lasting=whole.entries,
        grid=grid,
        split=split,
        errors=off,
        notes=tuple(notes),
        single=single,
        still=still,
        limits=limits,
        usual=good_as_ever,
        doubted=doubted,
        later=tuple(part.grid for part in further),
    )

    def again(other: Columns) -> Diagnosis:
        return diagnose(network, other, healthy, more=more, say=say, held_out=held_out, limits=limits)

    return explained_by_one(found, network, record, single, again)


def _searched(train: Part, say: Callable[[str], None], doubted: bool = False) -> tuple[Finding, bool]:
    """The search, and whether its answer has to leave nothing over.

    What was too little to be told from an error of form may be why an answer does not predict: then it is let in.
    """
    finding = search(train, say, 0.0 if doubted else SECOND_SHARE)
    if not doubted and finding.beside is not None and not _good(finding):
        further = search(train, say, 0.0)
        if _good(further) and further.beside is None:
            finding, doubted = further, True
    return _as_used(finding, train), doubted


def _may_be_told(lesser: Finding) -> bool:
    """Whether effects that win little beside the first may be: none of them late, and no more than noise left.

    What is late is of what a lumped twin leaves, too, and what leaves more than noise is of another form.
    """
    late = any(e.candidate.driver in LATE_DRIVERS for e in lesser.entries[1:])
    return lesser.fit is not None and not late and lesser.fit.chi <= lesser.contest.expected


def _as_used(finding: Finding, part: Part) -> Finding:
    """The finding with values that foretell best by themselves."""
    again = _by_itself(part)
    fitted = None if finding.fit is None else again(finding.fit)
    return replace(finding, retuned=again(finding.retuned), fit=fitted)


def _left_late(finding: Finding, part: Part, network: Network, record: Columns, grid: Grid, split: int) -> float:
    """Squares that an answer leaves where no fit saw the record, all sensors together, in what is usual there."""
    found = errors(finding, network, record, grid, split, part.basis.plain)
    return sum((e.after / max(e.noise, e.usual)) ** 2 for e in found.values())


def _foretelling(finding: Finding, part: Part, network: Network, record: Columns, grid: Grid, split: int) -> Finding:
    """The finding without those of its last effects that make the part that no fit saw no better.

    Where so much is left without one that there must be something, it stays: how it goes on is then told wrongly.
    """
    while finding.shorter is not None and finding.shorter.fit is not None:
        if not enough(finding.shorter.fit.chi, finding.start / finding.count, finding.contest, quiet=True):
            break
        shorter = replace(finding.shorter, retuned=finding.retuned, fit=_by_itself(part)(finding.shorter.fit))
        longer, without = (_left_late(f, part, network, record, grid, split) for f in (finding, shorter))
        if longer < without:
            break
        finding = replace(shorter, refuted=True)
    return finding


def _by_itself(part: Part) -> Callable[[Fit], Fit]:
    """Gives fits the values that foretell best by themselves: a twin does not know what its structure leaves."""
    known = part.basis
    if known.plain is None:
        return lambda found: found
    contest = Contest(known.probe, part.grid, part.state, part.run, known.plain, known.prior)

    def again(found: Fit) -> Fit:
        contest.look_at(part.run)
        used = fit(contest, Model.of(known.probe, found.entries), part.state)
        # What by itself vanishes or turns round is better left as it was found.
        same = all(a.size * b.size > 0.0 for a, b in zip(used.entries, found.entries, strict=True))
        return replace(used, total=found.total, chi=found.chi) if same else found

    return again


def _good(finding: Finding) -> bool:
    """Whether effects leave no more than noise, however much there was, and predict what they were not taken from."""
    assert finding.fit is not None
    return enough(finding.fit.chi, 0.0, finding.contest) and holds(finding.folds)


def _begins_late(whole: Part, train: Part, split: int) -> bool:
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
            name: np.column_stack([binned(one, columns.time_s, on) for one in each.T])
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
    return forecast(known, grid)


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
    return forecast(known, grid, rest)
