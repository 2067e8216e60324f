"""Cells before their calibration: twins, minutes of the record, priors, labels, and the jumps that events open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hil.record import RecordError
from hil.tower.calibration.healthy import healthy_of, known_by
from hil.tower.file_kinds import cells_of
from hil.tower.station import (
    CellRecord,
    StationNotes,
    event_entries,
    read_cell,
    read_labels,
    read_notes,
    seconds,
    station_of,
)
from twin.network import Network, TwinFileError
from twin.tower import (
    ANY_DRAUGHT,
    FAN_DENSITY,
    FORCED,
    IDS,
    INDUCED,
    Array,
    CellModel,
    DesignPoint,
    Minutes,
    Opening,
    Priors,
    cell_of,
    design_of,
    minutes_of,
    site_pressure_of,
    station_of_twin,
    time_grid,
    value_of,
)
from twin.tower.cell_observations import Label
from twin.tower.diagnosis import effects_of
from twin.twinfile import is_edited, load, read_text


def prepare_cells(
    record: Path, twins: Sequence[Path], labels: Path | None, events: Path | None = None
) -> tuple[list[PreparedCell], StationNotes]:
    """Read the cells of these twins, each with what its calibration is made of; raises as `calibrate`."""
    loaded = load_all(twins, record)
    notes = read_notes(record)
    if events is not None:
        notes = replace(notes, events=event_entries(events))
    found = read_labels(labels, tuple(loaded)) if labels is not None else ()
    return [
        _prepare(record, cell, path, network, notes, tuple(label for label in found if label.cell == cell))
        for cell, (path, network) in loaded.items()
    ], notes


@dataclass(frozen=True)
class PreparedCell:
    """A cell with what its calibration is made of."""

    twin: Path
    network: Network
    record: CellRecord
    model: CellModel
    minutes: Minutes
    priors: Priors
    labels: tuple[Label, ...]
    openings: tuple[Opening, ...]
    edges_s: Array


def load_all(twins: Sequence[Path], record: Path) -> dict[int, tuple[Path, Network]]:
    """Return file and network of each twin by its cell.

    Raises
    ------
    RecordError, TwinFileError
        A twin is of no cell of the record, or of the cell of another one, was edited, or leaves a deviation no room.
    """
    loaded: dict[int, tuple[Path, Network]] = {}
    there = cells_of(record)
    if not there:
        raise RecordError(f"{record}: holds no cell<N>.parquet; make an aligned record with hil tower align")
    for path in twins:
        network = load(path)
        try:
            cell = cell_of(network)
        except TwinFileError as error:
            raise TwinFileError(f"{path}: {error}") from error
        if cell in loaded:
            raise TwinFileError(f"{path}: is of cell {cell}, as {loaded[cell][0]} is; give one twin for each cell")
        if cell not in there:
            cells = ", ".join(f"cell {n}" for n in there)
            raise TwinFileError(
                f"{path}: is of cell {cell}, which {record} does not hold; it holds {cells}: give their twins"
            )
        of_record, of_twin = station_of(record, cell), station_of_twin(network)
        if of_record and of_twin and of_record != of_twin:
            raise TwinFileError(
                f"{path}: is of station {of_twin!r} and {record} of station {of_record!r}; give the twins of that "
                f"station"
            )
        _refuse_unusable(path, network)
        loaded[cell] = (path, network)
    return loaded


def _refuse_unusable(path: Path, network: Network) -> None:
    """Raise TwinFileError for a twin whose evidence no longer holds, or that leaves a deviation no room."""
    if is_edited(read_text(path), network.revision.checksum):
        raise TwinFileError(
            f"{path}: was edited after it was saved, so its evidence no longer holds (`hil twin log` shows it); "
            "restore the file, or remove its line checksum if the change is meant"
        )
    for identifier in IDS.values():
        low, high = (float(bound[0]) for bound in network.bounds([identifier]))
        if not low < high:
            raise TwinFileError(f"{path}: {identifier} has no room between its bounds {low:g} and {high:g}; widen them")


def _prepare(
    record: Path, cell: int, path: Path, network: Network, notes: StationNotes, labels: tuple[Label, ...]
) -> PreparedCell:
    minutes_read = read_cell(record, cell)
    design, share = design_of(network), value_of(network, "cell.bypass_share")
    effects = effects_of(network)
    minutes = minutes_of(
        minutes_read.time_s,
        minutes_read.columns,
        minutes_read.origin,
        design.m_w0,
        share,
        effects,
        site_pressure_of(network),
    )
    flow = float(np.nanmedian(minutes.operation.inputs.m_w[minutes.known])) if minutes.known.any() else np.nan
    if not minutes.known.any():
        raise RecordError(
            f"{minutes_read.path}: no minute has water above a fifth of the design flow, {design.m_w0:g} kg/s, and "
            f"all inputs; "
            "is the twin of this station, and the flow in kg/s?"
        )
    if flow > 2.0 * design.m_w0:
        raise RecordError(
            f"OTHER_UNITS: {minutes_read.path}: the flow is {flow:.0f} kg/s at the median and the twin's design flow "
            f"{design.m_w0:g} kg/s; give the twin of this station instead of {path}, or the flow in kg/s"
        )
    healthy = healthy_of(path, network)
    priors, stated = known_by(healthy, priors_of(network, notes), minutes, cell)
    edges = time_grid(float(minutes.time_s[0]), float(minutes.time_s[-1]))
    model = CellModel(design, site_of(notes, share), effects)
    return PreparedCell(
        path, network, minutes_read, model, minutes, priors, (*labels, *stated), tuple(openings_of(notes, cell)), edges
    )


def priors_of(network: Network, notes: StationNotes | None = None) -> Priors:
    """Return the priors of a twin: bounds of the deviations, and the uncertainty of the clean cell.

    The datasheet of a station's notes names the draught, if any: where the fan stands.
    """
    bounds = {}
    for name, identifier in IDS.items():
        low, high = network.bounds([identifier])
        bounds[name] = float(high[0] - low[0]) / 2.0
    replaced = {
        "merkel": (0.0, value_of(network, "cell.merkel_sd")),
        "exponent": (0.0, value_of(network, "cell.exponent_sd")),
    }
    if notes is not None:
        replaced[FAN_DENSITY] = _fan_density(str(notes.datasheet.get("kind", "")).casefold())
    return Priors(bounds, replaced)


def _fan_density(kind: str) -> tuple[float, float]:
    """Return mean and standard deviation of the power of the exhaust's density, by a datasheet's kind of tower."""
    if "forced" in kind:
        return FORCED
    return INDUCED if "induced" in kind else ANY_DRAUGHT


def site_of(notes: StationNotes, bypass_share: float) -> DesignPoint:
    """Return the design point of a datasheet; the usual rating where it gives none."""
    design, usual = notes.datasheet.get("design", {}), DesignPoint()
    return DesignPoint(
        float(design.get("water_inlet_C", usual.inlet)),
        float(design.get("wet_bulb_C", usual.wet)),
        float(design.get("range_K", usual.fall)),
        bypass_share,
    )


def openings_of(notes: StationNotes, cell: int) -> tuple[Opening, ...]:
    """Return the jumps that the station's events open for a cell."""
    found = []
    for event in notes.events:
        if event["cell"] not in (0, cell):
            continue
        start, end = seconds(event["from"]), seconds(event["to"])
        found += [Opening(start, end, name) for name in event["parameters"]]
    return tuple(found)
