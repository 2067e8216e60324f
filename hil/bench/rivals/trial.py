"""Benchmark `hil bench tower-rivals`: rivals of the Hiera-UNet, its ablations and a remedy, on stations not trained on.

Simulated stations and finished trainings are kept in a folder, so that an interrupted trial continues.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from pathlib import Path

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
from twin.calibrators.hiera_unet.tower.windows import CellBatch
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

    train: int = 22
    validation: int = 5
    test: int = 7
    windows: tuple[int, int, int] = (48, 10, 24)
    seconds: float = 20.0
    seeds: int = 3

    def counts(self) -> dict[str, int]:
        """Return the number of stations by split."""
        return {"train": self.train, "validation": self.validation, "test": self.test}


FULL = TrialSize()
QUICK = TrialSize(train=3, validation=1, test=2, windows=(16, 8, 8), seconds=1.0, seeds=1)


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of one call: whether ablations take part, and processor minutes after which no training begins."""

    ablations: bool = True
    minutes: float = math.inf


def measure(
    size: TrialSize, seed: int, work: Path, say: Say, limits: Limits
) -> tuple[tuple[ReportTable, ...], tuple[str, ...]]:
    """Return the tables, and a line for everything left out.

    Parameters
    ----------
    work
        Folder for stations and finished trainings.
    say
        Called with each stage.
    limits
        Contestants that lack a training after these are left out; the next call goes on with them.

    Raises
    ------
    HieraError
        A station cannot be simulated, or a split has no window.
    """
    ready("cpu", 1)
    simulate_missing(size.counts(), work / "stations", lambda share, text: say(0.3 * share, text))
    fleets = {s: Fleet(tables_of_split(work / "stations", s, n)) for s, n in size.counts().items()}
    some = tuple(one for one in CONTESTANTS if limits.ablations or one.kind != "ablation")
    return trial(fleets, size, seed, Kept(work / "trained", limits.minutes, say), some)


@dataclass(frozen=True, slots=True)
class Kept:
    """Folder of finished trainings, processor minutes after which none begins, and who is told of each."""

    folder: Path
    minutes: float
    say: Say


def trial(
    fleets: dict[str, Fleet], size: TrialSize, seed: int, kept: Kept, contestants: tuple[Contestant, ...]
) -> tuple[tuple[ReportTable, ...], tuple[str, ...]]:
    """Return the tables of a trial on the fleets of the splits, and a line for everything left out.

    Parameters
    ----------
    fleets
        Training, validation and test stations, in this order.
    """
    rows = {s: _chosen(fleets[s], n) for s, n in zip(fleets, size.windows, strict=True)}
    t = score.targets_of(fleets["test"], rows["test"])
    answers = tables.Answers(t, {s: (len(f.names), len(rows[s])) for s, f in fleets.items()}, size.seconds)
    answers.add_given("commissioned", score.commissioned(t))
    answers.add_given("persistence", score.persistent(t))
    answers.add_given(tables.GAUSS_NEWTON, score.believed(t))
    left_out = _boosted(answers, fleets, rows, t, seed, size.seeds)
    identity = json.dumps([asdict(size), [len(f) for f in fleets.values()], SUBJECT.digest()])
    made = _Trainings(fleets, rows, size, seed)
    began = time.process_time()
    for number, one in enumerate(contestants):
        found = []
        for k in range(seed, seed + size.seeds):
            path = kept.folder / f"{_file(one.name)}_{k}.npz"
            done = _read(path, identity)
            if done is None and time.process_time() - began < 60.0 * kept.minutes:
                kept.say(0.3 + 0.7 * number / len(contestants), f"training {one.name}, seed {k}")
                done = made.trained(one, k)
                _write(path, identity, done)
            if done is not None:
                found.append(done)
        if len(found) == size.seeds:
            for done in found:
                answers.add_trained(one, done)
        else:
            left_out.append(f"{one.name}: {len(found)} of {size.seeds} trainings are done; run again to continue")
    return answers.tables(), tuple(left_out)


class _Trainings:
    """Trainings on windows that are cut when the first one needs them."""

    def __init__(
        self, fleets: dict[str, Fleet], rows: dict[str, NDArray[np.int64]], size: TrialSize, seed: int
    ) -> None:
        self.fleets, self.rows, self.size, self.seed = fleets, rows, size, seed
        self.pool: WindowPool | None = None
        self.windows: dict[str, CellBatch] = {}

    def trained(self, one: Contestant, seed: int) -> Trained:
        if self.pool is None:
            rows = self.rows
            self.pool = WindowPool(self.fleets["train"], len(rows["train"]), self.seed)
            few = rows["train"][:: max(len(rows["train"]) // len(rows["validation"]), 1)]
            self.windows = {s: cut(self.fleets[s], few if s == "train" else rows[s]) for s in self.fleets}
        training = RivalTraining(one, self.pool, seed)
        return training.run(self.size.seconds, self.windows["validation"], self.windows["train"], self.windows["test"])


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
