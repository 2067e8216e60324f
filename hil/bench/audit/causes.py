"""Verdicts on the known causes of blindness: each with its figure, its rule, and a sentence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from hil.bench.audit.probe import ALL_CHANNELS, EVERYTHING, EVIDENCE, MEMORY, mean_known, output_errors
from hil.bench.audit.shares import between_plants, worst_share
from hil.bench.audit.subject import SubjectAudit
from hil.bench.audit.terms import gradient_of, share_of
from twin.calibrators.hiera_unet.tower.predict import LEAST_WORSE

DECIDES, DOMINATES, BELONGS = 0.9, 0.9, 0.5
"""Judgements: shares from which one part decides an answer, one term a loss, and the plant an error."""
EXPONENTIAL = 0.05 * (1.0 + np.log(20.0))
"""Share of their sum that the largest 5 % of exponentially distributed errors hold: 0.20."""
UNEVEN = 2.0
"""Ratio of two gradients, either way, that counts as unequal; a judgement."""
LEAST_MK = 1.0
"""Mean correction, mK, below which a head has not moved; a fiftieth of the noise of a reading."""
STILL_FALLS = -0.01
"""Change of the unseen error over the last third of a training from which on more steps would help; a judgement."""


@dataclass(frozen=True)
class Cause:
    """A known cause with its verdict: `finding` states the figures and the rule."""

    cause: str
    subject: str
    confirmed: bool
    finding: str


def causes_of(found: SubjectAudit) -> list[Cause]:
    """Return the verdicts on the causes that a subject can have."""
    verdicts = (
        _parameters_ignore,
        _outputs_ignore,
        _token_decides,
        _no_sensitivity,
        _labels_cut,
        _no_healthy_record,
        _plants_own,
        _bent,
        _dominated,
        _tails,
        _uneven,
        _few_steps,
        _below_noise,
    )
    return [Cause(text, found.probe.subject, *verdict) for text, verdict in (one(found) for one in verdicts)]


Verdict = tuple[str, tuple[bool, str]]


def _parameters_ignore(a: SubjectAudit) -> Verdict:
    found = [m.replaced[ALL_CHANNELS] for m in a.members]
    leak = "" if a.leakage is None else f" The leakage test finds {a.leakage:.0e} of the bound, for the same reason."
    grown = _range(100.0 * one.parameters_worse[0] for one in found)
    return "the parameters ignore the channels", (
        all(_blind(one.parameters_worse) for one in found),
        f"With the channels of another plant the errors of the parameters change by {grown} %, and the parameters move "
        f"by {_range(one.theta for one in found)} of their bounds; confirmed if no member is surely 5 % worse.{leak}",
    )


def _outputs_ignore(a: SubjectAudit) -> Verdict:
    found = [m.replaced[ALL_CHANNELS].outputs_worse for m in a.members]
    grown = _range(100.0 * one[0] for one in found)
    return "the outputs ignore the channels", (
        all(_blind(one) for one in found),
        f"With the channels of another plant the errors of the outputs change by {grown} %; confirmed if no member is "
        "surely 5 % worse.",
    )


def _blind(worse: tuple[float, float, float]) -> bool:
    return not (worse[0] >= LEAST_WORSE and worse[1] > 0.0)


def _token_decides(a: SubjectAudit) -> Verdict:
    shares = [m.replaced[EVIDENCE].theta / max(m.replaced[EVERYTHING].theta, 1e-12) for m in a.members]
    return "the evidence token decides the parameters", (
        min(shares) >= DECIDES,
        f"The token of another plant alone moves the parameters by {_range(shares)} of their movement with everything "
        f"from there; confirmed if each member has {DECIDES:g} or more.",
    )


def _no_sensitivity(a: SubjectAudit) -> Verdict:
    return "no channel holds a sensitivity of the twin", (
        a.sensitivities == 0,
        f"{a.sensitivities} of {a.channels} channels hold one; confirmed if none does.",
    )


def _labels_cut(a: SubjectAudit) -> Verdict:
    p = a.probe
    there = np.isfinite(p.true)
    counted = there & (p.weight > 0.0)
    error = np.abs(p.start - np.nan_to_num(p.true)) / p.bounds
    share = counted.sum() / there.sum()
    text = f"{100.0 * share:.0f} % of the labels count, with a mean weight of {p.weight[there].mean():.2f}"
    if share < 1.0:
        text += (
            f"; the start's mean error is {error[counted].mean():.3f} of the bound where they count and "
            f"{error[there & ~counted].mean():.3f} where they do not"
        )
    return "a label counts only where the fit can identify it", (share < 1.0, f"{text}; confirmed if any is left out.")


def _no_healthy_record(a: SubjectAudit) -> Verdict:
    cause = "the network uses nothing of its plant's healthy record"
    if a.probe.inputs["memory"] is None:
        return cause, (True, "It has no token of that record.")
    found = [m.replaced[MEMORY] for m in a.members]
    used = [max(one.parameters_worse[0], one.outputs_worse[0]) for one in found]
    return cause, (
        max(used) < LEAST_WORSE,
        f"It has tokens of that record, and with those of another plant the larger error changes by "
        f"{_range(100.0 * v for v in used)} %; confirmed if no member is 5 % worse.",
    )


def _plants_own(a: SubjectAudit) -> Verdict:
    share = between_plants(a.probe)
    return "the error that is left belongs to the plant", (
        share >= BELONGS,
        f"{share:.2f} of the variance of the start's mean errors in windows lies between plants; confirmed from "
        f"{BELONGS:g} on.",
    )


def _bent(a: SubjectAudit) -> Verdict:
    p = a.probe
    known = np.isfinite(p.twin_error)
    start, twin = (1e3 * float(np.nanmean(np.abs(np.where(known, e, np.nan)))) for e in (p.start_error, p.twin_error))
    return "the start has bent itself to the model error", (
        start < twin,
        f"Its outputs are off by {start:.0f} mK, those of the twin at the true parameters by {twin:.0f} mK on the same "
        "windows; confirmed if the start is nearer.",
    )


def _dominated(a: SubjectAudit) -> Verdict:
    outputs, parameters, twin = a.terms
    terms = next(iter(a.losses.values()))
    share = share_of(terms, (*outputs, *twin))
    return "the loss is output error", (
        share >= DOMINATES,
        f"Before training the terms of the outputs are {100.0 * share:.0f} % of the loss, those of the parameters "
        f"{100.0 * share_of(terms, parameters):.0f} %; confirmed from {100.0 * DOMINATES:.0f} % on.",
    )


def _tails(a: SubjectAudit) -> Verdict:
    share = worst_share(output_errors(a.probe, 0.0))
    return "the errors of the outputs have heavy tails", (
        share > EXPONENTIAL,
        f"The worst 5 % of the windows hold {100.0 * share:.0f} % of the start's output error; confirmed above the "
        f"{100.0 * EXPONENTIAL:.0f} % of an exponential distribution.",
    )


def _uneven(a: SubjectAudit) -> Verdict:
    outputs, parameters, _ = a.terms
    terms = list(a.losses.values())[-1]
    ratio = gradient_of(terms, outputs) / max(gradient_of(terms, parameters), 1e-30)
    return "outputs and parameters pull unequally at the encoder", (
        not 1.0 / UNEVEN <= ratio <= UNEVEN,
        f"After training the gradient of the output terms in the encoder is {ratio:.2g} times that of the parameter "
        f"terms; confirmed beyond a factor of {UNEVEN:g} either way.",
    )


def _few_steps(a: SubjectAudit) -> Verdict:
    late = [one.late for one in a.trainings]
    epochs = _range(one.epochs for one in a.trainings)
    return "the training was too short for the outputs", (
        min(late) < STILL_FALLS,
        f"It saw each window {epochs} times, and over its last third the error of the outputs on unseen windows "
        f"changed by {_range(100.0 * v for v in late)} % of the start's; confirmed if it fell by "
        f"{-100.0 * STILL_FALLS:g} %.",
    )


def _below_noise(a: SubjectAudit) -> Verdict:
    sizes, noise = [1e3 * m.correction.delta_K for m in a.members], 1e3 * a.probe.noise_K
    return "the corrections of the outputs are below the noise", (
        max(sizes) < noise,
        f"They move the outputs by {_range(sizes)} mK, and a reading has {noise:.0f} mK of noise; confirmed if each "
        "member's are smaller.",
    )


def blind_outputs(found: SubjectAudit, learned: str, others: str, start: str) -> list[Cause]:
    """Return the verdicts on explanations of blind outputs of members that have a factor on their corrections.

    Parameters
    ----------
    learned, others
        Kinds of windows of `OutputGain`: those of the training, and the same kind of record of unseen plants.
    start
        The start that learned from neither kind.
    """
    if not found.factors or not found.gains:
        return []
    explained = (
        _stored_zero(found.factors),
        _head_at_zero(found),
        _stopped_early(found),
        _nothing_left(found),
        _by_heart(found, learned, others, start),
    )
    return [Cause(text, found.probe.subject, *verdict) for text, verdict in explained]


def _stored_zero(factors: Mapping[str, float]) -> Verdict:
    return "a stored factor of zero removes the correction", (
        all(v == 0.0 for v in factors.values()),
        f"The members hold factors of {_range(factors.values())}; at 0 the outlet is the start's to the last digit, "
        "and the gate finds exactly 0 %. Confirmed if each is 0.",
    )


def _head_at_zero(a: SubjectAudit) -> Verdict:
    before = next(iter(a.losses.values()))
    outputs, parameters = (
        gradient_of(before, names, place)
        for names, place in zip(a.terms[:2], ("output_head", "parameter_head"), strict=True)
    )
    sizes = [1e3 * gain.size_K for gain in a.gains]
    return "the output head starts at zero and never moves", (
        max(sizes) < LEAST_MK,
        f"Before training the gradient in the output head is {outputs:.2g}, and in the parameter head "
        f"{parameters:.2g}. After it the correction without its factor is {_range(sizes)} mK; confirmed below "
        f"{LEAST_MK:g} mK.",
    )


def _stopped_early(a: SubjectAudit) -> Verdict:
    since = [_since(one.factors or {}) for one in a.trainings]
    fell = [one.losses[1] / one.losses[0] - 1.0 for one in a.trainings if one.losses]
    return "the training was too short", (
        any(step is None for step in since),
        f"The factor on held-out stations has been 0 since step {_range(s for s in since if s is not None)}, while the "
        f"loss of the outputs on training stations changed by {_range(100.0 * v for v in fell)} % from the first "
        "evaluation to the last; confirmed if a factor is above 0 at the end.",
    )


def _nothing_left(a: SubjectAudit) -> Verdict:
    error, noise = a.probe.start_error[..., 0], 1e3 * a.probe.noise_K
    whole = 1e3 * float(np.nanmean(np.abs(error)))
    rest = 1e3 * float(np.nanmean(np.abs(error - mean_known(error)[:, None])))
    return "the start leaves nothing to correct", (
        whole < noise,
        f"On unseen stations the start errs by {whole:.0f} mK, of which {rest:.0f} mK remain without each window's "
        f"mean error; confirmed if it errs by less than the noise of a reading, {noise:.0f} mK.",
    )


def _by_heart(a: SubjectAudit, learned: str, others: str, start: str) -> Verdict:
    gains = {kind: [g for g in a.gains if g.of == kind and g.start == start] for kind in (learned, others)}
    change = {kind: [100.0 * g.change[0] for g in some] for kind, some in gains.items()}
    rest = [100.0 * g.change[0] for g in a.gains if g.start == start and g.of not in gains]
    return "the correction was learned by heart", (
        float(np.mean(change[learned])) < 0.0 <= float(np.mean(change[others])),
        f"Added to {start}, it changes the outlet's error by {_range(change[learned])} % on {learned}, by "
        f"{_range(change[others])} % on {others}, and by {_range(rest)} % elsewhere. On the former "
        f"{_range(g.between for g in gains[learned])} of the variance of its means lies between cells. Confirmed if "
        "its mean over members helps on the former alone.",
    )


def _since(factors: Mapping[int, float]) -> int | None:
    """Return the first step from which on the factor stays 0; None if it is not 0 at the end."""
    last = None
    for step, factor in sorted(factors.items(), reverse=True):
        if factor > 0.0:
            break
        last = step
    return last


def _range(values: Iterable[float]) -> str:
    found = [float(v) for v in values]
    if not found:
        return "-"
    low, high = (_short(v) for v in (min(found), max(found)))
    return low if low == high else f"{low} to {high}"


def _short(value: float) -> str:
    """Return two significant digits without an exponent where a reader can do without one."""
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.2g}"
