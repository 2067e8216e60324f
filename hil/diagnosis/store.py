"""Results of a diagnosis as files: the data of page and review, without another diagnosis.

`diagnosis.json` holds the words and numbers, `diagnosis.parquet` the curves: `time_s`, per sensor `residual.<sensor>`
and `after.<sensor>` in K, per site `unknown.<site>` and `unknown_sd.<site>` in the site's unit; bands and units are in
its metadata.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from hil.files import parse_json, read_json, read_parquet, replacing, require_size
from twin.discovery import Diagnosis

DOCUMENT, CURVES, PAGE, REVIEW = "diagnosis.json", "diagnosis.parquet", "diagnosis.html", "diagnosis.rrd"
EXPERIMENT, PROPOSAL = "experiment.csv", "empirical.toml"
STAGED = ".diagnosis-"
"""Begin of the name of a folder in which results are made."""
_KEY = b"hil.diagnosis"

Floats = NDArray[np.float64]


class DiagnosisFolderError(ValueError):
    """Error of a folder with no diagnosis or a damaged one; the message states the remedy."""


@dataclass(frozen=True)
class Unknown:
    """Unknown input at one site alone: `mean` and `sd` (b,) in `unit`; K is a thermometer's offset."""

    site: str
    unit: str
    mean: Floats
    sd: Floats
    log_evidence: float


@dataclass(frozen=True)
class ResidualCurves:
    """Block means at `time_s` (b,): residuals (b,) in K by sensor, and unknown inputs, the likeliest first.

    residual: measured minus the baseline twin. after: with the answer. band: sd of a healthy one, K.
    """

    time_s: Floats
    residual: dict[str, Floats]
    after: dict[str, Floats]
    band: dict[str, float]
    unknowns: tuple[Unknown, ...]


@dataclass(frozen=True)
class Findings:
    """Content of a results folder: the document of `diagnosis.json` and its curves."""

    document: dict[str, Any]
    curves: ResidualCurves


def curves_of(diagnosis: Diagnosis, sensors: tuple[str, ...]) -> ResidualCurves:
    """Return the curves of a diagnosis; `sensors` are the twin's, in their order."""
    return ResidualCurves(
        time_s=np.asarray(diagnosis.hours, dtype=np.float64) * 3600.0,
        residual={name: diagnosis.residual[:, j] for j, name in enumerate(sensors)},
        after={name: diagnosis.residual_after[:, j] for j, name in enumerate(sensors)},
        band={name: float(diagnosis.band[j]) for j, name in enumerate(sensors)},
        unknowns=tuple(Unknown(c.site, c.unit, c.mean, c.sd, float(c.log_evidence)) for c in diagnosis.courses),
    )


def write_curves(curves: ResidualCurves, path: Path) -> None:
    """Write the curves as Parquet."""
    columns: dict[str, Floats] = {"time_s": curves.time_s}
    columns |= {f"residual.{name}": values for name, values in curves.residual.items()}
    columns |= {f"after.{name}": values for name, values in curves.after.items()}
    for u in curves.unknowns:
        columns[f"unknown.{u.site}"], columns[f"unknown_sd.{u.site}"] = u.mean, u.sd
    about = {
        "band_K": curves.band,
        "unknowns": [{"site": u.site, "unit": u.unit, "log_evidence": u.log_evidence} for u in curves.unknowns],
    }
    table = pa.table({name: pa.array(np.ascontiguousarray(values)) for name, values in columns.items()})
    with replacing(path) as temporary, temporary.open("wb") as file:
        pq.write_table(table.replace_schema_metadata({_KEY: json.dumps(about).encode()}), file)


def read_curves(path: Path) -> ResidualCurves:
    """Read the curves of `write_curves`; raise DiagnosisFolderError."""
    try:
        require_size(path, DiagnosisFolderError, 1)
        table = read_parquet(path, pa.BufferReader(path.read_bytes()), DiagnosisFolderError)
        about = parse_json(table.schema.metadata[_KEY])
    except DiagnosisFolderError:
        raise
    except (OSError, pa.ArrowException, KeyError, TypeError, ValueError) as error:
        raise DiagnosisFolderError(f"{path} holds no curves of a diagnosis ({error}); diagnose again") from error
    try:
        return _curves_of(table, about)
    except (pa.ArrowException, KeyError, TypeError, ValueError, AttributeError) as error:
        raise DiagnosisFolderError(f"{path} holds no curves of a diagnosis ({error}); diagnose again") from error


def _curves_of(table: pa.Table, about: Any) -> ResidualCurves:
    columns = {name: table.column(name).to_numpy().astype(np.float64) for name in table.column_names}
    band = {name: float(value) for name, value in about["band_K"].items()}
    return ResidualCurves(
        time_s=columns["time_s"],
        residual={name: columns[f"residual.{name}"] for name in band},
        after={name: columns[f"after.{name}"] for name in band},
        band=band,
        unknowns=tuple(
            Unknown(
                u["site"],
                u["unit"],
                columns[f"unknown.{u['site']}"],
                columns[f"unknown_sd.{u['site']}"],
                float(u["log_evidence"]),
            )
            for u in about["unknowns"]
        ),
    )


def write_document(document: dict[str, Any], out: Path) -> Path:
    """Write `diagnosis.json` into the folder."""
    path = out / DOCUMENT
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return path


def has_diagnosis(folder: Path) -> bool:
    """Return True if the folder holds a complete diagnosis."""
    return (folder / DOCUMENT).is_file() and (folder / CURVES).is_file()


def read_findings(folder: Path) -> Findings:
    """Read a results folder; raise DiagnosisFolderError."""
    path = folder / DOCUMENT
    try:
        document = read_json(path, DiagnosisFolderError)
    except OSError as error:
        raise DiagnosisFolderError(f"{path} cannot be read ({error}); diagnose again") from error
    if not isinstance(document, dict):
        raise DiagnosisFolderError(f"{path} is no diagnosis; diagnose again")
    return Findings(document, read_curves(folder / CURVES))
