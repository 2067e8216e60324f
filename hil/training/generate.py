"""Generate a folder of training data: campaigns of simulated rigs and of the virtual rig's plant, in three splits.

    python -m hil.training.generate --out DIR [--count 3000] [--seed 0]

Splits have seeds of their own, so that no rig, load or weather is in two of them. Finished shards are kept: a run that
was interrupted goes on where it was.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hil.terminal import Steps
from hil.training.plant_windows import campaign as plant_campaign
from twin.calibrators.hiera_unet.campaigns import WINDOWS, Campaign, ends, label, simulated
from twin.calibrators.hiera_unet.channels import table
from twin.calibrators.hiera_unet.features import Features
from twin.calibrators.hiera_unet.parameters import Deviations
from twin.calibrators.hiera_unet.plants import Family
from twin.calibrators.hiera_unet.store import SPLITS, Kept, Store, identity, write_manifest, write_shard
from twin.network import Network, TwinFileError
from twin.twinfile import load

TWIN = Path(__file__).resolve().parents[2] / "profiles" / "twins" / "virtual.toml"
SHARES = {"train": 0.8, "conformal": 0.1, "test": 0.1}
SIMULATED = 0.6
SHARD = 120
"""Campaigns a file."""
PLANT_WINDOWS = 4


def features_of(network: Network | None = None, tunables: str = "nine") -> Features:
    """What the coolant loop's network reads, for a twin of the shipped structure."""
    twin = load(TWIN) if network is None else network
    return Features(twin, table(twin), Deviations.of(twin, tunables))


def generate(seed: int, count: int, out: Path, say: Callable[[float, str], None] | None = None) -> Store:
    """At least `count` windows in all, in the folder `out`.

    Args:
        say: told how much is done, 0 to 1, and what is under way.
    """
    features = features_of()
    family = Family(features.network, features.deviations)
    makers: dict[str, tuple[float, int, Callable[[int, int], Campaign]]] = {
        "twin": (SIMULATED, WINDOWS, lambda s, n: simulated(family, s, n)),
        "plant": (1.0 - SIMULATED, PLANT_WINDOWS, lambda s, n: plant_campaign(features, s, n)),
    }
    out.mkdir(parents=True, exist_ok=True)
    shards: dict[str, dict[str, Any]] = {}
    done = 0
    for split in SPLITS:
        for source, (share, each, make) in makers.items():
            campaigns = -(-int(count * SHARES[split] * share) // each)
            for first in range(0, campaigns, SHARD):
                numbers = range(first, min(first + SHARD, campaigns))
                name = f"{split}-{source}-{first // SHARD:03d}.npz"
                own = _seed(seed, split, source)
                if say is not None:
                    say(min(done / count, 1.0), name)
                shards[name] = _shard(out, name, numbers, features, own, make, each) | {
                    "split": split, "source": source, "seed": own,
                }  # fmt: skip
                done += shards[name]["windows"]
    write_manifest(out, features, shards, seed=seed, count=count, windows=done)
    return Store(out, features)


def _shard(
    out: Path,
    name: str,
    numbers: range,
    features: Features,
    seed: int,
    make: Callable[[int, int], Campaign],
    each: int,
) -> dict[str, Any]:
    """One file, made unless it is there already."""
    path, about = out / name, out / f"{name}.json"
    wanted = {"seed": seed, "numbers": [numbers.start, numbers.stop], "each": each, "made_for": identity(features)}
    if path.is_file() and about.is_file():
        old = json.loads(about.read_text(encoding="utf-8"))
        if {k: old.get(k) for k in wanted} == wanted and old["sha256"] == _sha256(path):
            return {k: old[k] for k in ("campaigns", "windows", "healthy", "sha256")}
    kept: list[Kept] = []
    for number in numbers:
        campaign = make(seed, number)
        rng = np.random.default_rng([seed, number, 13])
        labels = tuple(label(features, campaign, end) for end in ends(campaign, rng, each))
        kept.append(Kept(campaign, labels))
    found: dict[str, Any] = {
        "campaigns": len(kept),
        "windows": sum(len(k.labels) for k in kept),
        "healthy": sum(not x.changed for k in kept for x in k.labels),
        "sha256": write_shard(path, kept),
    }
    about.write_text(json.dumps({**wanted, **found}) + "\n", encoding="utf-8")
    return found


def _seed(seed: int, split: str, source: str) -> int:
    digest = hashlib.sha256(f"{seed} {split} {source}".encode()).digest()
    return int.from_bytes(digest[:4], "big") >> 1


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="python -m hil.training.generate", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder for the data; kept outside the repository")
    parser.add_argument("--count", type=int, default=3000, help="windows in all splits together")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    try:
        with Steps("windows", 1.0) as steps:
            store = generate(given.seed, given.count, given.out, steps.update)
    except TwinFileError as error:
        parser.exit(1, f"{error}\n")
    print(f"{store.manifest['windows']} windows in {given.out}")


if __name__ == "__main__":
    main()
