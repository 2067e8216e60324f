"""Bench of trained tower networks and their rivals on simulated stations that no training saw."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hil.bench.measure import Cell, ReportTable
from hil.training.tower import BOOSTED, ENSEMBLE, GAUSS_NEWTON, judged_cards, random_table, score_members
from twin.calibrators.hiera_unet.model.config import HieraError

FORWARDS = 20
MOST_MS = {"small": 10.0, "full": 50.0}
"""Limits of a causal forward on one core."""
BELOW, BELOW_AFTER_CHANGE = -0.10, -0.25
DEVIATIONS = ("fill", "air", "uniformity", "bias")
COMPARED = {"water": "outlet", "water_after_fan_change": "30 min after a fan change", **{n: n for n in DEVIATIONS}}
PARTS = {
    "all": "all test stations",
    "site A": "the Chicago station",
    "site B": "the Miami station",
    "family": "other stations",
}


def network_tables(
    folder: Path,
    networks: Sequence[Path],
    device: str = "cpu",
    most: int | None = None,
    note: Callable[[str], None] = lambda _: None,
) -> list[ReportTable]:
    """Score networks on the test split of a folder of simulated stations.

    Raises
    ------
    HieraError
        The folder has no test stations, or a file is no network of a tower.
    """
    members = {f"small_{path.stem}": path for path in networks}
    document, _ = score_members(folder, members, device, most=most, note=note)
    return [*tables_of(document), latency(networks)]


def read_results(path: Path) -> dict[str, Any]:
    """Return the document of scores in a `results.json`, with the stations that a member was adapted to.

    Raises
    ------
    HieraError
        The file holds no scores.
    """
    try:
        found = json.loads(path.read_text())
        evaluation = dict(found["evaluation"])
        dict(evaluation["scores"]["all"])
        cards = judged_cards(found.get("cards", {}))
        codes = _codes(cards) if all("gate" in card for card in cards.values()) else {}
        return {**evaluation, **codes, "adapted": found.get("adapted", {}), "cards": cards}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise HieraError(f"{path}: holds no scores of a training ({error}); give its results.json") from error


def _codes(cards: Mapping[str, Any]) -> dict[str, Any]:
    """Return the gate's codes by the present rule, which may differ from that of the training."""
    if not cards:
        return {}
    heads = {name: card["gate"]["heads"] for name, card in cards.items()}
    return {
        key: {name: _plain(one[head]) for name, one in heads.items()}
        for key, head in (("refused", "parameters"), ("refused_outputs", "outputs"))
    }


def _plain(code: str) -> str:
    return "" if code == "none" else code


def tables_of(document: Mapping[str, Any]) -> list[ReportTable]:
    """Return the tables of a document of `hil.training.tower.evaluate`."""
    found = []
    blind = [name for name, code in document.get("refused_outputs", {}).items() if code]
    for part, scores in document["scores"].items():
        found.append(_outlets(part, scores, blind))
        found.append(_deviations(part, scores))
    found.append(_intervals(document["scores"]["all"]))
    if "by_cell" in document:
        found.append(_by_cell(document["by_cell"]))
    if "causal" in document:
        found += [_further(document), _against(document)]
    if document.get("adapted"):
        found.append(_adapted(document["adapted"]))
    if document.get("cards"):
        found.append(_trained(document["cards"]))
    found.append(_goals(document))
    return found


def _outlets(part: str, scores: Mapping[str, Any], blind: Sequence[str]) -> ReportTable:
    columns = ("method", "MAE K", "RMSE K", "p90 K", "p99 K", "30 min after a fan change K", "readings MAE K")
    names = (
        "water_mae_K",
        "water_rmse_K",
        "water_p90_K",
        "water_p99_K",
        "water_mae_after_fan_change_K",
        "reading_mae_K",
    )
    rows = tuple((method, *(one[n] for n in names)) for method, one in scores.items())
    count = next(iter(scores.values()))["windows"]
    about = f"Outlet against the truth, {PARTS.get(part, part)}, {count} windows of two hours, their readings hidden"
    notes: tuple[str, ...] = ("the last column is against hidden readings, with their bias",)
    if blind:
        notes += (f"the outlet of {', '.join(blind)} is that of the start, as the gate refused their outputs",)
    return ReportTable(f"outlet_{_key(part)}", about, columns, rows, notes)


def _deviations(part: str, scores: Mapping[str, Any]) -> ReportTable:
    rows = []
    for method, one in scores.items():
        mae = one["deviation_mae"]
        rows.append((method, *(100.0 * mae[n] for n in DEVIATIONS[:3]), mae["bias"]))
    about = f"Mean absolute error of the deviations against the truth, {PARTS.get(part, part)}"
    columns = ("method", "fill %", "air %", "uniformity %", "bias K")
    return ReportTable(f"deviations_{_key(part)}", about, columns, tuple(rows))


def _intervals(scores: Mapping[str, Any]) -> ReportTable:
    columns = ("method", "outlet within 90 %", "width K", "score K", *(f"{n} within 90 %" for n in DEVIATIONS))
    rows = []
    for method, one in scores.items():
        inside = one.get("deviation_inside_90")
        if inside is None:
            continue
        outlet = (one.get("water_inside_90"), one.get("water_width_K"), one.get("water_interval_score_K"))
        rows.append((method, *outlet, *(inside[n] for n in DEVIATIONS)))
    notes = ("the networks' factors are set on validation stations; Gauss-Newton's intervals are its own",)
    return ReportTable("intervals", "Intervals on all test stations", columns, tuple(rows), notes)


def _further(document: Mapping[str, Any]) -> ReportTable:
    rows: list[tuple[Cell, ...]] = []
    for name in ("causal", "symmetric", "quarter_lost"):
        one = document[name]
        mae = one["deviation_mae"]
        shares = (100.0 * mae[n] for n in DEVIATIONS[:3])
        rows.append((name.replace("_", " "), one["water_mae_K"], *shares, mae["bias"]))
    columns = ("branch", "outlet MAE K", "fill %", "air %", "uniformity %", "bias K")
    sd = document.get("member_sd", {})
    spread = ", ".join(f"{n} {100.0 * sd[n]:.2f} %" if n != "bias" else f"bias {sd[n]:.3f} K" for n in sd)
    notes = (f"standard deviation of the members: {spread}", "quarter lost: a window lacks a quarter of its channels")
    return ReportTable("branches", "The ensemble in both branches and with channels lost", columns, tuple(rows), notes)


def _by_cell(cells: Mapping[str, Mapping[str, float]]) -> ReportTable:
    methods = [m for m in (GAUSS_NEWTON, BOOSTED, ENSEMBLE) if all(m in one for one in cells.values())]
    rows: list[tuple[Cell, ...]] = [(name, *(one[m] for m in methods)) for name, one in cells.items()]
    notes = ("A: the Chicago station, B: the Miami station, F: the family; number of the station, then of its cell",)
    return ReportTable("cells", "Outlet by test cell, mean absolute error, K", ("cell", *methods), tuple(rows), notes)


def _against(document: Mapping[str, Any]) -> ReportTable:
    """Return errors of the ensemble over those of Gauss-Newton, less one, with their intervals."""
    rows: list[tuple[Cell, ...]] = []
    for name in ("causal", "symmetric", "quarter_lost"):
        compared = document[name]["worse_than_rival"]
        rows.append((name.replace("_", " "), *(_change(*compared[key]) for key in COMPARED)))
    about = f"Error of the ensemble over that of {GAUSS_NEWTON}, less one, with 95 % intervals"
    notes = ("below zero: the network is nearer to the truth; Gauss-Newton has all its channels in each row",)
    return ReportTable("against", about, ("branch", *COMPARED.values()), tuple(rows), notes)


def _seen(change: float) -> float:
    """Return a change, 0 where it is the rounding of single precision."""
    return 0.0 if abs(change) < 1e-6 else change


def _change(mean: float, low: float, high: float) -> str:
    return f"{mean:+.2f} ({low:+.2f} to {high:+.2f})"


def _adapted(stations: Mapping[str, Any]) -> ReportTable:
    """Return the outlet errors of a member before and after it saw nine months of a station's own readings."""
    rows = [
        (
            name,
            one["steps"],
            one["windows"],
            *(one[k]["water_mae_K"] for k in ("belief", "family", "adapted")),
            *(one[k]["reading_mae_K"] for k in ("belief", "family", "adapted")),
        )
        for name, one in stations.items()
    ]
    ways = ("Gauss-Newton", "family", "adapted")
    columns = ("cell", "steps", "windows", *(f"{what} {way} K" for what in ("outlet", "readings") for way in ways))
    notes = ("trained on a family of plants, then on readings of the first 9 of 14 months; scored on the last 3",)
    about = "A member adapted to the station itself, mean absolute errors"
    return ReportTable("adapted", about, columns, tuple(rows), notes)


def _trained(cards: Mapping[str, Any]) -> ReportTable:
    """Return what was trained, for how long, and the figures of the gate."""
    rows: list[tuple[Cell, ...]] = []
    for name, card in cards.items():
        gate = card["gate"]
        rows.append(
            (
                name,
                card["weights"]["count"],
                card["steps_done"],
                card["plan"]["batch"],
                card["seconds"],
                card["device"],
                _change(*gate["parameters_worse"]),
                _change(*gate["outputs_worse"]),
                *(_plain(gate["heads"][head]) or "passed" for head in ("parameters", "outputs")),
            )
        )
    worse = ("parameters worse", "outputs worse", "gate of parameters", "gate of outputs")
    columns = ("member", "weights", "steps", "batch", "s", "device", *worse)
    notes = (
        "worse: with another window's channels, as a share; at least 0.05 and surely above 0, else BLIND",
        "a member with BLIND parameters is refused; with BLIND outputs alone, its outlet is that of its start",
        "the training scored all tables above on its device; the latency alone is of the machine that this page names",
    )
    return ReportTable("trained", "Members and their gate against blindness", columns, tuple(rows), notes)


def _goals(document: Mapping[str, Any]) -> ReportTable:
    rows: list[tuple[Cell, ...]] = []
    best = ENSEMBLE if ENSEMBLE in document["scores"]["all"] else None
    rival = BOOSTED if BOOSTED in document["scores"]["all"] else GAUSS_NEWTON
    if best is not None:
        compared = document["scores"]["all"][best]["worse_than_rival"]
        for name, limit in (("water", BELOW), ("water_after_fan_change", BELOW_AFTER_CHANGE)):
            change, low, high = map(_seen, compared[name])
            label = "outlet" if name == "water" else "outlet, 30 min after a fan change"
            rows.append((label, change, low, high, limit, "yes" if change <= limit and high < 0.0 else "no"))
        for name in DEVIATIONS:
            change, low, high = map(_seen, compared[name])
            rows.append((name, change, low, high, 0.0, "yes" if change <= 0.0 else "no"))
    for head, key in (("parameters", "refused"), ("outputs", "refused_outputs")):
        for name, code in document.get(key, {}).items():
            rows.append((f"{name}: gate, {head}", None, None, None, None, "yes" if not code else f"no: {code}"))
    columns = ("goal", "change", "95 % from", "to", "at most", "reached")
    # Results from before the gate chose the members name none: all small ones were in the ensemble.
    some = document.get("ensemble", [name for name in document["refused"] if name.startswith("small")])
    notes = (f"the ensemble is the mean of {', '.join(some)}", "0: its answer is the rival's own") if best else ()
    return ReportTable("goals", f"Error of the ensemble over that of {rival}, less one", columns, tuple(rows), notes)


def latency(networks: Sequence[Path]) -> ReportTable:
    """Return the median CPU time of a causal forward of one window of random numbers on one thread.

    The first of `networks` is timed, and the full configuration with the weights that it starts with.

    Raises
    ------
    HieraError
        A file is no network of a tower.
    """
    from twin.calibrators.hiera_unet.model.network import HieraUNet
    from twin.calibrators.hiera_unet.tower import Fleet, load_member
    from twin.calibrators.hiera_unet.tower.member import own_rows
    from twin.calibrators.hiera_unet.tower.predict import answer, begun
    from twin.calibrators.hiera_unet.tower.table import SUBJECT
    from twin.calibrators.hiera_unet.weights.device import ready

    ready("cpu", 1)
    fleet = Fleet([random_table(0)])
    windows = own_rows(fleet, 0.0, 1.0)
    first = load_member(networks[0], blind_too=True).network
    timed = [(first.config.name, first)]
    if first.config.name != "full":
        timed.append(("full, untrained", HieraUNet(SUBJECT.config("full")).eval()))
    rows: list[tuple[Cell, ...]] = []
    for name, network in timed:
        making, forward = [], []
        for k in range(FORWARDS):
            began = time.process_time()
            batch = begun(network, fleet.batch(windows[k : k + 1]))
            made = time.process_time()
            answer(network, batch, causal=True, half=False)
            making.append(1e3 * (made - began))
            forward.append(1e3 * (time.process_time() - made))
        limit = MOST_MS.get(network.config.name, MOST_MS["full"])
        middle = float(np.median(forward))
        reached = "yes" if middle <= limit else "no"
        rows.append((name, network.count(), float(np.median(making)), middle, limit, reached))
    columns = ("configuration", "weights", "channels ms", "forward ms", "at most", "reached")
    about = "Causal forward of one window on one thread, CPU time"
    return ReportTable("latency", about, columns, tuple(rows))


def _key(part: str) -> str:
    return part.replace(" ", "_")
