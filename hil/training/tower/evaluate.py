"""Scores of trained members and their rivals on stations that no training saw."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hil.training.tower.generate import TEST, TRAIN, VALIDATION, digest_of, evenly, tables
from hil.training.tower.starting import load_start

BOOSTED_WINDOWS = 12_000
"""Windows of the training split that the booster learns from."""
HELD_OUT = 6000
"""Windows of the validation split that intervals are set by."""
LOST = 0.25
Note = Callable[[str], None]
GAUSS_NEWTON, BOOSTED, ENSEMBLE = "Gauss-Newton with discrepancy", "the same, boosted", "network, ensemble"


def evaluate(
    folder: Path,
    members: Mapping[str, Path],
    device: str = "cpu",
    *,
    most: int | None = None,
    half: bool = False,
    test: Path | None = None,
    note: Note = lambda _: None,
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return scores as plain data, and arrays by window of the test split.

    Parameters
    ----------
    members
        Weights by name; `ensemble_of` names those that make the ensemble.
    most
        Windows of the test split at most, evenly taken; None for all.
    test
        Folder with the test split, `folder` itself without.
    half
        bfloat16 in the networks' products.

    Raises
    ------
    HieraError
        The folder lacks a split, or a network does not fit.
    """
    from twin.calibrators.hiera_unet.tower import load_fleet, load_member, score
    from twin.calibrators.hiera_unet.tower.predict import BLIND, predict, settle

    began = time.monotonic()
    unseen = load_fleet(tables(test or folder, TEST), device)
    validation = load_fleet(tables(folder, VALIDATION), device)
    rows, held_out = evenly(unseen.rows, most), evenly(validation.rows, min(most or HELD_OUT, HELD_OUT))
    size = 256 if device != "cpu" else 64
    t, v = score.targets_of(unseen, rows), score.targets_of(validation, held_out)
    note(f"{len(rows)} test windows of {len(unseen.names)} cells, {len(held_out)} to set intervals")
    answers = {
        "commissioned": score.commissioned(t),
        "persistence of the last error": score.persistent(t),
        GAUSS_NEWTON: score.believed(t),
    }
    loaded = {name: load_member(path, blind_too=True) for name, path in members.items()}
    start = load_start(folder)
    rival = boost(folder, unseen, rows, note) if start is None else score.boosted(start, unseen, rows, size)
    if rival is not None:
        answers[BOOSTED] = rival
    if start is not None and loaded and all(one.network.trees is not None for one in loaded.values()):
        # All members correct the same answer: it is worked out once.
        for fleet, chosen in ((unseen, rows), (validation, held_out)):
            settle(fleet, start, chosen, size)
    for member in loaded.values():
        member.network.to(unseen.device)
    predicted = {n: predict(m.network, unseen, rows, size, half=half) for n, m in loaded.items()}
    note(f"predictions of {len(loaded)} networks after {time.monotonic() - began:.0f} s")
    known = {n: predict(m.network, validation, held_out, size, half=half) for n, m in loaded.items()}
    refused = {n: m.card.get("refused", "") for n, m in loaded.items()}
    groups = {n: [n] for n in loaded} | {ENSEMBLE: ensemble_of(refused)}
    factors: dict[str, Any] = {}
    for name, some in groups.items():
        if not some:
            continue
        limits = score.IntervalFactors.of(v, *score.mixed(v, [known[n] for n in some]))
        answers[name] = limits.applied(*score.mixed(t, [predicted[n] for n in some]))
        factors[name] = {"theta": limits.theta.tolist(), "water": limits.water}
    document: dict[str, Any] = {
        "data": digest_of(folder),
        "test_cells": unseen.names,
        "windows": len(rows),
        "factors": factors,
        "refused": refused,
        "refused_outputs": {n: BLIND if m.network.start_outlet else "" for n, m in loaded.items()},
        "ensemble": groups[ENSEMBLE],
        "scores": {part: _scored(t, answers, rows_of) for part, rows_of in _parts(t, unseen.names).items()},
        "by_cell": score.by_cell(t, unseen.names, answers),
    }
    if groups[ENSEMBLE]:
        document |= _further(loaded, groups[ENSEMBLE], unseen, rows, size, half)
    document["seconds"] = round(time.monotonic() - began, 1)
    note(f"scored after {document['seconds']:.0f} s")
    return document, _arrays(t, answers)


def ensemble_of(refused: Mapping[str, str]) -> list[str]:
    """Return the small members that the gate passed, or all small ones where it refused each.

    Parameters
    ----------
    refused
        The gate's code of the parameters, "" where it passed, by the name of a member.
    """
    small = [name for name in refused if name.startswith("small")]
    return [name for name in small if not refused[name]] or small


def boost(folder: Path, test: Any, rows: np.ndarray, note: Note = lambda _: None) -> Any:
    """Return the answer (`score.MethodPrediction`) of Gauss-Newton corrected by gradient boosting, learned from the
    training split; None without scikit-learn.

    Parameters
    ----------
    test
        Fleet of the test split.
    rows
        Its cycles.
    """
    from twin.calibrators.hiera_unet.tower import load_fleet, score

    paths = [path for path in tables(folder, TRAIN) if _has_windows(path)]
    parts = []
    for path in paths:
        # One at a time and on the processor: all tables fill a device.
        fleet = load_fleet([path], "cpu")
        parts.append(score.targets_of(fleet, evenly(fleet.rows, max(BOOSTED_WINDOWS // len(paths), 50)), 64))
    try:
        booster = score.Booster(score.joined(parts))
    except ImportError:
        note("boosting is left out: scikit-learn is not installed; install the extra ml")
        return None
    return booster(score.targets_of(test, rows, 64))


def _has_windows(path: Path) -> bool:
    with np.load(path, allow_pickle=False) as found:
        return bool(found["valid"].any())


def _parts(t: Any, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Return the windows of each group of stations."""
    site = np.array([names[int(c)][0] for c in t.cell])
    kinds = {"all": np.ones(len(site), dtype=bool), "site A": site == "A", "site B": site == "B", "family": site == "F"}
    return {name: rows for name, rows in kinds.items() if rows.any()}


def _scored(t: Any, answers: Mapping[str, Any], rows: np.ndarray) -> dict[str, Any]:
    from twin.calibrators.hiera_unet.tower import score

    part = score.taken(t, rows)
    own = {name: score.taken_answer(one, rows) for name, one in answers.items()}
    rival = own.get(BOOSTED, own[GAUSS_NEWTON])
    return {name: score.scores(part, one, rival) for name, one in own.items()}


def _further(
    loaded: Mapping[str, Any], members: Sequence[str], test: Any, rows: np.ndarray, size: int, half: bool
) -> dict[str, Any]:
    """Return scores of the ensemble in the symmetric branch, with channels lost, and its members' spread."""
    from twin.calibrators.hiera_unet.tower import score
    from twin.calibrators.hiera_unet.tower.predict import predict

    some = rows[:: max(len(rows) // 4000, 1)]
    t = score.targets_of(test, some)
    rival = score.believed(t)
    found: dict[str, Any] = {}
    for name, options in (("causal", {}), ("symmetric", {"causal": False}), ("quarter_lost", {"lost": LOST})):
        parts = [predict(loaded[n].network, test, some, size, half=half, **options) for n in members]
        answer, _, _ = score.mixed(t, parts)
        found[name] = score.scores(t, answer, rival)
        if name == "causal":
            spread = np.std([p.theta for p in parts], axis=0).mean(axis=0)
            found["member_sd"] = {
                n: float(s) for n, s in zip(("fill", "air", "uniformity", "bias"), spread, strict=True)
            }
    return found


def _arrays(t: Any, answers: Mapping[str, Any]) -> dict[str, np.ndarray]:
    found = {
        "cell": t.cell.astype(np.int16),
        "row": t.rows.astype(np.int32),
        "true": t.true.astype(np.float16),
        "belief_sd": t.sd.astype(np.float16),
    }
    for name, one in answers.items():
        key = "".join(c if c.isalnum() else "_" for c in name)
        error = np.abs(one.water - t.true_water)
        there = np.isfinite(error)
        mean = np.where(there, error, 0.0).sum(axis=1) / np.maximum(there.sum(axis=1), 1)
        found[f"{key}__water"] = mean.astype(np.float16)
        found[f"{key}__theta"] = one.theta.astype(np.float16)
    return found
