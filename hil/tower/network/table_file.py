"""Table `network.parquet` of a network's answers by minute, beside `calibrated.parquet`: the symmetric branch.

Columns are those of `calibrated.parquet` without the measured outlet. The file's metadata names the branch, the
ensemble and the number of its members.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from hil.files import parse_json, replacing
from hil.record import RecordError
from hil.tower.calibration import CellResult
from hil.tower.network.answers import NetworkAnswers, StationAnswers
from twin.tower import DEVIATIONS

NETWORK_TABLE = "network.parquet"
KEY = b"hil.network"


@dataclass(frozen=True)
class AboutNetwork:
    """Origin of a table: branch and name of the ensemble, number of its members, those that are blind, and a
    sentence on an outlet that is the start's."""

    branch: str
    ensemble: str
    members: int
    blind: tuple[str, ...]
    outlet: str = ""

    def sentence(self) -> str:
        """Return a sentence for a report."""
        blind = f" The gate refused {', '.join(self.blind)} as BLIND." if self.blind else ""
        outlet = f" Its gate refused the outputs: {self.outlet}." if self.outlet else ""
        return (
            f"Network: {self.ensemble}, mean of {self.members} members, {self.branch} branch, which an offline report "
            f"uses; records hold the causal one.{blind}{outlet}"
        )


def write_network_table(answers: StationAnswers, results: Sequence[CellResult], out: Path) -> Path:
    """Write the answers of the symmetric branch into the folder `out`, all or nothing.

    Raises
    ------
    OSError
        The folder cannot be written.
    """
    about = {
        "branch": "symmetric",
        "ensemble": answers.name,
        "members": answers.members,
        "blind": list(answers.blind),
        "outlet": answers.outlet,
    }
    table = pa.concat_tables([_table(answers.symmetric[one.cell], one) for one in results])
    with replacing(out / NETWORK_TABLE) as unfinished:
        pq.write_table(table.replace_schema_metadata({KEY: json.dumps(about)}), unfinished, compression="zstd")
    return out / NETWORK_TABLE


def read_about(path: Path) -> AboutNetwork:
    """Return the origin of a table.

    Raises
    ------
    RecordError
        The file is no such table.
    """
    try:
        found = parse_json((pq.read_schema(path).metadata or {})[KEY])
        return AboutNetwork(
            str(found["branch"]),
            str(found["ensemble"]),
            int(found["members"]),
            tuple(map(str, found["blind"])),
            str(found.get("outlet", "")),
        )
    except (OSError, KeyError, ValueError, TypeError, OverflowError, pa.ArrowException) as error:
        raise RecordError(f"{path}: is no table of a network ({error}); calibrate again with --network") from error


def _table(found: NetworkAnswers, result: CellResult) -> pa.Table:
    time_s = result.minutes.time_s
    arrays = {
        "time": pa.array((time_s * 1e3).astype("datetime64[ms]"), pa.timestamp("ms", tz="UTC")),
        "cell": pa.array(np.full(len(time_s), result.cell, dtype=np.int32)),
    }
    for name, values in (
        ("t_out", found.t_out),
        ("t_out_lo", found.t_out - found.half),
        ("t_out_hi", found.t_out + found.half),
        ("t_out_commissioned", result.calibrated.commissioned),
    ):
        arrays[name] = pa.array(values.astype(np.float32), from_pandas=True)
    for j, name in enumerate(DEVIATIONS):
        value = found.deviations[:, j] + (0.0 if name == "bias" else 1.0)
        for suffix, side in (("", 0.0), ("_lo", -1.0), ("_hi", 1.0)):
            arrays[name + suffix] = pa.array(
                (value + side * found.deviation_half[:, j]).astype(np.float32), from_pandas=True
            )
    return pa.table(arrays)
