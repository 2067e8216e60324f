"""Tables of `hil bench audit`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.bench.audit.causes import Cause
from hil.bench.audit.subject import SubjectAudit
from hil.bench.measure import Cell, ReportTable


def causes_table(key: str, title: str, causes: Sequence[Cause]) -> ReportTable:
    """Return verdicts as a table."""
    rows = tuple((c.cause, c.subject, "confirmed" if c.confirmed else "not confirmed", c.finding) for c in causes)
    return ReportTable(key, title, ("cause", "subject", "verdict", "finding"), rows)


def subject_tables(found: SubjectAudit) -> list[ReportTable]:
    """Return the tables of one subject."""
    tables = [_replaced(found), _corrections(found), _labels(found), _losses(found), _trainings(found)]
    return [*tables, _gains(found)] if found.gains else tables


def _replaced(a: SubjectAudit) -> ReportTable:
    rows: list[tuple[Cell, ...]] = []
    for member in a.members:
        for one in member.replaced.values():
            rows.append(
                (
                    member.name,
                    one.part,
                    one.theta,
                    1e3 * one.delta_K,
                    _change(one.parameters_worse),
                    _change(one.outputs_worse),
                )
            )
    plants = len(np.unique(a.probe.plant))
    columns = (
        "member",
        "taken from another plant",
        "parameters",
        "corrections mK",
        "parameters worse",
        "outputs worse",
    )
    notes = (
        "parameters: mean absolute movement, in bounds; worse: increase of the errors as a share, with its 95 % "
        "interval over plants and weeks",
        "all channels: with their gaps, regimes and clock; evidence token: the fit that the answer starts from",
    )
    about = f"{a.probe.subject}: {len(a.probe)} windows of {plants} plants, one part of the inputs from another plant"
    return ReportTable(f"{a.probe.subject}_replaced", about, columns, tuple(rows), notes)


def _corrections(a: SubjectAudit) -> ReportTable:
    rows: list[tuple[Cell, ...]] = []
    for member in a.members:
        c = member.correction
        rows.append(
            (
                member.name,
                c.theta_start,
                c.theta,
                1e3 * c.start_K,
                1e3 * c.delta_K,
                _change(c.parameters),
                _change(c.outputs),
            )
        )
    notes = (
        "start: the untrained answer, and what it moves the outputs by against the commissioned twin",
        "change: of the errors by the correction, as a share with its 95 % interval; "
        f"a reading has {1e3 * a.probe.noise_K:.0f} mK of noise",
    )
    columns = (
        "member",
        "start, bounds",
        "correction, bounds",
        "start mK",
        "correction mK",
        "change of parameters",
        "change of outputs",
    )
    about = f"{a.probe.subject}: corrections beside the start"
    return ReportTable(f"{a.probe.subject}_corrections", about, columns, tuple(rows), notes)


def _labels(a: SubjectAudit) -> ReportTable:
    p = a.probe
    there = np.isfinite(p.true)
    counted = there & (p.weight > 0.0)
    error = np.abs(p.start - np.nan_to_num(p.true)) / p.bounds
    rows: list[tuple[Cell, ...]] = []
    for k, name in enumerate(p.deviations):
        share = counted[:, k].sum() / max(there[:, k].sum(), 1)
        weight = p.weight[there[:, k], k]
        inside, outside = (
            float(error[some, k].mean()) if some.any() else None for some in (counted[:, k], (there & ~counted)[:, k])
        )
        rows.append((name, float(share), float(weight.mean()) if len(weight) else None, inside, outside))
    columns = ("deviation", "share that counts", "mean weight", "error where it counts", "error where not")
    notes = ("errors of the start, in bounds",)
    return ReportTable(
        f"{p.subject}_labels", f"{p.subject}: labels that count in the loss", columns, tuple(rows), notes
    )


def _losses(a: SubjectAudit) -> ReportTable:
    rows: tuple[tuple[Cell, ...], ...] = tuple(
        (state, term.name, term.value, 100.0 * term.share, *term.gradients)
        for state, terms in a.losses.items()
        for term in terms
    )
    columns = ("state", "term", "weighted", "% of the loss", "encoder", "parameter head", "output head")
    notes = ("the last three: norm of the term's gradient in the encoder's and the heads' weights, first member",)
    return ReportTable(f"{a.probe.subject}_losses", f"{a.probe.subject}: terms of the loss", columns, rows, notes)


def _trainings(a: SubjectAudit) -> ReportTable:
    rows = tuple(
        (t.name, t.steps, t.batch, t.windows, t.epochs, 100.0 * t.parameters, 100.0 * t.outputs, 100.0 * t.late)
        for t in a.trainings
    )
    columns = (
        "member",
        "steps",
        "batch",
        "windows",
        "epochs",
        "parameters %",
        "outputs %",
        "outputs, last third %",
    )
    notes = (
        "by the cards: errors at the end on unseen windows against Gauss-Newton, and the change over the last third",
    )
    return ReportTable(f"{a.probe.subject}_trainings", f"{a.probe.subject}: trainings", columns, rows, notes)


def _gains(a: SubjectAudit) -> ReportTable:
    rows = tuple(
        (
            g.member,
            g.of,
            g.start,
            1e3 * g.start_K,
            1e3 * g.size_K,
            1e3 * g.within_K,
            g.between,
            _change(g.change),
            g.factor,
        )
        for g in a.gains
    )
    columns = (
        "member",
        "windows",
        "added to",
        "start errs mK",
        "correction mK",
        "within a window mK",
        "between plants",
        "change of the error",
        "best factor",
    )
    notes = (
        "correction: without its stored factor, causal branch; within a window: distance from its mean there",
        "between plants: share of the variance of its means in windows; best factor: with the least error, 0 to 1",
        "the shipped trees learned from the training stations, where they err less than those of the training did",
    )
    about = f"{a.probe.subject}: correction of the outlet as the training left it"
    return ReportTable(f"{a.probe.subject}_gains", about, columns, rows, notes)


def _change(one: tuple[float, float, float]) -> str:
    return f"{one[0]:+.3f} ({one[1]:+.3f} to {one[2]:+.3f})"
