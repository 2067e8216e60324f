"""Campaigns on disk: compact records in shards, from which windows are made on request.

A folder holds `<split>-<source>-<number>.npz` and `manifest.json` with their generation and their SHA-256. A record
costs some ten bytes a value and step; its windows would cost two hundred times as much.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twin.calibrators.hiera_unet.context_fit.evidence import fitted_by, tokens_of
from twin.calibrators.hiera_unet.data.features import Features
from twin.calibrators.hiera_unet.data.series import ResampledSeries
from twin.calibrators.hiera_unet.data.windows import TARGET, Windows
from twin.calibrators.hiera_unet.simulated.campaigns import LabelledRecord, WindowLabel
from twin.network import Array, Network, TwinFileError
from twin.regular_file import refuse_irregular

FORMAT = 2
MANIFEST = "manifest.json"
SPLITS = ("train", "conformal", "test")


@dataclass(frozen=True)
class Kept:
    """Campaign with the labels of its windows."""

    campaign: LabelledRecord
    labels: tuple[WindowLabel, ...]


def write_shard(path: Path, kept: Sequence[Kept]) -> str:
    """Write campaigns into one compressed file, in one step; return its SHA-256."""
    names = sorted({name for k in kept for name in k.campaign.series.extra})
    lengths = [len(k.campaign.series) for k in kept]
    arrays: dict[str, np.ndarray] = {
        "length": np.array(lengths, dtype=np.int64),
        "start": np.array([k.campaign.series.time[0] for k in kept]),
        "hour": np.array([k.campaign.series.hour for k in kept]),
        "day": np.array([k.campaign.series.day for k in kept]),
        "nominal": np.stack([k.campaign.nominal for k in kept]),
        "amiss": np.concatenate([k.campaign.amiss for k in kept]),
        "source": np.array([k.campaign.source for k in kept]),
        "what": np.array(["; ".join(k.campaign.what) for k in kept]),
        "extra_names": np.array(names, dtype=np.str_),
        "labels": np.array([len(k.labels) for k in kept], dtype=np.int64),
    }
    for name in ("inputs", "measured", "spread"):
        arrays[name] = _stacked([getattr(k.campaign.series, name) for k in kept])
    for name in ("truth", "theta"):
        arrays[name] = _stacked([getattr(k.campaign, name) for k in kept])
    for name in names:
        lost = (k.campaign.series.extra.get(name, np.full(n, np.nan)) for k, n in zip(kept, lengths, strict=True))
        arrays[f"extra_{name}"] = _stacked(list(lost))
    flat = [label for k in kept for label in k.labels]
    arrays["end"] = np.array([x.end for x in flat], dtype=np.int64)
    for name in ("theta", "known", "fit"):
        arrays[f"label_{name}"] = np.stack([getattr(x, name) for x in flat])
    arrays["label_changed"] = np.array([x.changed for x in flat])
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile("wb", dir=path.parent, suffix=".tmp", delete=False) as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    os.replace(file.name, path)
    return hashlib.sha256(path.read_bytes()).hexdigest()


MOST_UNPACKED = 8 * 10**9
"""Largest size of a file's arrays once they are unpacked, bytes: a megabyte of equal values can stand for gigabytes."""


def _require_regular(path: Path) -> None:
    """Check that `path` is a regular file of bounded size.

    Raises:
        OSError: it is no regular file. ValueError: it unpacks to more than `MOST_UNPACKED` bytes.
    """
    refuse_irregular(path, path.stat().st_mode)
    with zipfile.ZipFile(path) as packed:
        size = sum(item.file_size for item in packed.infolist())
    if size > MOST_UNPACKED:
        raise ValueError(f"{path} unpacks to {size / 1e9:.0f} GB, and at most {MOST_UNPACKED / 1e9:.0f} GB are read")


def read_shard(path: Path) -> list[Kept]:
    """Return the campaigns of one file."""
    _require_regular(path)
    with np.load(path, allow_pickle=False) as file:
        a = {name: file[name] for name in file.files}
    kept = []
    edges = np.concatenate([[0], np.cumsum(a["length"])])
    label_edges = np.concatenate([[0], np.cumsum(a["labels"])])
    names = [str(name) for name in a["extra_names"]]
    for k in range(len(a["length"])):
        rows, own = slice(edges[k], edges[k + 1]), range(label_edges[k], label_edges[k + 1])
        time = a["start"][k] + 5.0 * np.arange(a["length"][k])
        extra = {name: a[f"extra_{name}"][rows].astype(np.float64) for name in names}
        extra = {name: values for name, values in extra.items() if np.isfinite(values).any()}
        wide = {name: a[name][rows].astype(np.float64) for name in ("inputs", "measured", "spread", "truth", "theta")}
        series = ResampledSeries(
            time, wide["inputs"], wide["measured"], wide["spread"], extra, float(a["hour"][k]), float(a["day"][k])
        )
        what = tuple(str(a["what"][k]).split("; ")) if str(a["what"][k]) else ()
        campaign = LabelledRecord(
            series, wide["truth"], wide["theta"], a["amiss"][rows], a["nominal"][k], str(a["source"][k]), what
        )
        labels = tuple(
            WindowLabel(
                int(a["end"][i]),
                a["label_theta"][i],
                a["label_known"][i],
                bool(a["label_changed"][i]),
                a["label_fit"][i],
            )
            for i in own
        )
        kept.append(Kept(campaign, labels))
    return kept


def windows_of(features: Features, kept: Iterable[Kept]) -> Windows:
    """Return the windows of campaigns, in order.

    Raises:
        ValueError: there are none.
    """
    rows = [(k.campaign, label) for k in kept for label in k.labels]
    if not rows:
        raise ValueError("there are no windows in these campaigns; generate some")
    parts = [_row(features, campaign, label) for campaign, label in rows]
    stacked = {name: np.stack([p[name] for p in parts]) for name in parts[0]}
    return Windows(**stacked)


def _row(features: Features, campaign: LabelledRecord, label: WindowLabel) -> Mapping[str, np.ndarray]:
    theta, steps = fitted_by(label.fit, len(features.deviations))
    bare = features.frame(campaign.series, label.end, campaign.nominal)
    frame = features.explained(bare, campaign.nominal, theta, steps)
    single = np.float32
    return {
        "x": frame.x.astype(single),
        "m": frame.m,
        "regime": frame.regime,
        "clock": frame.clock.astype(single),
        "meta": np.concatenate([frame.figures, tokens_of(label.fit, features.deviations)]).astype(single),
        "target": frame.target.astype(single),
        "truth": campaign.truth[label.end - TARGET : label.end].astype(single),
        "base": frame.base.astype(single),
        "state": frame.state,
        "inputs": frame.held[-TARGET:],
        "theta": label.theta.astype(single),
        "known": label.known,
        "changed": np.array(label.changed),
        "nominal": campaign.nominal,
    }


class Store:
    """Folder of generated campaigns.

    Raises:
        TwinFileError: no manifest, another format, or made for another twin or set of parameters.
    """

    def __init__(self, folder: Path, features: Features) -> None:
        self.folder, self.features = folder, features
        try:
            self.manifest: dict[str, Any] = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        except OSError as error:
            raise TwinFileError(f"{folder}: no training data there ({error.strerror}); generate it first") from None
        except ValueError as error:
            raise TwinFileError(f"{folder / MANIFEST}: is not JSON ({error}); generate the data again") from None
        ours = identity(features)
        for key, value in ours.items():
            if self.manifest.get(key) != value:
                raise TwinFileError(
                    f"{folder}: these data were made for another {key.replace('_', ' ')}; generate them again"
                )

    @property
    def digest(self) -> str:
        """Return the SHA-256 of the manifest, which identifies the data."""
        return hashlib.sha256((self.folder / MANIFEST).read_bytes()).hexdigest()

    def campaigns(self, split: str, source: str | None = None, most: int | None = None) -> list[Kept]:
        """Return the campaigns of a split (train, conformal or test), of one source or all.

        Raises:
            TwinFileError: a shard is missing or differs from the manifest.
        """
        kept: list[Kept] = []
        for name, entry in self.manifest["shards"].items():
            if entry["split"] != split or (source is not None and entry["source"] != source):
                continue
            path = self.folder / name
            if not path.is_file() or hashlib.sha256(path.read_bytes()).hexdigest() != entry["sha256"]:
                raise TwinFileError(f"{path}: is missing or altered since it was made; generate the data again")
            kept += read_shard(path)
            if most is not None and len(kept) >= most:
                return kept[:most]
        return kept

    def windows(self, split: str, source: str | None = None, most: int | None = None) -> Windows:
        """Return all windows of a split; `most` limits the number of campaigns."""
        return windows_of(self.features, self.campaigns(split, source, most))


def identity(features: Features) -> dict[str, Any]:
    """Return the identity that data and their reader must share; windows are made on reading, so channels may
    differ.
    """
    return {
        "format": FORMAT,
        "twin": structure(features.network),
        "extra_columns": list(features.table.extra),
        "parameters": list(features.deviations.ids),
    }


def structure(network: Network) -> str:
    """Return the SHA-256 of a twin's structure: its elements with their places, without the values of parameters."""
    said = [
        repr((e.kind, sorted((k, str(getattr(e, f.name))) for k, f in e.places().items()), e.name))
        for e in network.elements
    ]
    text = "\n".join([*said, *network.input_columns, *network.ids])
    return hashlib.sha256(text.encode()).hexdigest()


def write_manifest(folder: Path, features: Features, shards: Mapping[str, Mapping[str, Any]], **more: Any) -> None:
    """Write the manifest of a folder: `shards` name -> split, source, campaigns, windows, sha256."""
    text = json.dumps({**identity(features), **more, "shards": dict(shards)}, indent=1, sort_keys=True) + "\n"
    with tempfile.NamedTemporaryFile("w", dir=folder, suffix=".tmp", delete=False, encoding="utf-8") as file:
        file.write(text)
    os.replace(file.name, folder / MANIFEST)


Maker = Callable[[int], Kept]


def _stacked(rows: Sequence[Array]) -> np.ndarray:
    return np.concatenate(rows).astype(np.float32)
