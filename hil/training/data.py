"""Windows of a training: generated campaigns of a folder, in parts that share no campaign."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.training.generate import campaigns_of
from twin.calibrators.hiera_unet import Deviations, Features, Store, Windows
from twin.calibrators.hiera_unet.data.channels import ChannelTable
from twin.calibrators.hiera_unet.simulated.campaigns import PER_RIG
from twin.calibrators.hiera_unet.simulated.store import windows_of
from twin.network import Network, TwinFileError

FEWEST = 6
"""Fewest campaigns for intervals: a 90 % interval needs nine windows that label each output."""


@dataclass(frozen=True)
class TrainingData:
    """Data of one training.

    Attributes
    ----------
    train
        Seen by the optimiser.
    validation
        Used for the curves.
    conformal
        Sets intervals and envelope.
    test
        Scored once, at the end.
    manifest, digest
        How they were made, and its SHA-256.
    """

    network: Network
    table: ChannelTable
    deviations: Deviations
    train: Windows
    validation: Windows
    conformal: Windows
    test: Windows
    manifest: dict[str, Any]
    digest: str


def read(folder: Path, features: Features, *, most: int | None = None) -> TrainingData:
    """Read the data of a folder.

    Parameters
    ----------
    most
        Campaigns of the training split, for a short look.

    Raises
    ------
    TwinFileError
        There are none, or they were made for another twin or channel table.
    """
    store = Store(folder, features)
    unseen = store.campaigns("conformal")
    looked = looked_at(len(unseen))
    if len(unseen) - sum(looked) < FEWEST:
        raise TwinFileError(
            f"{folder} holds {len(unseen)} campaigns to set intervals with, which are of too few rigs; give `hil train "
            f"loop` --windows {least_windows()} or more"
        )
    return TrainingData(
        network=features.network,
        table=features.table,
        deviations=features.deviations,
        train=store.windows("train", most=most),
        validation=windows_of(features, [k for k, hit in zip(unseen, looked, strict=True) if hit]),
        conformal=windows_of(features, [k for k, hit in zip(unseen, looked, strict=True) if not hit]),
        test=store.windows("test"),
        manifest=store.manifest,
        digest=store.digest,
    )


def looked_at(count: int) -> list[bool]:
    """Return True for campaigns of the curves; the others set intervals. Those of one rig are consecutive."""
    return [k // PER_RIG % 3 == 0 for k in range(count)]


def least_windows() -> int:
    """Return the fewest windows, in tens, for a training."""
    count = 10
    while (found := sum(campaigns_of(count, "conformal").values())) - sum(looked_at(found)) < FEWEST:
        count += 10
    return count
