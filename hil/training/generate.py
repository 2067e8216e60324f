"""Generate a folder of training data: campaigns of simulated rigs and of the virtual rig's plant, in three splits.

    python -m hil.training.generate --out DIR [--count 3000] [--seed 0]

Splits have seeds of their own, so that no rig, load or weather is in two of them. Finished files are kept: an
interrupted run continues, and a larger count adds to the existing files.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hil.run.session import ProgressBar
from hil.training.plant_windows import campaign as plant_campaign
from hil.training.stopping import Stop
from twin.calibrators.hiera_unet import Deviations, Family, Features, LabelledRecord, Store
from twin.calibrators.hiera_unet.data.channels import table
from twin.calibrators.hiera_unet.simulated.campaigns import WINDOWS, ends, label, simulated
from twin.calibrators.hiera_unet.simulated.store import (
    MANIFEST,
    SPLITS,
    Kept,
    identity,
    read_shard,
    write_manifest,
    write_shard,
)
from twin.network import Network, TwinFileError
from twin.twinfile import load

TWIN = Path(__file__).resolve().parents[2] / "profiles" / "twins" / "virtual.toml"
SHARES = {"train": 0.8, "conformal": 0.1, "test": 0.1}
SIMULATED = 0.6
SHARD = 120
"""Campaigns in each file."""
ASKED = "asked.json"
"""Seed and number of windows that a folder is being filled with."""
PLANT_WINDOWS = 4


def features_of(network: Network | None = None, tunables: str = "nine") -> Features:
    """Return the inputs of the coolant loop's network, for a twin of the shipped structure."""
    twin = load(TWIN) if network is None else network
    return Features(twin, table(twin), Deviations.of(twin, tunables))


def campaigns_of(count: int, split: str) -> dict[str, int]:
    """Return source -> number of campaigns of a split that give at least `count` windows in all."""
    sources = {"twin": (SIMULATED, WINDOWS), "plant": (1.0 - SIMULATED, PLANT_WINDOWS)}
    return {name: -(-int(count * SHARES[split] * share) // each) for name, (share, each) in sources.items()}


def generate(
    seed: int, count: int, out: Path, say: Callable[[float, str], None] | None = None, stop: Stop | None = None
) -> Store | None:
    """Generate windows until the folder `out` has at least `count` in all; return None if interrupted.

    A complete folder has a manifest. An incomplete one has `ASKED`, and the same call continues it.

    Parameters
    ----------
    say
        Called with the share done, 0 to 1, and the stage.
    stop
        Ends the work in order.

    Raises
    ------
    TwinFileError
        The folder has windows of another seed, or more of them.
    """
    features = features_of()
    family = Family(features.network, features.deviations)
    makers: dict[str, tuple[int, Callable[[int, int], LabelledRecord]]] = {
        "twin": (WINDOWS, lambda s, n: simulated(family, s, n)),
        "plant": (PLANT_WINDOWS, lambda s, n: plant_campaign(features, s, n)),
    }
    _refuse_others(out, seed, count)
    files = _files(count)
    out.mkdir(parents=True, exist_ok=True)
    (out / ASKED).write_text(json.dumps({"seed": seed, "count": count}) + "\n", encoding="utf-8")
    (out / MANIFEST).unlink(missing_ok=True)
    shards: dict[str, dict[str, Any]] = {}
    done, whole = 0, sum(len(numbers) for *_, numbers in files)
    for split, source, numbers in files:
        name = _name(split, source, numbers)
        each, make = makers[source]
        own = _seed(seed, split, source)

        def step(made: int, name: str = name, done: int = done) -> bool:
            if say is not None:
                say((done + made) / whole, name)
            return stop is not None and stop.over

        found = _shard(out, name, numbers, features, own, make, each, step)
        if found is None:
            return None
        shards[name] = found | {"split": split, "source": source, "seed": own}
        done += len(numbers)
    write_manifest(out, features, shards, seed=seed, count=count, windows=sum(s["windows"] for s in shards.values()))
    (out / ASKED).unlink()
    return Store(out, features)


def _files(count: int) -> list[tuple[str, str, range]]:
    """Return split, source and campaigns of every file of at least `count` windows."""
    return [
        (split, source, range(first, min(first + SHARD, campaigns)))
        for split in SPLITS
        for source, campaigns in campaigns_of(count, split).items()
        for first in range(0, campaigns, SHARD)
    ]


def _name(split: str, source: str, numbers: range) -> str:
    return f"{split}-{source}-{numbers.start // SHARD:03d}.npz"


def _refuse_others(folder: Path, seed: int, count: int) -> None:
    """Raise TwinFileError if a folder has windows that these would replace."""
    old = asked_of(folder)
    if old is not None and old[0] != seed:
        raise TwinFileError(
            f"{folder} holds windows of data seed {old[0]}, not {seed}; give that one or another folder"
        )
    if old is not None and old[1] > count and (folder / MANIFEST).is_file():
        raise TwinFileError(
            f"{folder} holds {old[1]} windows, more than {count}; ask for as many or give another folder"
        )


def begun(folder: Path, count: int) -> float:
    """Return the share, 0 to 1, of at least `count` windows that a folder has."""
    there = whole = 0
    for split, source, numbers in _files(count):
        about = folder / f"{_name(split, source, numbers)}.json"
        stop = json.loads(about.read_text(encoding="utf-8"))["numbers"][1] if about.is_file() else numbers.start
        there += min(stop, numbers.stop) - numbers.start
        whole += len(numbers)
    return there / whole


def complete(folder: Path, seed: int, count: int) -> bool:
    """Return True if a folder has all windows of a seed; `generate` reports the reason otherwise."""
    return (folder / MANIFEST).is_file() and not (folder / ASKED).exists() and asked_of(folder) == (seed, count)


def asked_of(folder: Path) -> tuple[int, int] | None:
    """Return seed and windows that a folder was or is being filled with; None for a folder without any.

    Raises
    ------
    TwinFileError
        Its file cannot be read.
    """
    for name in (ASKED, MANIFEST):
        try:
            document = json.loads((folder / name).read_text(encoding="utf-8"))
            return int(document["seed"]), int(document["count"])
        except FileNotFoundError:
            continue
        except (ValueError, KeyError, TypeError) as error:
            raise TwinFileError(f"{folder / name} cannot be read ({error}); remove it or give another folder") from None
    return None


def _shard(
    out: Path,
    name: str,
    numbers: range,
    features: Features,
    seed: int,
    make: Callable[[int, int], LabelledRecord],
    each: int,
    step: Callable[[int], bool],
) -> dict[str, Any] | None:
    """Complete one file; return None if `step`, called with the count so far, ends the work."""
    path, about = out / name, out / f"{name}.json"
    made_by = {"seed": seed, "each": each, "made_for": identity(features)}
    old = json.loads(about.read_text(encoding="utf-8")) if path.is_file() and about.is_file() else {}
    if any(old.get(k) != v for k, v in made_by.items()) or old["sha256"] != _sha256(path):
        old = {}
    if old.get("numbers") == [numbers.start, numbers.stop]:
        return {k: old[k] for k in ("campaigns", "windows", "healthy", "sha256")}
    kept = read_shard(path)[: len(numbers)] if old else []
    had = len(kept)
    for number in numbers[had:]:
        if step(len(kept)):
            break
        campaign = make(seed, number)
        rng = np.random.default_rng([seed, number, 13])
        kept.append(Kept(campaign, tuple(label(features, campaign, end) for end in ends(campaign, rng, each))))
    complete = len(kept) == len(numbers)
    if not complete and len(kept) == had:
        return None
    found: dict[str, Any] = {
        "campaigns": len(kept),
        "windows": sum(len(k.labels) for k in kept),
        "healthy": sum(not x.changed for k in kept for x in k.labels),
        "sha256": write_shard(path, kept),
    }
    reached = [numbers.start, numbers.start + len(kept)]
    about.write_text(json.dumps({**made_by, "numbers": reached, **found}) + "\n", encoding="utf-8")
    return found if complete else None


def _seed(seed: int, split: str, source: str) -> int:
    digest = hashlib.sha256(f"{seed} {split} {source}".encode()).digest()
    return int.from_bytes(digest[:4], "big") >> 1


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def main() -> None:
    """Generate training data from the command line."""
    parser = argparse.ArgumentParser(prog="python -m hil.training.generate", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder for the data; kept outside the repository")
    parser.add_argument("--count", type=int, default=3000, help="windows in all splits together")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    try:
        with Stop() as stop, ProgressBar("windows", 1.0, begun=begun(given.out, given.count)) as steps:
            store = generate(given.seed, given.count, given.out, steps.update, stop)
            steps.cut = store is None
    except TwinFileError as error:
        parser.exit(1, f"{error}\n")
    if store is None:
        parser.exit(130, "interrupted; give the same command again\n")
    print(f"{store.manifest['windows']} windows in {given.out}")


if __name__ == "__main__":
    main()
