"""Diagnosis of a grown twin: verdict, ladder, alternatives and errors as with a healthy record.

The last quarter of a record, or every fourth of its steady states, is held out before anything is fitted.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from twin.discovery.answer.isolation import SURE
from twin.discovery.diagnosis import Alternative, Diagnosis, Effect, Moved, Rung, SensorError, Verdict
from twin.discovery.effects.phrases import amount, said
from twin.discovery.evidence.held_out import binned, leaves_more_squares
from twin.discovery.growing.beam import BEAM
from twin.discovery.growing.growth import MOST_EFFECTS, Added, Growth, grow_samples, samples_of, states_of
from twin.discovery.growing.growth_problem import GrowthFit, SampledRecord
from twin.discovery.growing.leads import leads_of
from twin.discovery.growing.merit import LEFT, NEEDED, REST, mostly_explained
from twin.discovery.healthy.basis import Columns
from twin.discovery.records.grid import on_grid
from twin.discovery.scoring.equivalence import width
from twin.network import Array, Network, TwinFileError

EVERY = 4
"""One steady state of so many is held out, and that share of a record's end."""
MOST_BLOCKS = 240
"""Blocks of the residuals that are drawn, as in a diagnosis with a healthy record."""
LONGEST = 4000
"""Samples up to which a twin is grown without being asked: each hypothesis is simulated, and a longer record takes
hours."""
FAR = 4.0
"""Ratio of any thermometer's held-out error to its noise up to which the effects count: an effect that begins midway
otherwise looks like several that have always been there."""
_CUT = ". If something came in half way, cut the record there."
_NOT_KNOWN = (
    "nothing healthy is known of this rig: the twin was grown from its file, and the noise is told from the record "
    "itself; every effect is taken to be there from the beginning"
)


def fits_growth(network: Network, record: Columns) -> bool:
    """Return True if a twin is to be grown on a record: it was never commissioned, and the record is not too long."""
    return network.revision.number == 0 and len(record.time_s) <= LONGEST


def diagnose_grown(
    network: Network,
    record: Columns,
    *,
    more: tuple[Columns, ...] = (),
    at_rest: bool = False,
    most: int = MOST_EFFECTS,
    beam: int = BEAM,
    say: Callable[[str], None] = lambda _: None,
) -> Diagnosis:
    """Return the effects that a twin lacks from the beginning of a record, without a healthy record.

    Parameters
    ----------
    network
        With tunables, values as its file has them.
    more
        Further records, which rank sets of effects that form an ambiguity group on this one.
    at_rest
        Each row is a steady state of its own.
    most, beam
        As `grow`.

    Raises
    ------
    TwinFileError
        A record too short or without readings, a twin without tunables, further records of states.
    """
    if at_rest and more:
        raise TwinFileError("steady states are grown from one record alone; put all of them into one file")
    if at_rest:
        whole = states_of(network, record.inputs, record.measured)
        hidden = np.arange(len(whole.time)) % EVERY == EVERY - 1
        train = states_of(network, whole.inputs[~hidden], whole.measured[~hidden])
    else:
        whole = samples_of(network, record.time_s, record.inputs, record.measured)
        hidden = np.arange(len(whole.time)) >= len(whole.time) * (EVERY - 1) // EVERY
        train = replace(whole, time=whole.time[~hidden], inputs=whole.inputs[~hidden], measured=whole.measured[~hidden])
    further = tuple((r.time_s, r.inputs, r.measured) for r in more)
    growth = grow_samples(network, train, further, most=most, beam=beam, say=say)
    say("judging")
    return _GrownDiagnosis(network, record, growth, whole, hidden).diagnosis()


class _GrownDiagnosis:
    """Growth with the record that it was made on and its held-out rows `hidden` (n,)."""

    def __init__(
        self, network: Network, record: Columns, growth: Growth, whole: SampledRecord, hidden: np.ndarray
    ) -> None:
        self.network, self.growth, self.whole, self.hidden = network, growth, whole, hidden
        self.start = 1.0 if whole.at_rest else float(record.time_s[0])
        self.added = [r.added for r in growth.rungs if r.added is not None]
        first, last = growth.rungs[0].fit, growth.rungs[-1].fit
        self.residuals = [self._residual(None), self._residual(first), self._residual(last)]
        self.record = record

    def diagnosis(self) -> Diagnosis:
        """Return the diagnosis."""
        g = self.growth
        misfit = [float(np.nanmean((r.rms / self.whole.sigma) ** 2)) for r in g.rungs]
        errors = self._errors()
        if not errors:
            raise TwinFileError("the part of the record that is held out has no reading of any of the twin's sensors")
        good = g.verdict == "adequate" or misfit[-1] <= max(LEFT, REST * misfit[0])
        good = good and all(e.after <= FAR * e.noise for e in errors.values()) and not leaves_more_squares(errors)
        mostly = not good and not leaves_more_squares(errors) and self._mostly(misfit, errors)
        effects = tuple(self._effect(a) for a in self.added)
        verdict: Verdict
        if not effects:
            verdict = "adequate" if g.verdict == "adequate" and good else "unexplained"
        elif not good and not mostly:
            verdict = "unexplained"
        else:
            verdict = "effect found" if all(e.confidence >= SURE and _sized(e) for e in effects) else "ambiguous"
        refused = tuple(Alternative(r.kind, r.where, r.driver, 0.0, r.why) for r in g.refused)
        if verdict == "unexplained":
            why = "passes its tests, but all effects that do leave the record unexplained"
            if leaves_more_squares(errors):
                why = "passes its tests where it was fitted, but all that do predict the held-out part worse"
            own = (Alternative(e.kind, e.where, e.driver, 0.0, f"{e.says}: {why}") for e in effects)
            refused = (*own, *refused)
            effects = ()
        times = self.whole.time + self.start
        hours, blocks = self._blocks(times)
        return Diagnosis(
            verdict=verdict,
            summary=self._summary(verdict, effects, errors, mostly),
            effects=effects,
            indistinguishable=self._others() if verdict in ("effect found", "ambiguous") else (),
            alternatives=refused,
            held_out_s=(float(times[np.argmax(self.hidden)]), float(times[-1])),
            errors=errors,
            moved=self._moved(),
            blind_spots=(),
            ladder=self._ladder(misfit),
            courses=(),
            hours=hours,
            residual=blocks[0],
            residual_after=blocks[2],
            band=self.whole.sigma / math.sqrt(max(len(self.whole.time) / len(hours), 1.0)),
            network=g.network if verdict == "effect found" else None,
            warnings=(_NOT_KNOWN, *self._absent()),
            notes=(f"{g.summary}",) if effects and g.verdict == "unexplained" else (),
            folds=tuple(replace(f, first_s=f.first_s + self.start, last_s=f.last_s + self.start) for f in g.folds),
            threshold=math.sqrt(max([NEEDED, *(a.limit for a in self.added)])),
            method="growth at rest" if self.whole.at_rest else "growth",
            leads=leads_of(
                self.network,
                self.record,
                self.whole,
                self.residuals[1 if leaves_more_squares(errors) else 2],
                self.residuals[1],
                verdict,
            ),
        )

    def _mostly(self, misfit: list[float], errors: dict[str, SensorError]) -> bool:
        """Return True if most of the misfit is explained, of the fit and of every thermometer in the held-out segment.

        The effects are reported then, and the summary calls the rest structural error.
        """
        held_out = [((e.after / e.noise) ** 2, (e.before / e.noise) ** 2) for e in errors.values()]
        return all(mostly_explained(after, before) for after, before in [(misfit[-1], misfit[0]), *held_out])

    def _absent(self) -> tuple[str, ...]:
        names = [n for j, n in enumerate(self.network.sensor_names) if not np.isfinite(self.whole.measured[:, j]).any()]
        return tuple(f"{name} has no reading in this record, so nothing is told by it or of it" for name in names)

    def _residual(self, fit: GrowthFit | None) -> Array:
        """Return measured minus simulated (n, m), K, of the whole record: of a fit, or of the twin as its file
        has it.
        """
        problem = self.growth.problem.with_entries(fit.entries if fit else (), self.whole)
        return problem.residual(problem.start(fit) if fit else problem.start())

    def _effect(self, a: Added) -> Effect:
        """Return an added effect as a reported one; its confidence is over those that could replace it."""
        temper = max(width(a.needed), 10.0) / 10.0
        elsewhere = {(label[0], label[1]): 0.0 for label in a.others if label[:2] != (a.kind, a.where)}
        for label, dearer in a.others.items():
            if label[:2] in elsewhere:
                elsewhere[label[:2]] = max(elsewhere[label[:2]], math.exp(-0.5 * max(dearer, 0.0) / temper))
        score = a.needed + a.elsewhere
        return Effect(
            kind=a.kind,
            where=a.where,
            driver=a.driver,
            change=a.entry.change,
            value=a.value,
            unit=a.unit,
            interval90=a.interval90,
            onset_s=self.start,
            onset_interval90_s=(self.start, self.start),
            shape="step",
            confidence=1.0 / (1.0 + sum(elsewhere.values())),
            z=math.sqrt(max(score, 0.0)),
            evidence=f"{self._said(a)}; without it the record would be less likely by {score:.0f} "
            f"in -2 log likelihood, and {a.folds} of {EVERY} held-out parts of it are predicted no worse with it",
            says=self._said(a),
            family_wise=a.by_chance,
            noise_z=math.sqrt(max(a.limit, 0.0)),
        )

    def _said(self, a: Added) -> str:
        """Return an added effect in words."""
        return said(a.entry.candidate, a.value, record_s=self.growth.problem.samples.span_s)

    def _others(self) -> tuple[Alternative, ...]:
        """Return the effects that could replace an added one, with shares of their likelihood."""
        found: dict[tuple[str, str, str], Alternative] = {}
        for a in self.added:
            temper = max(width(a.needed), 10.0) / 10.0
            for label, dearer in a.others.items():
                found[label] = Alternative(*label, confidence=0.5 * math.exp(-0.5 * max(dearer, 0.0) / temper))
        return tuple(found.values())

    def _errors(self) -> dict[str, SensorError]:
        """Return the held-out RMSE per sensor, K: as in the file, re-tuned, and with the effects."""
        grid = None
        if not self.whole.at_rest and not self.whole.means:
            grid = on_grid(self.network, self.record.time_s, self.record.inputs, self.record.measured)
        out = {}
        for j, name in enumerate(self.network.sensor_names):
            off = [np.where(self.hidden, r[:, j], np.nan) for r in self.residuals]
            if not np.isfinite(off[0]).any():
                continue
            raw = [float(np.sqrt(np.nanmean(x**2))) for x in off]
            means = raw
            if grid is not None:
                means = [float(np.sqrt(np.nanmean(binned(x, self.record.time_s, grid) ** 2))) for x in off]
            out[name] = SensorError(raw[0], raw[1], raw[2], float(self.whole.sigma[j]), (means[0], means[1], means[2]))
        return out

    def _shown(self, time: float) -> float:
        """Return a time of the fitted part as one of the record, s; a state by its number among all."""
        return float(np.flatnonzero(~self.hidden)[int(time)] + 1) if self.whole.at_rest else time + self.start

    def _blocks(self, times: Array) -> tuple[Array, list[Array]]:
        """Return hours (b,), or numbers of states over 3600, and block means (b, m) of the residuals."""
        n = len(self.whole.time)
        count = n if self.whole.at_rest else min(n, MOST_BLOCKS)
        edges = np.linspace(0, n, count + 1).astype(int)
        rows = list(pairwise(edges.tolist()))
        hours = np.array([float(times[a:b].mean()) for a, b in rows]) / 3600.0
        return hours, [np.stack([_mean(r[a:b]) for a, b in rows]) for r in self.residuals]

    def _ladder(self, misfit: list[float]) -> tuple[Rung, ...]:
        """Return the misfit after each added effect, with the score of the next one."""
        names, rungs = "re-tuned", []
        gains = [a.gain for a in self.added] + [max((r.gain for r in self.growth.refused), default=0.0)]
        for i, (chi, gain) in enumerate(zip(misfit, gains, strict=True)):
            names = " + ".join(f"{a.kind} at {a.where}" for a in self.added[:i]) or names
            rungs.append(Rung(names, chi, math.sqrt(max(gain, 0.0))))
        return tuple(rungs)

    def _moved(self) -> tuple[Moved, ...]:
        problem = self.growth.problem
        scaling, index = problem.scaling, problem.scaling.index
        was, sd = self.network.values[index], scaling.prior_sd()
        values = [r.fit.values[index] for r in (self.growth.rungs[0], self.growth.rungs[-1])]
        far = [(scaling.to_z(v) - scaling.to_z(was)) / sd for v in values]
        return tuple(
            Moved(
                name,
                float(was[i]),
                float(values[0][i]),
                float(values[1][i]),
                self.network.parameters[name].unit,
                float(far[0][i]),
                float(far[1][i]),
            )
            for i, name in enumerate(scaling.ids)
        )

    def _summary(
        self, verdict: Verdict, effects: tuple[Effect, ...], errors: dict[str, SensorError], mostly: bool
    ) -> str:
        if verdict == "adequate":
            return "Re-tuned, the twin explains this record: nothing is missing that it could show."
        part = "On states that were held out" if self.whole.at_rest else "On the held-out segment"
        if verdict == "unexplained":
            return self._unexplained(part, errors)
        worst, e = max(errors.items(), key=lambda item: item[1].before / item[1].noise)
        told = (
            f" {part}, {worst} is off by {amount(e.before, 'K')} when re-tuned, by {amount(e.after, 'K')} with what "
            f"was added, at a noise of {amount(e.noise, 'K')}."
        )
        text = ". ".join(e.says for e in effects)
        others = dict.fromkeys(
            f"{kind.replace('_', ' ')} at {where}"
            for a in self.added
            for kind, where, _ in a.others
            if (kind, where) not in {(x.kind, x.where) for x in self.added}
        )
        if verdict == "ambiguous":
            vague = [f"{e.kind.replace('_', ' ')} at {e.where}" for e in effects if not _sized(e)]
            text += f"; but on this record that is indistinguishable from {', '.join(others)}" if others else ""
            text += f"; but the size of {' and '.join(vague)} is not identifiable from this record" if vague else ""
            text += "" if self.whole.at_rest else "; a further record, given with --with, may"
        if mostly:
            told += (
                " What is left is structural error, which no effect of the catalogue explains; if the noise in the "
                "twin file is a guess, enter what the thermometer really has as its sigma."
            )
        return f"{text}.{told}"

    def _unexplained(self, part: str, errors: dict[str, SensorError]) -> str:
        best = "best effect" if len(self.added) == 1 else f"{len(self.added)} best effects"
        won = f"with the {best}" if self.added else "re-tuned"
        worst, e = max(errors.items(), key=lambda item: item[1].after / item[1].noise)
        cut = "." if self.whole.at_rest else _CUT
        if self.added and leaves_more_squares(errors):
            worst, e = max(errors.items(), key=lambda item: (item[1].after - item[1].before) / item[1].noise)
            return (
                "The twin does not fit this record, and no effects of the catalogue explain it: those that fit it best "
                f"predict worse than none. {part}, {worst} is off by {amount(e.before, 'K')} re-tuned, by "
                f"{amount(e.after, 'K')} {won}, at a noise of {amount(e.noise, 'K')}{cut}"
            )
        return (
            "The twin does not fit this record, and no effects of the catalogue explain it. "
            f"{part}, {worst} is off by {amount(e.after, 'K')} {won}, at a noise of {amount(e.noise, 'K')}{cut}"
        )


def _sized(effect: Effect) -> bool:
    """Return True if an effect's size is significantly different from zero: beside a similar effect it may not be."""
    low, high = effect.interval90
    return low > 0.0 or high < 0.0


def _mean(rows: Array) -> Array:
    good = np.isfinite(rows)
    count = good.sum(axis=0)
    return np.where(count > 0, np.where(good, rows, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)
