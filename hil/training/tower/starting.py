"""The answer that networks begin at: Gauss-Newton with discrepancy, corrected by boosted trees.

One set of trees learns from all training stations; it goes into the weights and is the rival in every table. A network
that saw its answers on those stations would learn what is left of an answer by heart, so each training station gets
that of trees that learned from the others alone (cross-fitting: Wolpert, Neural Networks 5 (1992) 241).
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from hil.training.tower.generate import TRAIN, digest_of, evenly, tables
from twin.calibrators.hiera_unet import HieraError

FILE = "start.npz"
FOLDS = 4
WINDOWS = 24_000
"""Windows of the training split that trees learn from."""
ALL = "all"


def fit_start(folder: Path, workers: int = 1, threads: int = 1) -> Path | None:
    """Fit the trees of a folder's training stations and write them there; None without scikit-learn.

    Parameters
    ----------
    workers
        Processes that fit side by side.
    threads
        Of each.

    Raises
    ------
    HieraError
        There is no training station.
    """
    try:
        import sklearn  # noqa: F401
    except ImportError:
        return None
    stations = _stations(folder)
    jobs: list[tuple[str, list[str]]] = [(ALL, stations)]
    if len(stations) > 1:
        folds = min(FOLDS, len(stations))
        jobs += [(str(k), [s for i, s in enumerate(stations) if i % folds != k]) for k in range(folds)]
    arrays: dict[str, Any] = {"digest": np.array(digest_of(folder)), "stations": np.array(stations)}
    if workers <= 1:
        found = [_fitted(folder, names) for _, names in jobs]
    else:
        os.environ["OMP_NUM_THREADS"] = str(threads)
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            found = list(pool.map(_fitted, [folder] * len(jobs), [names for _, names in jobs]))
    for (name, _), one in zip(jobs, found, strict=True):
        arrays |= {f"{name}.{key}": value for key, value in one.items()}
    path = folder / FILE
    unfinished = path.with_name(f".{FILE}")
    with unfinished.open("wb") as file:
        np.savez(file, **arrays)
    unfinished.replace(path)
    return path


def load_start(folder: Path) -> Any:
    """Return the trees (`Trees`) of all training stations, None where the folder has none of its present data."""
    found = _read(folder)
    return None if found is None else _trees(found, ALL)


def begin(folder: Path, fleet: Any) -> None:
    """Give each window of the training fleet the answer of trees that did not learn from its station."""
    from twin.calibrators.hiera_unet.tower.predict import settle

    found = _read(folder)
    if found is None:
        return
    stations = [str(s) for s in found["stations"]]
    folds = [key.partition(".")[0] for key in found if key.endswith(".base") and not key.startswith(ALL)]
    cells = fleet.cell.cpu().numpy()[fleet.rows]
    station = np.array([stations.index(_station(name)) for name in fleet.names])[cells]
    for k in folds or [ALL]:
        mine = fleet.rows if k == ALL else fleet.rows[station % len(folds) == int(k)]
        settle(fleet, _trees(found, k).to(fleet.device), mine)


def _fitted(folder: Path, stations: Sequence[str]) -> dict[str, np.ndarray]:
    """Return the trees of a booster that learned from these stations."""
    from twin.calibrators.hiera_unet.tower import load_fleet, score
    from twin.calibrators.hiera_unet.trees import NAMES, trees_of

    paths = [path for path in tables(folder, TRAIN) if _station(path.stem) in stations]
    parts = []
    for path in paths:
        try:
            fleet = load_fleet([path], "cpu")
        except HieraError:  # a cell without a window teaches nothing
            continue
        parts.append(score.targets_of(fleet, evenly(fleet.rows, max(WINDOWS // len(paths), 50)), 64))
    booster = score.Booster(score.joined(parts))
    trees = trees_of([booster.water, *booster.theta])
    return {name: getattr(trees, name).numpy() for name in NAMES}


def _trees(found: dict[str, Any], name: str) -> Any:
    from twin.calibrators.hiera_unet.trees import NAMES, trees_from

    return trees_from({key: found[f"{name}.{key}"] for key in NAMES})


def _read(folder: Path) -> dict[str, Any] | None:
    path = folder / FILE
    if not path.is_file():
        return None
    with np.load(path, allow_pickle=False) as file:
        found = {name: file[name] for name in file.files}
    return found if str(found["digest"]) == digest_of(folder) else None


def _stations(folder: Path) -> list[str]:
    return list(dict.fromkeys(_station(path.stem) for path in tables(folder, TRAIN)))


def _station(cell: str) -> str:
    """Return the name of the station of a cell, such as F0001 of F0001_2."""
    return cell.rpartition("_")[0]
