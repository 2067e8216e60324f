"""Diagnosis in the review: one more tab, made from the results folder. Plain data, independent of Rerun.

/diagnosis/verdict, /diagnosis/errors  text
/diagnosis/residual/<sensor>/stale    measured minus the baseline twin, K, (n, 1)
/diagnosis/residual/<sensor>/after    minus the twin with the answer, K, (n, 1)
/diagnosis/residual/<sensor>/band     zero and plus/minus two sigma of a healthy residual, K, (n, 3)
/diagnosis/unknown/<site>             unknown input at this site alone, W or K, with its variance
/diagnosis/state                      lane: effects from their onsets
/diagnosis/onsets                     text at each onset
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from hil.diagnosis import (
    Findings,
    Unknown,
    after_label,
    ambiguity_group,
    has_diagnosis,
    plain,
    read_findings,
    reasons,
    short,
)
from hil.journal import Header
from hil.review.batches import Estimates, ReviewBatch, Rows, States, Texts
from hil.review.plan import FAINT, GREEN, NEUTRAL, ORANGE, TRACKED, Colour, Lane, Lines, Panel, ReviewPlan, Stack, path

VERDICT, ERRORS = "/diagnosis/verdict", "/diagnosis/errors"
_MOST_BESIDE = 4
_HEALTHY = "as commissioned"
_AFTER = TRACKED["blue"]


def findings_of_run(journal: Path) -> Findings | None:
    """Return the diagnosis in the run folder of a journal, or None."""
    folder = journal.parent / "diagnosis"
    return read_findings(folder) if has_diagnosis(folder) else None


def plan_of_findings(findings: Findings, name: str) -> ReviewPlan:
    """Return the plan of a diagnosis of a record without a run."""
    end_s = float(findings.curves.time_s[-1])
    header = Header((), {}, (), name, end_s, 1.0, {})
    return with_findings(ReviewPlan(header, (), (), ()), findings)


def with_findings(plan: ReviewPlan, findings: Findings) -> ReviewPlan:
    """Return the plan with a tab for the diagnosis after the overview."""
    tabs = (*plan.tabs[:1], _tab(findings), *plan.tabs[1:])
    colours = plan.colours | {path("diagnosis", "unknown", u.site): _colour(findings, u.site) for u in _shown(findings)}
    return replace(
        plan,
        lines=plan.lines + tuple(_lines(findings)),
        lanes=(*plan.lanes, Lane("/diagnosis/state", _states(findings))),
        tabs=tabs,
        colours=colours,
    )


def notes(findings: Findings) -> dict[str, str]:
    """Return Markdown by entity: the verdict with the key of colours, and the errors."""
    d = findings.document
    parts = [f"### {str(d['verdict']).capitalize()}", str(d["summary"])]
    parts += [f"*{text}*" for text in (*d["warnings"], *d["notes"])]
    parts += reasons(d)
    if others := ambiguity_group(d):
        parts.append("Not distinguishable in this record from: " + ", ".join(plain(a) for a in others) + ".")
    parts.append(
        f"orange: baseline twin · blue: {after_label(d)} · thin lines: zero and ±2σ of a healthy residual · below, "
        "blue: the place with the best fit to the record, band ±1σ"
    )
    rows = [
        f"| {short(name)} | {_k(e['stale'])} | {_k(e['before'])} | {_k(e['after'])} | {_k(e['noise'])} |"
        for name, e in d["error"]["sensors"].items()
    ]
    head = f"| RMSE in K, held out | baseline | re-tuned | {after_label(d)} | noise |\n|---|---|---|---|---|"
    return {VERDICT: "\n\n".join(parts) + "\n", ERRORS: "\n".join([head, *rows]) + "\n"}


def batches(findings: Findings) -> Iterator[ReviewBatch]:
    """Yield everything that is drawn over time."""
    curves = findings.curves
    time_s = curves.time_s
    for sensor, residual in curves.residual.items():
        root = path("diagnosis", "residual", sensor)
        yield Rows(f"{root}/stale", time_s, residual[:, None])
        yield Rows(f"{root}/after", time_s, curves.after[sensor][:, None])
        band = 2.0 * curves.band[sensor]
        yield Rows(f"{root}/band", time_s, np.tile([0.0, band, -band], (len(time_s), 1)))
    for u in _shown(findings):
        entity = path("diagnosis", "unknown", u.site)
        yield Estimates(entity, u.site, u.unit, time_s, u.mean, u.sd**2)
    yield from _onsets(findings)


def _onsets(findings: Findings) -> Iterator[ReviewBatch]:
    begin = float(findings.curves.time_s[0])
    times, states, said = [begin], [_HEALTHY], []
    for e in sorted(findings.document["effects"], key=lambda effect: effect["onset_s"]):
        onset = max(float(e["onset_s"]), begin)
        said.append((onset, str(e.get("says") or e["evidence"])))
        if onset <= times[-1]:
            states[-1] = _label(states[-1], e)
        else:
            times.append(onset)
            states.append(_label(states[-1], e))
    yield States("/diagnosis/state", np.array(times), list(states))
    if said:
        yield Texts("/diagnosis/onsets", np.array([t for t, _ in said]), [s for _, s in said], ["WARN"] * len(said))


def _label(before: str, effect: dict[str, object]) -> str:
    return plain(effect) if before == _HEALTHY else f"{before} + {plain(effect)}"


def _states(findings: Findings) -> dict[str, Colour]:
    found = next(b for b in _onsets(findings) if isinstance(b, States))
    return {state: GREEN if state == _HEALTHY else ORANGE for state in found.states if state}


def _shown(findings: Findings) -> list[Unknown]:
    """Return the likeliest sites of each unit."""
    unknowns = findings.curves.unknowns
    power = [u for u in unknowns if u.unit == "W"][:_MOST_BESIDE]
    return power + [u for u in unknowns if u.unit != "W"][:_MOST_BESIDE]


def _colour(findings: Findings, site: str) -> Colour:
    best = findings.curves.unknowns[0].site if findings.document["effects"] else None
    return _AFTER if site == best else NEUTRAL


def _lines(findings: Findings) -> Iterator[Lines]:
    for sensor, band in findings.curves.band.items():
        root = path("diagnosis", "residual", sensor)
        yield Lines(f"{root}/stale", ("baseline twin",), (ORANGE,), (2.0,))
        yield Lines(f"{root}/after", (after_label(findings.document),), (_AFTER,), (2.0,))
        names = ("zero", f"+2σ healthy ({2 * band:.2g} K)", "-2σ healthy")
        yield Lines(f"{root}/band", names, (NEUTRAL, FAINT, FAINT), (1.0,))


def _tab(findings: Findings) -> Stack:
    residuals = [
        Panel("lines", f"{short(s)}: measured - twin [K]", (path("diagnosis", "residual", s) + "/**",), legend=False)
        for s in findings.curves.residual
    ]
    shown = _shown(findings)
    power = [_unknown(u) for u in shown if u.unit == "W"]
    offset = [_unknown(u) for u in shown if u.unit != "W"]
    words = (
        Panel("note", "Verdict", (VERDICT,), 3.0),
        Panel("note", "Errors", (ERRORS,), 2.2),
        Panel("texts", "Onset", ("/diagnosis/onsets",), 2.5),
    )
    rows: list[Panel | Stack] = [Stack("columns", words, share=3.0)]
    for start in range(0, len(residuals), _MOST_BESIDE):
        rows.append(Stack("columns", tuple(residuals[start : start + _MOST_BESIDE]), share=3.0))
    rows.append(Panel("lanes", "Effects", ("/diagnosis/state",), 1.4))
    rows += [Stack("columns", tuple(group), share=2.5) for group in (power, offset) if group]
    return Stack("rows", tuple(rows), title="Diagnosis")


def _unknown(u: Unknown) -> Panel:
    quantity = {"W": "unknown power here alone", "K": "unknown offset of it alone"}.get(
        u.unit, "unknown change of it alone"
    )
    title = f"{u.site if u.unit == 'W' else short(u.site)}: {quantity} [{u.unit}]"
    return Panel("lines", title, (path("diagnosis", "unknown", u.site),), legend=False)


def _k(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
