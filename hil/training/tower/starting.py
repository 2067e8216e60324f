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
LEAST = 50
"""Windows of a table at least."""
ALL = "all"


def fit_start(folder: Path, processors: int = 1) -> Path | None:
    """Fit the trees of a folder's training stations and write them there; None without scikit-learn.

    Raises
    ------
    HieraError
        There is no training station, or none has a window.
    """
    try:
        import sklearn  # noqa: F401
    except ImportError:
        return None
    paths = tables(folder, TRAIN)
    stations = _stations(folder)
    folds = min(FOLDS, len(stations)) if len(stations) > 1 else 0
    most = [max(WINDOWS // len(paths), LEAST)] * len(paths)
    left_out = [-1, *range(folds)]
    if processors <= 1:
        parts = list(map(_targets, paths, most))
    else:
        with _pool(processors, 1) as pool:
            parts = list(pool.map(_targets, paths, most))
    if all(part is None for part in parts):
        raise HieraError(f"{folder}: no training station has a window; simulate more with `hil train tower`")
    fold = [stations.index(_station(path.stem)) % max(folds, 1) for path in paths]
    chosen = [[p for p, f in zip(parts, fold, strict=True) if p is not None and f != k] for k in left_out]
    if processors <= 1:
        found = list(map(_fitted, chosen))
    else:
        with _pool(len(chosen), max(processors // len(chosen), 1)) as pool:
            found = list(pool.map(_fitted, chosen))
    arrays: dict[str, Any] = {"digest": np.array(digest_of(folder)), "stations": np.array(stations)}
    for k, one in zip(left_out, found, strict=True):
        arrays |= {f"{ALL if k < 0 else k}.{key}": value for key, value in one.items()}
    path = folder / FILE
    unfinished = path.with_name(f".{FILE}")
    with unfinished.open("wb") as file:
        np.savez(file, **arrays)
    unfinished.replace(path)
    return path


def _pool(workers: int, threads: int) -> ProcessPoolExecutor:
    os.environ["OMP_NUM_THREADS"] = str(threads)
    return ProcessPoolExecutor(workers, mp_context=get_context("spawn"))


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


def _targets(path: Path, most: int) -> Any:
    """Return targets (`score.Targets`) of a table, None where it has no window."""
    from twin.calibrators.hiera_unet.tower import load_fleet, score
    from twin.calibrators.hiera_unet.weights.device import ready

    ready()
    try:
        fleet = load_fleet([path], "cpu")
    except HieraError:
        return None
    return score.targets_of(fleet, evenly(fleet.rows, most), 64)


def _fitted(parts: Sequence[Any]) -> dict[str, np.ndarray]:
    """Return the trees of a booster that learned from these targets."""
    from twin.calibrators.hiera_unet.model.trees import NAMES, trees_of
    from twin.calibrators.hiera_unet.tower import score

    booster = score.Booster(score.joined(parts))
    trees = trees_of([booster.water, *booster.theta])
    return {name: getattr(trees, name).numpy() for name in NAMES}


def _trees(found: dict[str, Any], name: str) -> Any:
    from twin.calibrators.hiera_unet.model.trees import NAMES, trees_from

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
