"""Tables of simulated stations in a folder, station by station in parallel, as far as a time limit allows.

A station that is there is not simulated again; so the work may be cut anywhere. `manifest.json` names the stations of
each split and the digest of the data.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import multiprocessing
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hil.training.tower.stations import StationPlan
from twin.calibrators.hiera_unet import HieraError
from twin.calibrators.hiera_unet.tower.table import SUBJECT

MANIFEST = "manifest.json"
TRAIN, VALIDATION, TEST = "train", "validation", "test"
FIRST = {TRAIN: 1, VALIDATION: 8001, TEST: 9001}
"""First seed of the family in each split: no station is in two."""
FAMILY_CELLS = 2
FAMILY_MONTHS, PAPER_MONTHS = 8.0, 14.0
GRACE_S = 25.0
"""Seconds after the time limit in which a station that was begun may end."""
Note = Callable[[str], None]


@dataclass(frozen=True)
class DataPlan:
    """Number of stations in each split, and months of the family's records and of the two sites' among the test.

    Attributes
    ----------
    parts
        Whether training stations are simulated in parts of the paper's 14 months (`StationPlan.segments`).
    """

    train: int = 24
    validation: int = 3
    test: int = 3
    months: float = FAMILY_MONTHS
    site_months: float = PAPER_MONTHS
    parts: bool = False

    def __post_init__(self) -> None:
        """Raises HieraError: a split would reach into the seeds of the next."""
        counts = {TRAIN: self.train, VALIDATION: self.validation, TEST: self.test}
        for split, following in itertools.pairwise(FIRST):
            if FIRST[split] + counts[split] > FIRST[following]:
                raise HieraError(
                    f"{counts[split]} stations of the {split} split reach into the {following} split; give at most "
                    f"{FIRST[following] - FIRST[split]}",
                    code="OVERLAPPING_SPLITS",
                )

    def stations(self) -> list[tuple[str, StationPlan]]:
        """Return splits and stations in the order in which they are simulated: the longest and most needed first."""
        found = []
        if self.site_months > 0.0:
            # The Chicago station has four cells to simulate; one recorded cell of it takes as long as two of the other.
            found += [(TEST, StationPlan(site, FIRST[TEST], self.site_months, n)) for site, n in (("A", 1), ("B", 2))]
        counts = {TRAIN: self.train, VALIDATION: self.validation, TEST: self.test}
        for i in range(max(counts.values())):
            # In turn, so that a cut leaves some of each.
            found += [(split, self._of_family(split, i)) for split, count in counts.items() if i < count]
        return found

    def _of_family(self, split: str, i: int) -> StationPlan:
        parts = self.parts and split == TRAIN
        return StationPlan("F", FIRST[split] + i, PAPER_MONTHS if parts else self.months, FAMILY_CELLS, parts)


def generate(
    plan: DataPlan,
    folder: Path,
    workers: int = 1,
    until: float | None = None,
    note: Note = lambda _: None,
    stopped: Callable[[], bool] = lambda: False,
) -> int:
    """Simulate the stations that `folder` lacks; return the number of stations that are there.

    Parameters
    ----------
    until
        Time.monotonic() after which no station is begun; those that then run have `GRACE_S`.

    Raises
    ------
    HieraError
        The folder holds stations of another plan.
    """
    folder.mkdir(parents=True, exist_ok=True)
    wanted = plan.stations()
    document = _read(folder)
    if document is not None and (document["months"], document["table"]) != (plan.months, SUBJECT.digest()):
        raise HieraError(
            f"{folder}: holds stations of {document['months']:g} months with table {document['table'][:8]}; give "
            "another folder or remove it"
        )
    missing = [one for one in wanted if not _there(folder, one[1])]
    if workers <= 1:
        for _, station in missing:
            if stopped() or (until is not None and time.monotonic() > until):
                break
            note(_station(station, folder))
    elif missing:
        _in_parallel([station for _, station in missing], folder, workers, until, note, stopped)
    _write(folder, plan, wanted)
    return sum(_there(folder, station) for _, station in wanted)


def _in_parallel(
    stations: Sequence[StationPlan],
    folder: Path,
    workers: int,
    until: float | None,
    note: Note,
    stopped: Callable[[], bool],
) -> None:
    from drivers.virtual.tower import MIAMI_SITE, SimulationPlan, commissioning_rows, simulate

    # Compiled once, before the processes part.
    commissioning_rows(simulate(MIAMI_SITE, 1, SimulationPlan(months=0.06, cells=1)))
    context = multiprocessing.get_context("fork")
    began = context.Value("d", 0.0)  # mean seconds of a station of the family
    with context.Pool(workers, initializer=_share, initargs=(began, until)) as pool:
        waiting = [pool.apply_async(_guarded, (station, folder)) for station in stations]
        while waiting and not stopped():
            waiting[0].wait(0.5)
            for one in [w for w in waiting if w.ready()]:
                waiting.remove(one)
                if said := one.get():
                    note(said)
            if until is not None and time.monotonic() > until + GRACE_S:
                note(f"time is over; {len(waiting)} stations are left out")
                break
        pool.terminate()


_shared: tuple[Any, float | None] | None = None


def _share(seconds: Any, until: float | None) -> None:
    global _shared
    _shared = seconds, until
    os.environ["OMP_NUM_THREADS"] = "1"


def _guarded(station: StationPlan, folder: Path) -> str:
    assert _shared is not None
    usual, until = _shared
    now = time.monotonic()
    if until is not None and now + 0.8 * usual.value > until + 0.5 * GRACE_S:
        return ""
    try:
        said = _station(station, folder)
    except Exception as error:  # one station that cannot be made leaves the others
        return f"{station.name}: left out, {type(error).__name__}: {error}"
    if station.site == "F":
        usual.value = time.monotonic() - now if not usual.value else 0.7 * usual.value + 0.3 * (time.monotonic() - now)
    return said


def _station(station: StationPlan, folder: Path) -> str:
    from hil.training.tower.stations import station_cells, table_of

    began = time.monotonic()
    cells = station_cells(station)
    for cell in cells:
        table_of(cell, station.segments()).save(folder / f"{cell.name}.npz")
    (folder / f"{station.name}.done").write_text(json.dumps(asdict(station)) + "\n")
    return f"{station.name}: {len(cells)} cells of {station.months:g} months in {time.monotonic() - began:.0f} s"


def _there(folder: Path, station: StationPlan) -> bool:
    return (folder / f"{station.name}.done").is_file()


def _write(folder: Path, plan: DataPlan, wanted: Sequence[tuple[str, StationPlan]]) -> None:
    there = [(split, station) for split, station in wanted if _there(folder, station)]
    rows = [{"split": split, **asdict(station)} for split, station in there]
    document = {"format": 1, "table": SUBJECT.digest(), "months": plan.months, "stations": rows}
    text = json.dumps(document, sort_keys=True)
    document["digest"] = hashlib.sha256(text.encode()).hexdigest()[:16]
    (folder / MANIFEST).write_text(json.dumps(document, indent=1) + "\n")


def _read(folder: Path) -> dict[str, Any] | None:
    path = folder / MANIFEST
    if not path.is_file():
        return None
    try:
        found = json.loads(path.read_text())
        document = {"months": float(found["months"]), "table": str(found["table"]), **found}
        named = [(f"{row['site']}{int(row['seed']):04d}", str(row["split"])) for row in found["stations"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise HieraError(f"{path}: cannot be read ({error}); remove the folder and simulate anew") from error
    splits: dict[str, str] = {}
    for station, split in named:
        if splits.setdefault(station, split) != split:
            raise HieraError(
                f"{path}: station {station} is in the {splits[station]} and the {split} split, so scores would be of "
                "plants that the training saw; remove the folder and simulate anew",
                code="OVERLAPPING_SPLITS",
            )
    return document


def tables(folder: Path, split: str, station: str = "") -> list[Path]:
    """Return the tables of a split, of one station where it is named.

    Raises
    ------
    HieraError
        The folder has no manifest or none of the split.
    """
    document = _read(folder)
    if document is None:
        raise HieraError(f"{folder}: has no {MANIFEST}; simulate stations with `hil train tower`")
    found = []
    for row in document["stations"]:
        plan = StationPlan(row["site"], int(row["seed"]), float(row["months"]), int(row["cells"]))
        if row["split"] == split and station in ("", plan.name):
            found += [folder / f"{plan.name}_{cell}.npz" for cell in range(1, plan.cells + 1)]
    if not found:
        raise HieraError(f"{folder}: has no station of the {split} split; simulate more stations")
    return found


def evenly(rows: np.ndarray, most: int | None) -> np.ndarray:
    """Return at most so many rows, evenly taken."""
    if most is None or len(rows) <= most:
        return rows
    return rows[np.linspace(0, len(rows) - 1, most).astype(np.int64)]


def digest_of(folder: Path) -> str:
    """Return the digest of the data of a folder, "" without a manifest."""
    document = _read(folder)
    return str(document["digest"]) if document else ""
