"""Healthy record of a clean cell: the twin's discrepancy and constants with their spread, in a file beside the twin."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hil.files import replacing
from hil.record import RecordError
from hil.tower.station import iso, read_object, seconds
from twin.network import Network
from twin.tower import DAY_S, NAMES, Array, Minutes, Priors, design_of
from twin.tower.cell_observations import Label
from twin.tower.clean_cell import FEATURES

CLEAN = {"fill": 0.015, "air": 0.01, "uniformity": 0.01}
"""Standard deviation of the deviations of a cell that counts as clean: two to four weeks of scale, an air flow as it
was measured to 1 %."""
FORMAT = 2
_SHAPE = {
    "format": int,
    "clean_cell": str,
    "from": str,
    "to": str,
    "constants": [str],
    "mean": [float],
    "covariance": [[float]],
}


@dataclass(frozen=True)
class Healthy:
    """Span of a healthy record, s since 1970, and the posterior of the twin's constants by it.

    `clean_cell` is the hash of the clean cell that learned it, which all revisions of a twin have in common.
    """

    start_s: float
    end_s: float
    mean: Array
    covariance: Array
    clean_cell: str = ""

    def labels(self, cell: int) -> tuple[Label, ...]:
        """Return the statement that the cell was clean, for a fit of a record that holds the span."""
        middle = 0.5 * (self.start_s + self.end_s)
        return tuple(Label(middle, cell, name, 0.0, 0.0, sd, "healthy record") for name, sd in CLEAN.items())


def parse_span(text: str) -> tuple[float, float]:
    """Return the span of FROM..TO, s since 1970.

    Raises
    ------
    RecordError
        It is no span.
    """
    try:
        start, end = (seconds(part) for part in text.split(".."))
    except ValueError:
        raise RecordError(f"{text!r} is no span; write it as 2022-05-01..2022-05-15") from None
    if end - start < DAY_S:
        raise RecordError(f"{text!r} is shorter than a day; give a healthy record of several days")
    return start, end


def path_beside(twin: Path, network: Network) -> Path:
    """Return the path of a twin's healthy record; its revisions have the same."""
    return twin.parent / f"{network.name}.healthy.json"


def write_healthy(healthy: Healthy, path: Path) -> None:
    """Write a healthy record.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    text = json.dumps(
        {
            "format": FORMAT,
            "clean_cell": healthy.clean_cell,
            "from": iso(healthy.start_s),
            "to": iso(healthy.end_s),
            "constants": [*NAMES, *(f"feature_{k}" for k in range(len(healthy.mean) - len(NAMES)))],
            "mean": [float(f"{v:.7g}") for v in healthy.mean],
            "covariance": [[float(f"{v:.7g}") for v in row] for row in healthy.covariance],
        }
    )
    with replacing(path) as unfinished:
        unfinished.write_text(text + "\n")


def clean_cell_of(network: Network) -> str:
    """Return the hash of a twin's clean cell: the constants that its commissioning found."""
    return hashlib.sha256(repr(astuple(design_of(network))).encode()).hexdigest()


def healthy_of(twin: Path, network: Network) -> Healthy | None:
    """Return the healthy record beside a twin, None without one.

    Raises
    ------
    RecordError
        The file is damaged, of another version, or was learned by another clean cell.
    """
    path = path_beside(twin, network)
    found = read_healthy(path)
    if found is not None and found.clean_cell != clean_cell_of(network):
        raise RecordError(
            f"{path}: is the healthy record of another clean cell than that of {twin}; put each twin and its healthy "
            "record into a folder of its own, or commission the cell again with --healthy"
        )
    return found


def read_healthy(path: Path) -> Healthy | None:
    """Return a healthy record, None where there is none.

    Raises
    ------
    RecordError
        The file is damaged or of another version.
    """
    if not path.exists():
        return None
    remedy = "commission the cell again with --healthy"
    found = read_object(path, _SHAPE, remedy)
    try:
        return _healthy(found)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise RecordError(f"{path}: is no healthy record ({error}); {remedy}") from error


def _healthy(found: Mapping[str, Any]) -> Healthy:
    """Return the healthy record of a file's content."""
    count = len(NAMES) + FEATURES
    healthy = Healthy(
        seconds(found["from"]),
        seconds(found["to"]),
        np.array(found["mean"], dtype=float),
        np.array(found["covariance"], dtype=float),
        found["clean_cell"],
    )
    named = found["constants"][: len(NAMES)] == list(NAMES) and found["format"] == FORMAT
    if not named or healthy.mean.shape != (count,) or healthy.covariance.shape != (count, count):
        raise ValueError("its constants are those of another version")
    np.linalg.cholesky(healthy.covariance)
    return healthy


def known_by(healthy: Healthy | None, priors: Priors, minutes: Minutes, cell: int) -> tuple[Priors, tuple[Label, ...]]:
    """Return the priors and labels with which a calibration uses a healthy record.

    A record that holds the span is fitted with the statement that the cell was clean then, so that no reading counts
    twice; another record takes the learned constants as its prior.
    """
    if healthy is None:
        return priors, ()
    middle = 0.5 * (healthy.start_s + healthy.end_s)
    if minutes.time_s[0] <= middle <= minutes.time_s[-1]:
        return priors, healthy.labels(cell)
    return replace(priors, learned=(healthy.mean, healthy.covariance)), ()
