"""Benchmark `hil bench tower-rivals`: rivals of the Hiera-UNet, its ablations and a remedy, on stations not trained on.

Simulated stations and finished trainings are kept in a folder, so that an interrupted trial continues.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.bench.measure import ReportTable
from hil.bench.rivals import tables
from hil.bench.rivals.contestants import CONTESTANTS, Contestant
from hil.bench.rivals.stations import simulate_missing
from hil.bench.rivals.stations import tables as tables_of_split
from hil.bench.rivals.training import RivalTraining, Trained, WindowPool, cut
from twin.calibrators.hiera_unet.tower import Fleet, score
from twin.calibrators.hiera_unet.tower.table import SUBJECT
from twin.calibrators.hiera_unet.weights.device import ready

Say = Callable[[float, str], None]


@dataclass(frozen=True, slots=True)
class TrialSize:
    """Size of a trial.

    Attributes
    ----------
    train, validation, test
        Stations of each split.
    windows
        Windows of a training station, of a validation station and of a test station: the pool of the trainings is as
        many of the first as stations.
    seconds
        Processor seconds of each training.
    seeds
        Trainings of each contestant.
    """

    train: int = 36
    validation: int = 8
    test: int = 12
    windows: tuple[int, int, int] = (48, 10, 24)
    seconds: float = 20.0
    seeds: int = 3

    def counts(self) -> dict[str, int]:
        """Return the number of stations by split."""
        return {"train": self.train, "validation": self.validation, "test": self.test}


FULL = TrialSize()
QUICK = TrialSize(train=3, validation=1, test=2, windows=(16, 8, 8), seconds=1.0, seeds=1)


def measure(
    size: TrialSize, seed: int, work: Path, say: Say, *, ablations: bool = True
) -> tuple[tuple[ReportTable, ...], tuple[str, ...]]:
    """Return the tables, and a line for everything left out.

    Parameters
    ----------
    work
        Folder for stations and finished trainings.
    say
        Called with each stage.
    ablations
        Whether the Hiera-UNet is trained without each of its parts too.

    Raises
    ------
    HieraError
        A station cannot be simulated, or a split has no window.
    """
    ready("cpu", 1)
    simulate_missing(size.counts(), work / "stations", lambda share, text: say(0.3 * share, text))
    fleets = {s: Fleet(tables_of_split(work / "stations", s, n)) for s, n in size.counts().items()}
    some = tuple(one for one in CONTESTANTS if ablations or one.kind != "ablation")
    tables, skipped = trial(fleets, size, seed, work, say, some)
    left_out = () if ablations else ("ablations: run without --no-ablations",)
    return tables, (*skipped, *left_out)


def trial(
    fleets: dict[str, Fleet],
    size: TrialSize,
    seed: int,
    work: Path,
    say: Say,
    contestants: tuple[Contestant, ...],
) -> tuple[tuple[ReportTable, ...], tuple[str, ...]]:
    """Return the tables of a trial on the fleets of the splits, and a line for everything left out."""
    rows = {s: _chosen(fleets[s], n) for s, n in zip(fleets, size.windows, strict=True)}
    t = score.targets_of(fleets["test"], rows["test"])
    answers = tables.Answers(t, {s: (len(f.names), len(rows[s])) for s, f in fleets.items()}, size.seconds)
    answers.add_given("commissioned", score.commissioned(t))
    answers.add_given("persistence", score.persistent(t))
    answers.add_given(tables.GAUSS_NEWTON, score.believed(t))
    pool: WindowPool | None = None
    windows: dict[str, Any] = {}
    skipped = _boosted(answers, fleets, rows, t, seed, size.seeds)
    jobs = [(k, one) for one in contestants for k in range(size.seeds)]
    for number, (k, one) in enumerate(jobs):
        path = work / "trained" / f"{_file(one.name)}_{seed + k}.npz"
        identity = json.dumps([asdict(size), [len(f) for f in fleets.values()], SUBJECT.digest()])
        found = _read(path, identity)
        if found is None:
            say(0.3 + 0.7 * number / len(jobs), f"training {one.name}, seed {seed + k}")
            if pool is None:
                pool = WindowPool(fleets["train"], len(rows["train"]), seed)
                few = rows["train"][:: max(len(rows["train"]) // len(rows["validation"]), 1)]
                windows = {s: cut(fleets[s], few if s == "train" else rows[s]) for s in fleets}
            training = RivalTraining(one, pool, seed + k)
            found = training.run(size.seconds, windows["validation"], windows["train"], windows["test"])
            _write(path, identity, found)
        answers.add_trained(one, found)
    return answers.tables(), tuple(skipped)


def _boosted(
    answers: tables.Answers,
    fleets: dict[str, Fleet],
    rows: dict[str, NDArray[np.int64]],
    t: score.Targets,
    seed: int,
    seeds: int,
) -> list[str]:
    """Add the boosted trees of each seed; return a line where they are left out."""
    given = {s: score.targets_of(fleets[s], rows[s]) for s in ("train", "validation")}
    for k in range(seeds):
        began = time.process_time()
        try:
            booster = score.Booster(given["train"], seed + k)
        except ImportError:
            return ["boosted trees: scikit-learn is not installed; install the extra ml"]
        spent = time.process_time() - began
        answers.add_boosted(booster(t), {s: (booster(g), g) for s, g in given.items()}, spent)
    return []


def _chosen(fleet: Fleet, each: int) -> NDArray[np.int64]:
    """Return so many windows of each cell at most, evenly taken."""
    cells = fleet.cell.numpy()[fleet.rows]
    parts = []
    for cell in np.unique(cells):
        own = fleet.rows[cells == cell]
        parts.append(own[np.unique(np.linspace(0, len(own) - 1, min(each, len(own))).astype(np.int64))])
    return np.concatenate(parts)


def _file(name: str) -> str:
    return "".join(c if c.isalnum() else "_" for c in name)


def _read(path: Path, identity: str) -> Trained | None:
    """Return a finished training, None where there is none of this trial."""
    if not path.is_file():
        return None
    with np.load(path, allow_pickle=False) as file:
        if str(file["identity"]) != identity:
            return None
        return Trained(**{f.name: file[f.name] if file[f.name].ndim else file[f.name].item() for f in fields(Trained)})


def _write(path: Path, identity: str, found: Trained) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.name}")
    with unfinished.open("wb") as file:
        np.savez(file, identity=np.array(identity), **{f.name: getattr(found, f.name) for f in fields(Trained)})
    unfinished.replace(path)
