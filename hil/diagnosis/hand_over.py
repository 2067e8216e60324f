"""A record or a run handed to the diagnosis: columns chosen, the time of day added, the result written.

The work itself is in `twin.discovery`; here is what concerns files.
"""

from __future__ import annotations

import dataclasses
import datetime
import json
import platform
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from drivers.rig_file.reader import file_sha256
from hil import __version__
from hil.diagnosis.store import CURVES, curves_of, write_curves, write_document
from hil.files.names import printable
from hil.record.reader import Reading, Record, read_record
from hil.record.segments import Parts
from hil.record.times.time_axis import span
from hil.record.values.units import beyond_declared
from twin.discovery.answer.unused import with_unused
from twin.discovery.diagnosis import Diagnosis
from twin.discovery.elsewhere import elsewhere
from twin.discovery.engine import diagnose
from twin.discovery.growing.answer import diagnose_grown, fits_growth
from twin.discovery.healthy.basis import Columns, Commissioned
from twin.discovery.planning.experiment import Limits
from twin.discovery.records.grid import on_grid
from twin.network import InputSpec, Network, Revision, TwinFileError
from twin.revisions import chain, save_revision
from twin.twinfile import save

CLOCK = "time_of_day_h"
PROPOSAL = "empirical.toml"


class DiagnosingError(ValueError):
    """What is to be diagnosed is not there; the message is one plain sentence."""


def clock_of(text: str) -> float:
    """Hours since midnight of a time like 08:00."""
    try:
        moment = datetime.time.fromisoformat(text)
    except ValueError:
        raise DiagnosingError(f"--clock {text!r} is not a time of day; write it like 08:00") from None
    return moment.hour + moment.minute / 60.0 + moment.second / 3600.0


def clock_beside(record: Path) -> float | None:
    """Hours since midnight at 0 s as a `datasheet.json` beside the record tells (`clock_at_time_0`), or None."""
    try:
        sheet = json.loads((record.parent / "datasheet.json").read_text(encoding="utf-8"))
        return clock_of(str(sheet["clock_at_time_0"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def start_hour(record: Record) -> float | None:
    """Hours since midnight at 0 s, where the record tells it."""
    if record.start is None:
        return None
    s = record.start
    return s.hour + s.minute / 60.0 + s.second / 3600.0


def with_clock(network: Network) -> Network:
    """The network with the time of day as an input, so that effects may follow it."""
    if CLOCK in network.inputs:
        return network
    spec = InputSpec(CLOCK, 12.0, 0.0, 24.0, "h", "time of day of the record")
    return dataclasses.replace(network, inputs=MappingProxyType({**network.inputs, CLOCK: spec}))


def columns_of(network: Network, record: Record, hour_at_0: float | None) -> Columns:
    """What the network needs of a record.

    Raises:
        RecordError: an input column is missing. TwinFileError: a sensor is.
    """
    columns: dict[str, NDArray[np.float64]] = dict(record.columns)
    if CLOCK in network.inputs and CLOCK not in columns:
        columns[CLOCK] = (((hour_at_0 or 0.0) + record.time_s / 3600.0) % 24.0).astype(np.float64)
    Record(record.time_s, columns, path=record.path).require(*network.input_columns)
    return Columns.of(network, record.time_s, columns)


def in_parts(record: Record) -> Record:
    """A run that was cut and resumed, so that a twin begins anew after each gap; any other record as it is."""
    segment = record.columns.get("segment")
    if segment is None or "profile_s" not in record.columns:  # another logger's column may be called so too
        return record
    parts = Parts.of(record.time_s, segment)
    rows = parts.rows
    said: tuple[str, ...] = ()
    if rows != slice(0, len(segment)):
        low, high = record.time_s[rows][[0, -1]]
        said = (
            f"the run was cut and resumed, and the gaps are longer than it: diagnosed is its longest part, "
            f"{span(float(low))} to {span(float(high))} of the record",
        )
    return dataclasses.replace(
        record,
        time_s=record.time_s[rows],
        columns={name: np.where(parts.aside, np.nan, values[rows]) for name, values in record.columns.items()},
        quality={name: values[rows] for name, values in record.quality.items()},
        messages=(*record.messages, *said),
    )


def read_columns(
    network: Network, path: Path, hour_at_0: float | None, *, at_rest: bool = False, choice: Reading | None = None
) -> tuple[Columns, tuple[str, ...]]:
    """Columns of a record file, or of steady states, and what reading it met.

    Raises:
        RecordError, TwinFileError: it cannot be read, lacks a column or is too short; the message names the file.
    """
    record = read_record(path, at_rest=at_rest, choice=choice)
    if not at_rest:
        record = in_parts(record)
    hour = hour_at_0 if hour_at_0 is not None else start_hour(record)
    try:
        columns = columns_of(network, record, hour)
        if not at_rest:
            on_grid(network, columns.time_s, columns.inputs, columns.measured)
    except TwinFileError as error:
        text = [message for message in record.messages if message.endswith("holds text: dropped")]
        raise type(error)("; ".join([f"{path}: {error}", *text])) from None
    return columns, (*record.messages, *beyond_declared(network, record.columns))


def read_healthy(
    network: Network, twin: Path, path: Path, hour_at_0: float | None, choice: Reading | None = None
) -> Commissioned:
    """The healthy record of a twin, which may have taken up effects since it was made; see `read_columns`."""
    columns, _ = read_columns(network, path, hour_at_0, choice=choice)
    told = [with_clock(entry.network) if CLOCK in network.inputs else entry.network for entry in chain(twin)[1:]]
    alike = tuple(
        n for n in told if n.input_columns == network.input_columns and n.sensor_names == network.sensor_names
    )
    return Commissioned(columns.time_s, columns.inputs, columns.measured, columns.members, alike)


def answer(
    network: Network,
    record: Columns,
    healthy: Columns | None,
    *,
    more: Mapping[str, Columns],
    limits: Limits | None,
    at_rest: bool,
    say: Callable[[str], None],
) -> Diagnosis:
    """A contest of effects with a twin that is nearly right, or the growth of one that was never commissioned.

    Raises:
        TwinFileError: the record cannot be diagnosed.
    """
    if at_rest or (healthy is None and fits_growth(network, record)):
        found = diagnose_grown(network, record, more=tuple(more.values()), at_rest=at_rest, say=say)
    else:
        found = diagnose(network, record, healthy, more=tuple(more.values()), say=say, limits=limits)
    found = with_unused(found, network, record.inputs)
    if not more:
        return found
    say("looking at the further records")
    further = tuple(elsewhere(found, network, columns, name) for name, columns in more.items())
    said = (one.says for one in further if one.says)
    return dataclasses.replace(found, elsewhere=further, notes=(*found.notes, *said))


def further_columns(
    network: Network, paths: Sequence[Path], hour_at_0: float | None, choice: Reading | None = None
) -> dict[str, Columns]:
    """Further records by what tells them apart: name of the file, or as much of its path as it takes."""
    alike = Counter(path.name for path in paths)
    return {
        path.name if alike[path.name] == 1 and path.name != "record.parquet" else str(path): read_columns(
            network, path, hour_at_0, choice=choice
        )[0]
        for path in paths
    }


def revise(diagnosis: Diagnosis, network: Network, twin: Path, record: Path, *, empirical: bool = False) -> Path | None:
    """Save the twin with its new effects beside the old one; None where there is nothing to add.

    Args:
        empirical: adopt the curve that is offered where nothing explains the record.
    """
    bigger = _curved(diagnosis, network, record) if empirical else _grown(diagnosis, network, record)
    return save_revision(bigger, twin) if bigger is not None else None


def write_proposal(diagnosis: Diagnosis, network: Network, record: Path, out: Path) -> Path | None:
    """Write the twin with the curve that is offered, `empirical.toml`, into the folder; None where none is."""
    bigger = _curved(diagnosis, network, record)
    path = out / PROPOSAL
    path.unlink(missing_ok=True)
    return save(bigger, path) if bigger is not None else None


def _grown(diagnosis: Diagnosis, network: Network, record: Path) -> Network | None:
    if diagnosis.network is None:
        return None
    effects = tuple(
        f"{e.kind} at {e.where}, {e.driver}, {e.value:.4g} {e.unit}, {e.shape} since {e.onset_s:.0f} s"
        for e in diagnosis.effects
    )
    before = {name: float(e.before) for name, e in diagnosis.errors.items()}
    after = {name: float(e.after) for name, e in diagnosis.errors.items()}
    return _stamped(diagnosis, diagnosis.network, network, record, effects, diagnosis.summary, before, after)


def _curved(diagnosis: Diagnosis, network: Network, record: Path) -> Network | None:
    curve = diagnosis.empirical
    if curve is None:
        return None
    effects = (f"heat of unknown origin at {curve.node}, a curve of {curve.variable}",)
    before = {name: b for name, (b, _) in curve.errors.items()}
    after = {name: a for name, (_, a) in curve.errors.items()}
    return _stamped(diagnosis, curve.network, network, record, effects, curve.says, before, after)


def _stamped(
    diagnosis: Diagnosis,
    bigger: Network,
    network: Network,
    record: Path,
    effects: tuple[str, ...],
    evidence: str,
    before: dict[str, float],
    after: dict[str, float],
) -> Network:
    """The bigger network with its evidence, and without a time of day that nothing in it follows."""
    used = {column for element in bigger.elements for column in element.inputs()}
    inputs = {c: s for c, s in bigger.inputs.items() if c in used or (c in network.inputs and c != CLOCK)}
    revision = Revision(
        number=network.revision.number + 1,
        made_by=f"hil diagnose {printable(record.name)}",
        window_s=(0.0, diagnosis.held_out_s[0]),
        error_before_K=before,
        error_after_K=after,
        held_out_s=diagnosis.held_out_s,
        effects=effects,
        evidence=evidence,
    )
    return dataclasses.replace(bigger, inputs=MappingProxyType(inputs), revision=revision)


def provenance(files: dict[str, Path | None]) -> dict[str, object]:
    """Hash of each file, versions, host and time."""
    return {
        "files": {
            name: {"path": str(path), "sha256": file_sha256(path)} for name, path in files.items() if path is not None
        },
        "versions": {
            "hil": __version__,
            "python": platform.python_version(),
            **{name: metadata.version(name) for name in ("numpy", "scipy", "numba", "pyarrow", "matplotlib")},
        },
        "made": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "host": platform.node(),
    }


def write(diagnosis: Diagnosis, sensors: tuple[str, ...], out: Path, extra: dict[str, object]) -> Path:
    """Write document, curves and page into the folder; returns the page. `sensors` are the twin's."""
    from hil.diagnosis.page import write_page

    out.mkdir(parents=True, exist_ok=True)
    write_document({**diagnosis.document(), **extra}, out)
    write_curves(curves_of(diagnosis, sensors), out / CURVES)
    return write_page(out)
