"""What becomes of parameters that the network's gates let through: nothing, a sentence, or the twin's next revision.

The live twin of the network takes them on in any case: it is one of several that are compared, and steers nothing. The
twin file is another matter. *shadow* leaves it alone and says nothing; *advisory* says what would change; *controlled*
saves one revision at the end, of what was accepted before a last part of the record that neither saw, and only where
that part is foretold better for it.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from hil.bands import NORMAL90
from hil.tracking import Proposed

if TYPE_CHECKING:
    from hil.record import Record
    from twin.network import Network

NetworkMode = Literal["shadow", "advisory", "controlled"]
MODES: tuple[NetworkMode, ...] = get_args(NetworkMode)
NETWORK = "hiera_unet"
HELD = ": held"
"""How a reason ends that holds one parameter."""
HELD_OUT_S = 3600.0
HELD_OUT_SHARE = 0.2
WORSE = 1.02
"""Times its error before that a sensor may have afterwards, for noise alone."""


@dataclass(frozen=True, slots=True)
class Accepted:
    """A parameter as accepted last: value and half width of its 90 % interval; when first and last, how often."""

    value: float
    half_width: float
    first_s: float
    last_s: float
    count: int


@dataclass(frozen=True, slots=True)
class Adoption:
    """The revision that was saved, or None and why not."""

    path: Path | None
    sentence: str


def accepted(proposals: Iterable[Proposed], until_s: float = np.inf) -> dict[str, Accepted]:
    """Parameters that the gates let through in proposals up to `until_s`."""
    found: dict[str, Accepted] = {}
    for proposed in proposals:
        if proposed.time_s > until_s:
            continue
        document, now = proposed.document, proposed.time_s
        for name in document["values"].keys() - set(document["held"]):
            before = found.get(name)
            found[name] = Accepted(
                document["values"][name],
                NORMAL90 * document["standard_errors"][name],
                before.first_s if before else now,
                now,
                before.count + 1 if before else 1,
            )
    return {name: found[name] for name in sorted(found)}


class Advice:
    """Says what would change in the twin file, where that is news."""

    def __init__(self, network: Network) -> None:
        self._units = {name: p.unit for name, p in network.parameters.items()}
        self._said = {name: p.value for name, p in network.parameters.items()}

    def news(self, proposed: Proposed) -> str | None:
        """A sentence where an accepted value has left what was said before by more than its own 90 % interval."""
        told = []
        for name, now in accepted([proposed]).items():
            if abs(now.value - self._said[name]) > now.half_width:
                unit = "" if self._units[name] == "1" else f" {self._units[name]}"
                told.append(f"{name} {self._said[name]:.4g} -> {now.value:.4g} ± {now.half_width:.2g}{unit}")
                self._said[name] = now.value
        return f"{proposed.calibrator} would change {', '.join(told)}" if told else None


def adopt(twin: Path, record: Record, proposals: list[Proposed], made_by: str) -> Adoption:
    """Save what was accepted as the next revision of `twin`, if it is worth it.

    Raises:
        TwinFileError: the twin or its folder cannot be used.
    """
    from twin.network import Revision
    from twin.revisions import save_revision, with_elements
    from twin.twinfile import load

    network = load(twin)
    begin_s, end_s = float(record.time_s[0]), float(record.time_s[-1])
    until_s = end_s - min(HELD_OUT_S, HELD_OUT_SHARE * (end_s - begin_s))
    seen = [proposed for proposed in proposals if proposed.time_s <= until_s]
    taken = accepted(seen)
    if not taken:
        return Adoption(None, f"no revision is saved: {closed_gates(seen)}")
    values = {name: a.value for name, a in taken.items()}
    before, after = (_errors(n, record, until_s) for n in (network, with_elements(network, {}, values)))
    noise = dict(zip(network.sensor_names, network.sigma.tolist(), strict=True))
    total = [sum((errors[s] / noise[s]) ** 2 for s in before) for errors in (before, after)]
    worse = [s for s in before if after[s] > WORSE * before[s]]
    if not before or worse or total[1] >= total[0]:
        why = f"{worse[0]} is foretold worse" if worse else "nothing is foretold better"
        return Adoption(None, f"no revision is saved: with the {len(taken)} accepted parameters {why} at the end")
    first, last = min(a.first_s for a in taken.values()), max(a.last_s for a in taken.values())
    revision = Revision(
        made_by=made_by,
        window_s=(begin_s, until_s),
        error_before_K=before,
        error_after_K=after,
        held_out_s=(until_s, end_s),
        evidence=f"{NETWORK} proposed {len(seen)} times and its gates let through {len(taken)} of "
        f"{len(seen[-1].document['values'])} parameters between {first / 3600:.2f} and {last / 3600:.2f} h",
        notes=(*(_note(name, a, network) for name, a in taken.items()), closed_gates(seen)),
    )
    path = save_revision(with_elements(network, {}, values, revision), twin)
    worst = max(before, key=lambda s: before[s])
    return Adoption(
        path,
        f"{NETWORK}: {len(taken)} accepted parameters are saved as {path} ({worst} {before[worst]:.3f} -> "
        f"{after[worst]:.3f} K on the end of the record, which none of them saw); `hil twin revert` undoes it",
    )


def _errors(network: Network, record: Record, from_s: float) -> dict[str, float]:
    """Sensor -> RMSE in K of a free run over the whole record, counted from `from_s` on; begun anew after gaps."""
    from twin.kernel import Kernel, held
    from twin.stretches import parts, stretches, traced

    inputs, measured = network.select(record.columns)
    known, time_s = stretches(network, record.time_s, inputs), record.time_s
    measured[known.lost] = np.nan
    firsts = [slice(r.start, max(r.start + 1, int(np.searchsorted(time_s, time_s[r.start] + 30.0))))
              for r in parts(known.begins, len(time_s))]  # fmt: skip
    start = np.concatenate([network.initial_state(measured[first]) for first in firsts])
    run = traced(
        Kernel(network, ()), network.values[None], start[None], time_s, held(network, inputs), known.begins
    )[0]  # fmt: skip
    miss: NDArray[np.float64] = (run - measured)[time_s > from_s]
    good = np.isfinite(miss)
    return {
        sensor: float(np.sqrt(np.mean(miss[good[:, j], j] ** 2)))
        for j, sensor in enumerate(network.sensor_names)
        if good[:, j].any()
    }


def _note(name: str, a: Accepted, network: Network) -> str:
    parameter = network.parameters[name]
    unit = "" if parameter.unit == "1" else f" {parameter.unit}"
    return (
        f"{name}: {parameter.value:.4g} -> {a.value:.4g} ± {a.half_width:.2g}{unit} (90 %), accepted in {a.count} "
        f"proposals, last at {a.last_s / 3600:.2f} h"
    )


def closed_gates(proposals: list[Proposed]) -> str:
    """How often gates held everything, and why, the commonest reason first; then what holds single parameters."""
    if not proposals:
        return f"{NETWORK} has proposed nothing"
    whole: Counter[str] = Counter()
    single: Counter[str] = Counter()
    latest: dict[str, str] = {}
    for proposed in proposals:
        reasons = [reason.split(": ", 1) for reason in proposed.document["reasons"]]
        latest |= {code: sentence for code, sentence in reasons if not sentence.endswith(HELD)}
        whole.update(dict.fromkeys((code for code, sentence in reasons if not sentence.endswith(HELD)), 1))
        single.update(dict.fromkeys((code for code, sentence in reasons if sentence.endswith(HELD)), 1))
    shut = sum(len(p.document["held"]) == len(p.document["values"]) for p in proposals)
    parts = [f"{NETWORK} held everything in {shut} of {len(proposals)} proposals"]
    parts += [f"{code} in {n} ({latest[code]})" for code, n in whole.most_common()]
    if single:
        parts.append("single parameters: " + ", ".join(f"{code} in {n}" for code, n in single.most_common()))
    return "; ".join(parts)


def manifest(adoption: Adoption | None) -> dict[str, Any] | None:
    """For `run.json`."""
    if adoption is None:
        return None
    return {key: None if value is None else str(value) for key, value in dataclasses.asdict(adoption).items()}
