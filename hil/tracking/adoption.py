"""Adoption of parameters that the network's gates accept: none, a sentence, or the twin's next revision.

The live twin of the network takes the parameters in any case: it is one of several twins under comparison and has no
effect on the rig. The mode governs the twin file. *shadow* does not change it and reports nothing; *advisory* reports
the changes; *controlled* saves one revision at the end. That revision has the parameters on which several proposals in
a row agree. It is saved only if its prediction of a held-out last segment is calibrated or clearly better.
"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from hil.files import estimate_text
from hil.tracking.twins import Proposed
from twin import NORMAL90

if TYPE_CHECKING:
    from hil.record import Record
    from twin import Network

NetworkMode = Literal["shadow", "advisory", "controlled"]
MODES: tuple[NetworkMode, ...] = get_args(NetworkMode)
NETWORK = "hiera_unet"
HELD = ": held"
"""End of a reason that holds one parameter."""
HELD_OUT_S = 3600.0
HELD_OUT_SHARE = 0.2
WORSE = 1.02
"""Largest ratio of a sensor's error after adoption to its error before: room for noise alone."""
IN_A_ROW = 3
"""Consecutive accepted proposals of a parameter that have to agree."""
CLEARLY = 0.75
"""Largest ratio of the mean square after to that before, of a twin that is better but not calibrated, with probability
`SURE`.
"""
SURE = 0.95
BLOCK_S = 300.0
"""Length in s of the blocks of the bootstrap of `SURE`: errors within minutes are correlated."""
DRAWS = 1000


@dataclass(frozen=True, slots=True)
class Accepted:
    """Parameter as accepted last: value, half width of its 90 % interval, times of first and last acceptance, count in
    a row.
    """

    value: float
    half_width: float
    first_s: float
    last_s: float
    count: int


@dataclass(frozen=True, slots=True)
class Adoption:
    """Revision that was saved, or None with the reason."""

    path: Path | None
    sentence: str


def accepted(proposals: Iterable[Proposed], in_a_row: int = 1) -> dict[str, Accepted]:
    """Return the parameters whose latest `in_a_row` proposals passed the gates and agree.

    Two proposals agree if each lies within the other's interval. A parameter that is only held since then keeps its
    value. One that passed since then without agreement is left out.
    """
    rows: dict[str, Accepted] = {}
    settled: dict[str, Accepted] = {}
    for proposed in proposals:
        document, now = proposed.document, proposed.time_s
        for name, value in document["values"].items():
            if name in document["held"]:
                rows.pop(name, None)
                continue
            half, before = NORMAL90 * document["standard_errors"][name], rows.get(name)
            if before and abs(value - before.value) <= min(half, before.half_width):
                rows[name] = Accepted(value, half, before.first_s, now, before.count + 1)
            else:
                rows[name] = Accepted(value, half, now, now, 1)
                settled.pop(name, None)
            if rows[name].count >= in_a_row:
                settled[name] = rows[name]
    return {name: settled[name] for name in sorted(settled)}


class Advice:
    """Reporter of new changes that adoption would make in the twin file."""

    def __init__(self, network: Network) -> None:
        self._units = {name: p.unit for name, p in network.parameters.items()}
        self._said = {name: p.value for name, p in network.parameters.items()}

    def news(self, proposed: Proposed) -> str | None:
        """Return a sentence if an accepted value left the last reported one by more than its own 90 % interval, else
        None.
        """
        told = []
        for name, now in accepted([proposed]).items():
            if abs(now.value - self._said[name]) > now.half_width:
                unit = "" if self._units[name] == "1" else f" {self._units[name]}"
                told.append(f"{name} {self._said[name]:.4g} -> {estimate_text(now.value, now.half_width)}{unit}")
                self._said[name] = now.value
        return f"{proposed.calibrator} would change {', '.join(told)}" if told else None


def adopt(twin: Path, record: Record, proposals: list[Proposed], made_by: str) -> Adoption:
    """Save the accepted parameters as the next revision of `twin`, if it predicts better.

    Raises
    ------
    TwinFileError
        The twin or its folder cannot be used.
    """
    from twin import Revision, load, save_revision, with_elements

    network = load(twin)
    begin_s, end_s = float(record.time_s[0]), float(record.time_s[-1])
    until_s = end_s - min(HELD_OUT_S, HELD_OUT_SHARE * (end_s - begin_s))
    seen = [proposed for proposed in proposals if proposed.time_s <= until_s]
    taken = accepted(seen, IN_A_ROW)
    if not taken:
        none = f"no parameter passed the gates {IN_A_ROW} times in a row with values that agree"
        return Adoption(None, f"no revision is saved: {none}; {closed_gates(seen)}")
    values = {name: a.value for name, a in taken.items()}
    late = record.time_s > until_s
    misses = [_prediction_errors(n, record) for n in (network, with_elements(network, {}, values))]
    for a in _excluded_intervals(proposals):
        # Excluded sensors count neither for nor against a revision.
        rows = (record.time_s >= a.since_s) & (record.time_s <= a.until_s)
        for miss in misses:
            miss[rows, network.sensor_names.index(a.sensor)] = np.nan
    misses = [miss[late] for miss in misses]
    before, after = (_errors(m, network) for m in misses)
    if why := _objection(before, after, misses, record.time_s[late], network):
        return Adoption(None, f"no revision is saved: with the {len(taken)} accepted parameters {why} at the end")
    first, last = min(a.first_s for a in taken.values()), max(a.last_s for a in taken.values())
    revision = Revision(
        made_by=made_by,
        window_s=(begin_s, until_s),
        error_before_K=before,
        error_after_K=after,
        held_out_s=(until_s, end_s),
        evidence=f"{NETWORK} proposed {len(seen)} times and its gates accepted {len(taken)} of "
        f"{len(seen[-1].document['values'])} parameters between {first / 3600:.2f} and {last / 3600:.2f} h",
        notes=(*(_note(name, a, network) for name, a in taken.items()), closed_gates(seen)),
    )
    path = save_revision(with_elements(network, {}, values, revision), twin)
    worst = max(before, key=lambda s: before[s])
    return Adoption(
        path,
        f"{NETWORK}: {len(taken)} accepted parameters are saved as {path} ({worst} {before[worst]:.3f} -> "
        f"{after[worst]:.3f} K on the held-out end of the record); `hil twin revert` undoes it",
    )


def _objection(
    before: dict[str, float],
    after: dict[str, float],
    misses: list[NDArray[np.float64]],
    time_s: NDArray[np.float64],
    network: Network,
) -> str | None:
    """Return the objection to a revision, from RMSE in K by sensor and prediction errors (n, m) K before and after, or
    None.
    """
    worse = [s for s in before if after[s] > WORSE * before[s]]
    if worse:
        return f"{worse[0]} is predicted worse"
    squares = [np.nansum((m / network.sigma) ** 2, axis=1) for m in misses]
    if not before or squares[1].sum() >= squares[0].sum():
        return "no sensor is predicted better"
    was_K, is_K = (float(np.sqrt(np.nanmean(m**2))) for m in misses)
    if is_K <= network.rules.calibrated_K or clearly_better(squares[0], squares[1], time_s):
        return None
    return (
        f"its prediction error is {is_K:.3f} K, which is neither within {network.rules.calibrated_K:g} K nor "
        f"clearly better than {was_K:.3f} K"
    )


def clearly_better(before: NDArray[np.float64], after: NDArray[np.float64], time_s: NDArray[np.float64]) -> bool:
    """Return True if squares (n,) at times (n,) s fell to `CLEARLY` of their former values in a block bootstrap."""
    block = ((time_s - time_s[0]) // BLOCK_S).astype(np.intp)
    sums = np.stack([np.bincount(block, weights=squares) for squares in (before, after)], axis=1)
    drawn = np.random.default_rng(0).integers(len(sums), size=(DRAWS, len(sums)))
    was, now = sums[drawn].sum(axis=1).T
    return bool(np.quantile(now - CLEARLY * was, SURE) <= 0.0)


def _prediction_errors(network: Network, record: Record) -> NDArray[np.float64]:
    """Return predicted minus measured (n, m) K of a free run over the whole record, restarted after gaps."""
    from twin import Kernel, find_segments, hold_inputs, segment_rows, simulate_segments

    inputs, measured = network.select(record.columns)
    known, time_s = find_segments(network, record.time_s, inputs), record.time_s
    measured[known.lost] = np.nan
    firsts = [
        slice(r.start, max(r.start + 1, int(np.searchsorted(time_s, time_s[r.start] + 30.0))))
        for r in segment_rows(known.begins, len(time_s))
    ]
    start = np.concatenate([network.initial_state(measured[first]) for first in firsts])
    run = simulate_segments(
        Kernel(network, ()), network.values[None], start[None], time_s, hold_inputs(network, inputs), known.begins
    )[0]
    miss: NDArray[np.float64] = run - measured
    return miss


def _errors(miss: NDArray[np.float64], network: Network) -> dict[str, float]:
    """Return RMSE in K by sensor of prediction errors (n, m) K, for sensors with readings."""
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
        f"{name}: {parameter.value:.4g} -> {estimate_text(a.value, a.half_width)}{unit} (90 %), accepted in {a.count} "
        f"proposals in a row, last at {a.last_s / 3600:.2f} h"
    )


def closed_gates(proposals: list[Proposed]) -> str:
    """Return the share and reasons of closed gates, most frequent first, held parameters, and excluded sensors."""
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
    return "; ".join([*parts, *_exclusions(proposals)])


class _Exclusion(NamedTuple):
    """Interval in which a sensor was excluded; `until_s` is infinite if it still was in the last proposal."""

    sensor: str
    since_s: float
    until_s: float
    off_K: float


def _excluded_intervals(proposals: list[Proposed]) -> list[_Exclusion]:
    intervals: dict[tuple[str, float], _Exclusion] = {}
    last_s = proposals[-1].time_s if proposals else 0.0
    for proposed in proposals:
        until_s = math.inf if proposed.time_s == last_s else proposed.time_s
        for doubt in proposed.document.get("doubted", ()):
            sensor, since_s = doubt["sensor"], doubt["since_s"]
            intervals[sensor, since_s] = _Exclusion(sensor, since_s, until_s, doubt["off_K"])
    return list(intervals.values())


def _exclusions(proposals: list[Proposed]) -> list[str]:
    """Describe every interval in which a sensor was excluded."""
    told = []
    for a in _excluded_intervals(proposals):
        until = "on" if math.isinf(a.until_s) else f"to {a.until_s / 3600:.2f} h"
        told.append(
            f"{a.sensor} excluded from {a.since_s / 3600:.2f} h {until}: it read {offset_text(a.off_K)} than "
            "the other thermometers and any parameter allow"
        )
    return told


def offset_text(off_K: float) -> str:
    """Describe the offset of a thermometer."""
    return f"{abs(off_K):.2f} K {'more' if off_K > 0.0 else 'less'}"


def adoption_manifest(adoption: Adoption | None) -> dict[str, Any] | None:
    """Return the adoption as plain data for `run.json`."""
    if adoption is None:
        return None
    return {key: None if value is None else str(value) for key, value in dataclasses.asdict(adoption).items()}
