"""Trials on simulated stations of several seeds: an undeclared recirculation to be named, defects to be found.

Each seed is a station with hidden recirculation, at Chicago and Miami by turns, and has two archives. The clean one has
no seeded defect: every finding of the alignment is invented, and `hil diagnose` must name the recirculation. Into the
other one defects are seeded. The key is asked after the answers alone.
"""

from __future__ import annotations

import datetime
import json
import shutil
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from drivers.historian import open_store
from drivers.virtual.tower import SITES, SimulationPlan, key_of, simulate, with_defects, write_station
from hil.bench.measure import Cell, ReportTable
from hil.tower import align_station, commission_cell, diagnose_station, document, read_station
from twin import save

HIDDEN = "recirculation"
CELLS = 2
"""Cells with a record: two thermometers of one kind can be swapped. The first is diagnosed."""
NAMED = 0.9
"""Goals: share of the seeds whose recirculation is named, and of the seeded defects that are found."""
FOUND = 0.95
YEAR_D = 365.25
SLACK_S = 3 * 3600.0
"""Time by which an end of a finding may differ from the seeded one, and the share of the shorter span that both must
have in common."""
IN_COMMON = 0.3
ALSO = {"range_change": ("contradicted", "out_of_range")}
"""Further types by which an alignment names a defect: an air instrument of another range contradicts the others."""
DIAGNOSES = (
    "seed",
    "station",
    "from deg",
    "named",
    "found from deg",
    "share",
    "found share",
    "p value",
    "error before K",
    "error after K",
    "before without offset K",
    "after without offset K",
    "further",
)


@dataclass(frozen=True)
class NamedEffect:
    """Diagnosis of one seed: station, true direction and share of exhaust at a wind of 5 m/s, whether it was named, its
    document's entry if so, errors on untouched weeks K, and the names of further effects that the station does not
    have."""

    seed: int
    station: str
    direction: float
    share: float
    named: bool
    entry: Mapping[str, Any]
    error: Mapping[str, float | None]
    further: tuple[str, ...]


@dataclass(frozen=True)
class FoundDefects:
    """Defects of one store: seeded and found by kind, and findings that match none, by kind; processor time of its
    alignment, s, and the days of its cells."""

    seed: int
    station: str
    seeded: Mapping[str, int]
    found: Mapping[str, int]
    invented: Mapping[str, int]
    cpu_s: float = 0.0
    cell_days: float = 0.0


@dataclass(frozen=True)
class StationTrials:
    """Results of all seeds."""

    months: float
    effects: tuple[NamedEffect, ...]
    defects: tuple[FoundDefects, ...]
    clean: tuple[FoundDefects, ...]


def try_stations(
    folder: Path,
    seeds: Sequence[int],
    months: float,
    weather: Path | None,
    note: Callable[[str], None] = lambda text: None,
) -> StationTrials:
    """Return the trials of these seeds; their stations lie in `folder` until their seed is done.

    Parameters
    ----------
    months
        Length of each record.
    weather
        Folder of .epw and .tm2 files; None for a seeded generator.

    Raises
    ------
    OSError
        The folder cannot be written.
    RecordError, TwinFileError
        A station cannot be aligned, commissioned or diagnosed.
    """
    effects, spoilt, clean = [], [], []
    for k, seed in enumerate(seeds):
        place = folder / f"seed{seed}"
        site = SITES[k % len(SITES)]
        note(f"seed {seed}: simulating station {site.station}")
        made = simulate(site, CELLS, SimulationPlan(months, CELLS, seed, hide=(HIDDEN,), weather=weather))
        key = key_of(made)
        write_station(made, place / "clean", score=False)
        made = with_defects(made)
        spoilt_key = key_of(made)
        write_station(made, place / "defects", score=False)
        del made
        clean.append(_defects(seed, site.station, key, place / "clean"))
        spoilt.append(_defects(seed, site.station, spoilt_key, place / "defects"))
        note(f"seed {seed}: {sum(spoilt[-1].found.values())} of {sum(spoilt[-1].seeded.values())} defects; diagnosing")
        effects.append(_diagnosed(seed, site.station, key, place / "clean"))
        note(f"seed {seed}: {'named' if effects[-1].named else 'missed'}")
        shutil.rmtree(place)
    return StationTrials(months, tuple(effects), tuple(spoilt), tuple(clean))


def align_folder(station: Path) -> None:
    """Align the store in a station's folder into its folder `record`; raises as `align_station`."""
    described = read_station(station / "tags.csv", station / "datasheet.json", station / "events.csv")
    with open_store(station) as store:
        align_station(store, described, station / "record")


def _diagnosed(seed: int, name: str, key: Mapping[str, Any], station: Path) -> NamedEffect:
    network, _, _ = commission_cell(1, station / "datasheet.json", station / "commissioning.csv")
    twin = station / "cell1.toml"
    save(network, twin)
    told = document(diagnose_station(station / "record", [twin], station / "labels.csv"))
    mine = [e for e in told["effects"] if e["kind"] == HIDDEN and e["driver"] == key["answer"]["driver"]]
    entry = mine[0] if mine else {}
    error = entry["error_K"] if entry else told["error_K"]["1"]
    further = tuple(f"{e['kind']} by {e['driver']}" for e in told["effects"] if e not in mine[:1])
    true = key["answer"]
    return NamedEffect(
        seed, name, float(true["from_deg"]), float(true["share_at_5_m_s"]), bool(mine), entry, error, further
    )


def _defects(seed: int, name: str, key: Mapping[str, Any], station: Path) -> FoundDefects:
    """Align a station and compare its report with the key."""
    began = time.process_time()
    align_folder(station)
    cost = time.process_time() - began
    report = json.loads((station / "record" / "alignment.json").read_text())
    days = len(report["cells"]) * report["minutes"] / 1440.0
    return replace(match_defects(seed, name, key["defects"], report["defects"]), cpu_s=cost, cell_days=days)


def match_defects(
    seed: int, station: str, seeded: Sequence[Mapping[str, Any]], findings: Sequence[Mapping[str, Any]]
) -> FoundDefects:
    """Return how many of the seeded defects a report of an alignment holds, and what it has beside them.

    A finding is a seeded defect's if it has its type, or one of `ALSO`, one of its tags and `IN_COMMON` of the shorter
    span. It may be that of several.
    """
    count: Counter[str] = Counter(str(one["type"]) for one in seeded)
    found: Counter[str] = Counter()
    used: set[int] = set()
    for one in seeded:
        mine = [j for j, other in enumerate(findings) if _same(one, other)]
        found[str(one["type"])] += bool(mine)
        used |= set(mine)
    invented: Counter[str] = Counter(str(other["type"]) for j, other in enumerate(findings) if j not in used)
    return FoundDefects(seed, station, dict(count), dict(found), dict(invented))


def _same(seeded: Mapping[str, Any], finding: Mapping[str, Any]) -> bool:
    tags = set(seeded.get("tags") or [t for t in (seeded.get("tag"),) if t])
    types = {seeded["type"], *ALSO.get(str(seeded["type"]), ())}
    if finding["type"] not in types or (tags and not tags & set(finding["tags"])):
        return False
    (a, b), (c, d) = ((_time(one["from"]), _time(one["to"])) for one in (seeded, finding))
    return bool(min(b, d) - max(a, c) + SLACK_S > IN_COMMON * (min(b - a, d - c) + SLACK_S))


def _time(text: str) -> float:
    return datetime.datetime.fromisoformat(text.replace("Z", "+00:00")).timestamp()


def tables_of(trials: StationTrials) -> list[ReportTable]:
    """Return the tables: effects by seed, defects by kind, findings on clean stores, and the goals."""
    n = len(trials.effects)
    rows: list[tuple[Cell, ...]] = []
    for one in trials.effects:
        e, x = one.error, one.entry
        errors = (e["before"], e["after"], e["before_without_offset"], e["after_without_offset"])
        further = ", ".join(one.further) or "none"
        named = "yes" if one.named else "no"
        about_it = x.get("from_deg"), one.share, x.get("size"), x.get("p_value")
        rows.append((str(one.seed), one.station, one.direction, named, *about_it, *errors, further))
    seeded = _total([d.seeded for d in trials.defects])
    found = _total([d.found for d in trials.defects])
    invented = _total([d.invented for d in trials.defects])
    clean = _total([d.invented for d in trials.clean])
    kinds = sorted(set(seeded) | set(invented) | set(clean))
    defects: list[tuple[Cell, ...]] = [
        (kind, seeded[kind], found[kind], _rate(found[kind], seeded[kind]), invented[kind], clean[kind])
        for kind in kinds
    ]
    totals = [sum(one.values()) for one in (seeded, found, invented, clean)]
    defects.append(("all", *totals[:2], _rate(totals[1], totals[0]), *totals[2:]))
    names = sum(one.named for one in trials.effects)
    share = sum(found.values()) / max(sum(seeded.values()), 1)
    goals: list[tuple[Cell, ...]] = [
        (f"recirculation named in {NAMED:g} of the seeds", names / n, "yes" if names >= NAMED * n else "no"),
        (f"{FOUND:g} of the seeded defects found", share, "yes" if share >= FOUND else "no"),
        ("no defect invented on a clean store", sum(clean.values()), "no" if clean else "yes"),
    ]
    about = f"{n} stations of {trials.months:g} months, one cell, hidden recirculation with wind from one direction"
    return [
        ReportTable(
            "recirculation",
            about,
            DIAGNOSES,
            tuple(rows),
            (
                "errors on the held-out weeks; further: effects that were claimed and are not there",
                "share: of exhaust in the air that enters, at a wind of 5 m/s",
            ),
        ),
        ReportTable(
            "defects",
            f"Defects of {n} stores of {trials.months:g} months, stations A and B by turns, and of {n} clean stores",
            ("defect", "seeded", "found", "share found", "invented beside them", "invented in clean stores"),
            tuple(defects),
            (f"found: type, a tag and {IN_COMMON:g} of the shorter span agree",),
        ),
        ReportTable("goals", "Goals", ("goal", "found", "reached"), tuple(goals)),
        ReportTable(
            "cost",
            "Cost of the alignment",
            ("stores", "number", "cell days", "CPU s", "CPU s a cell and year"),
            (_cost_row("with defects", trials.defects), _cost_row("clean", trials.clean)),
        ),
    ]


def _cost_row(name: str, stores: Sequence[FoundDefects]) -> tuple[Cell, ...]:
    days, cost = sum(one.cell_days for one in stores), sum(one.cpu_s for one in stores)
    return name, len(stores), days, cost, cost / days * YEAR_D if days > 0.0 else None


def _rate(found: int, seeded: int) -> float | None:
    return found / seeded if seeded else None


def _total(counts: Sequence[Mapping[str, int]]) -> Counter[str]:
    total: Counter[str] = Counter()
    for one in counts:
        total.update(one)
    return total
