"""Generate a folder of training data: campaigns of simulated rigs and of the virtual rig's plant, in three splits.

    python -m hil.training.generate --out DIR [--count 3000] [--seed 0]

Splits have seeds of their own, so that no rig, load or weather is in two of them. Finished files are kept: an
interrupted run continues, and a larger count adds to the existing files.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import hashlib
import itertools
import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hil.executor import Executor, ask
from hil.run.session import ProgressBar
from hil.training.plant_windows import PER_RIG
from hil.training.plant_windows import campaign as plant_campaign
from hil.training.stopping import Stop
from twin.calibrators.hiera_unet import Deviations, Family, Features, Store
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
EACH = {"twin": WINDOWS, "plant": 4}
"""Windows of a campaign by its source."""
WAIT_S = 0.2
"""Interval, s, at which a wait for a worker asks whether to stop."""


def features_of(network: Network | None = None, tunables: str = "nine") -> Features:
    """Return the inputs of the coolant loop's network, for a twin of the shipped structure."""
    twin = load(TWIN) if network is None else network
    return Features(twin, table(twin), Deviations.of(twin, tunables))


def campaigns_of(count: int, split: str) -> dict[str, int]:
    """Return source -> number of campaigns of a split that give at least `count` windows in all."""
    shares = {"twin": SIMULATED, "plant": 1.0 - SIMULATED}
    return {name: -(-int(count * SHARES[split] * share) // EACH[name]) for name, share in shares.items()}


def generate(
    seed: int,
    count: int,
    out: Path,
    say: Callable[[float, str], None] | None = None,
    stop: Stop | None = None,
    executor: Executor | None = None,
) -> Store | None:
    """Generate windows until the folder `out` has at least `count` in all; return None if interrupted.

    A complete folder has a manifest. An incomplete one has `ASKED`, and the same call continues it.

    Parameters
    ----------
    seed, count
        Seed, and least number of windows.
    out
        Folder of the files.
    say
        Called with the share done, 0 to 1, and the stage.
    stop
        Ends the work in order.
    executor
        Workers that simulate; None simulates here. The windows are the same.

    Raises
    ------
    TwinFileError
        The folder has windows of another seed, or more of them.
    TaskError, ExecutorError
        A campaign failed on a worker, or the workers cannot be used.
    """
    features = features_of()
    _refuse_others(out, seed, count)
    files = _files(count)
    out.mkdir(parents=True, exist_ok=True)
    (out / ASKED).write_text(json.dumps({"seed": seed, "count": count}) + "\n", encoding="utf-8")
    (out / MANIFEST).unlink(missing_ok=True)
    shards = [_Shard(out, *file, _seed(seed, *file[:2]), features) for file in files]
    done, whole = 0, sum(len(numbers) for *_, numbers in files)
    with _simulated([piece for shard in shards for piece in shard.pieces(executor)], executor, stop) as campaigns:
        for shard in shards:

            def step(made: int, name: str = shard.name, done: int = done) -> bool:
                if say is not None:
                    say((done + made) / whole, name)
                return stop is not None and stop.over

            if not shard.complete(campaigns, step):
                return None
            done += len(shard.numbers)
    about = {shard.name: shard.found | {"split": shard.split, "source": shard.source} for shard in shards}
    for shard in shards:
        about[shard.name]["seed"] = shard.seed
    windows = sum(shard.found["windows"] for shard in shards)
    write_manifest(out, features, about, seed=seed, count=count, windows=windows)
    (out / ASKED).unlink()
    return Store(out, features)


@dataclass(frozen=True, slots=True)
class _Piece:
    """Campaigns `first` to `stop` of a source and seed, with `each` windows: what one task simulates."""

    source: str
    seed: int
    first: int
    stop: int
    each: int


def simulate_piece(piece: _Piece, say: Callable[[str], None]) -> list[Kept]:
    """Simulate campaigns on a worker, with the labels of their windows."""
    features = _features()
    family = _family() if piece.source == "twin" else None
    found = []
    for number in range(piece.first, piece.stop):
        say(f"campaign {number}")
        if family is None:
            campaign = plant_campaign(features, piece.seed, number)
        else:
            campaign = simulated(family, piece.seed, number)
        rng = np.random.default_rng([piece.seed, number, 13])
        labels = tuple(label(features, campaign, end) for end in ends(campaign, rng, piece.each))
        found.append(Kept(campaign, labels))
    return found


@functools.cache
def _features() -> Features:
    return features_of()


@functools.cache
def _family() -> Family:
    return Family(_features().network, _features().deviations)


@contextlib.contextmanager
def _simulated(
    pieces: Sequence[_Piece], executor: Executor | None, stop: Stop | None
) -> Iterator[Iterator[list[Kept]]]:
    """Yield the campaigns of each piece, in order; an iterator that ends early was stopped."""
    if executor is None:
        yield (simulate_piece(piece, lambda text: None) for piece in pieces)
        return
    # One piece more for each worker, so that none waits for the next one.
    with ThreadPoolExecutor(2 * max(executor.slots(), 1)) as pool:
        waiting = [
            pool.submit(ask, executor, simulate_piece, piece, f"{piece.source}-{piece.seed}-{piece.first}")
            for piece in pieces
        ]
        try:
            yield _in_order(waiting, stop)
        finally:
            for future in waiting:
                future.cancel()
            if not all(future.done() for future in waiting):
                executor.close()  # gives up what runs, so that the threads end


def _in_order(waiting: Sequence[Future[list[Kept]]], stop: Stop | None) -> Iterator[list[Kept]]:
    for future in waiting:
        while not wait([future], WAIT_S).done:
            if stop is not None and stop.over:
                return
        yield future.result()


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


class _Shard:
    """File of campaigns, which is completed from those that it has."""

    def __init__(self, out: Path, split: str, source: str, numbers: range, seed: int, features: Features) -> None:
        self.split, self.source, self.numbers, self.seed = split, source, numbers, seed
        self.name = _name(split, source, numbers)
        self.found: dict[str, Any] = {}
        self._path, self._about = out / self.name, out / f"{self.name}.json"
        self._made_by = {"seed": seed, "each": EACH[source], "made_for": identity(features)}
        self._kept: list[Kept] = []
        path, about = self._path, self._about
        old = json.loads(about.read_text(encoding="utf-8")) if path.is_file() and about.is_file() else {}
        if any(old.get(k) != v for k, v in self._made_by.items()) or old["sha256"] != _sha256(path):
            old = {}
        if old.get("numbers") == [numbers.start, numbers.stop]:
            self.found = {k: old[k] for k in ("campaigns", "windows", "healthy", "sha256")}
        elif old:
            self._kept = read_shard(path)[: len(numbers)]

    def pieces(self, executor: Executor | None) -> list[_Piece]:
        """Return the campaigns that are left: one each here, those of one rig together for a worker."""
        if self.found:
            return []
        first, each, rigs = self.numbers.start + len(self._kept), EACH[self.source], 1 if executor is None else PER_RIG
        bounds = [first, *range(rigs * (first // rigs + 1), self.numbers.stop, rigs), self.numbers.stop]
        return [_Piece(self.source, self.seed, a, b, each) for a, b in itertools.pairwise(bounds) if a < b]

    def complete(self, campaigns: Iterator[list[Kept]], step: Callable[[int], bool]) -> bool:
        """Take the campaigns that are left; return False if `step`, called with the count so far, ends the work."""
        if self.found:
            return True
        kept, had = self._kept, len(self._kept)
        while len(kept) < len(self.numbers) and not step(len(kept)):
            found = next(campaigns, None)
            if found is None:
                break
            kept += found
        if len(kept) == had < len(self.numbers):
            return False
        self.found = {
            "campaigns": len(kept),
            "windows": sum(len(k.labels) for k in kept),
            "healthy": sum(not x.changed for k in kept for x in k.labels),
            "sha256": write_shard(self._path, kept),
        }
        reached = [self.numbers.start, self.numbers.start + len(kept)]
        text = json.dumps({**self._made_by, "numbers": reached, **self.found})
        self._about.write_text(text + "\n", encoding="utf-8")
        return len(kept) == len(self.numbers)


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
