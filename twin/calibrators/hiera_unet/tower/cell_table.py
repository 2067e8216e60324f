"""Minutes and cycles of a cell as arrays for windows, in one file.

A cycle is a target interval of two hours. Its prior uses the readings before it alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin.calibrators.hiera_unet.model.config import HieraError
from twin.calibrators.hiera_unet.tower.memory import memory_of
from twin.calibrators.hiera_unet.tower.table import SUBJECT, channels_of, clock_of, reading_of, statics_of
from twin.historian.events import Event
from twin.tower.air import Array
from twin.tower.cell import Design
from twin.tower.estimates import DAY_S
from twin.tower.minutes import Minutes
from twin.tower.model import DEVIATIONS
from twin.tower.recursive import Recursion

FORMAT = 1
MINUTELY = (
    "x",
    "m",
    "regime",
    "clock",
    "outlet",
    "reading",
    "water",
    "slopes",
    "chunk",
    "commissioned",
    "true_water",
    "point",
)
"""Arrays by minute."""
STABLE, STAGING, RAMP, HOT, MAINTAINED = range(5)
KINDS = ("stable", "fan staging", "load ramp", "high wet bulb", "after maintenance")
STAGED, RAMPED, HOT_QUANTILE, AFTER_D = 0.15, 0.08, 0.8, 3.0
"""Range of the fan's speed and of the load within a target, quantile of the wet bulb, days after a maintenance entry.
"""
LEAST_KNOWN, LEAST_SEEN = 0.6, 12
"""Share of a target's minutes with all inputs, and blocks of the day before, below which a cycle is no window."""


@dataclass(frozen=True)
class CellTable:
    """Arrays of one cell; n minutes, k cycles.

    Attributes:
        x, m: (n, C) channels and their mask. regime: (n,). clock: (n, 6). outlet: (n,) reading degC, NaN without a raw
        sample; reading: the same, interpolated.
        water: (n,) outlet by the linearised twin; slopes: (n, 3). chunk: (n,); reference: (chunks, 3).
        true_water: (n,) degC, NaN at rest or where no truth is. point: (n, 4) wet bulb, drive, speed, flow, scaled.
        start: (k,) first minute of each target. mean, sd, fit, fit_sd, true: (k, 4); `true` NaN where unknown.
        condition, age_h, seen: (k,). kind: (k,) of `KINDS`. valid, jumped: (k,) bool; a jump of a deviation lies in it.
        statics: (6,). design: (2,) range and approach K. memory: (20, 8). healthy_end: minute.
        commissioned: (n,) outlet by the commissioned twin.
    """

    name: str
    x: NDArray[np.float16]
    m: NDArray[np.bool_]
    regime: NDArray[np.uint8]
    clock: NDArray[np.float16]
    outlet: NDArray[np.float32]
    reading: NDArray[np.float32]
    water: NDArray[np.float32]
    slopes: NDArray[np.float32]
    chunk: NDArray[np.int32]
    reference: NDArray[np.float32]
    commissioned: NDArray[np.float32]
    true_water: NDArray[np.float32]
    point: NDArray[np.float16]
    start: NDArray[np.int64]
    mean: NDArray[np.float32]
    sd: NDArray[np.float32]
    fit: NDArray[np.float32]
    fit_sd: NDArray[np.float32]
    true: NDArray[np.float32]
    condition: NDArray[np.float32]
    age_h: NDArray[np.float32]
    seen: NDArray[np.float32]
    kind: NDArray[np.uint8]
    valid: NDArray[np.bool_]
    jumped: NDArray[np.bool_]
    statics: NDArray[np.float32]
    design: NDArray[np.float32]
    memory: NDArray[np.float32]
    healthy_end: int

    def save(self, path: Path) -> None:
        """Write the table to `path`, whole or not at all."""
        arrays: dict[str, Any] = {f.name: np.asarray(getattr(self, f.name)) for f in fields(self)}
        unfinished = path.with_name(f".{path.name}.part")
        with unfinished.open("wb") as file:
            np.savez(file, format=np.array(FORMAT), table=np.array(SUBJECT.digest()), **arrays)
        unfinished.replace(path)

    @classmethod
    def load(cls, path: Path) -> CellTable:
        """Return the table of `path`.

        Raises:
            HieraError: the file cannot be read, or belongs to another format or channel table.
        """
        try:
            with np.load(path, allow_pickle=False) as found:
                if int(found["format"]) != FORMAT or str(found["table"]) != SUBJECT.digest():
                    raise HieraError(
                        f"{path}: holds windows of another channel table or format; remove the folder and simulate anew"
                    )
                values: dict[str, Any] = {f.name: found[f.name] for f in fields(cls)}
        except (OSError, ValueError, KeyError) as error:
            if isinstance(error, HieraError):
                raise
            raise HieraError(
                f"{path}: cannot be read as windows of a cell ({error}); remove it and simulate anew"
            ) from error
        values["name"], values["healthy_end"] = str(values["name"]), int(values["healthy_end"])
        return cls(**values)


@dataclass(frozen=True)
class CellSources:
    """Data of a cell for its table; n minutes.

    Attributes
    ----------
    name, sheet, columns
        Name, datasheet, and columns of the aligned record.
    minutes, design, beliefs
        As in `twin.tower`.
    clean, log_clean
        (n,) outlet degC and logarithm of the fan power by the commissioned twin.
    events
        Entries of the station's maintenance record.
    healthy_end_s
        End of the healthy record, s since 1970.
    true_water, true
        (n,) degC and (n, 4), truth of a simulated cell; NaN where it is unknown.
    """

    name: str
    sheet: Mapping[str, Any]
    columns: Mapping[str, NDArray[Any]]
    minutes: Minutes
    design: Design
    clean: Array
    log_clean: Array
    beliefs: Recursion
    events: Sequence[Event]
    healthy_end_s: float
    true_water: Array
    true: Array


def cell_table(of: CellSources) -> CellTable:
    """Return the table of a cell."""
    sheet, columns, minutes, design, clean = of.sheet, of.columns, of.minutes, of.design, of.clean
    beliefs = of.beliefs
    t = minutes.time_s
    healthy_end = int(np.searchsorted(t, of.healthy_end_s))
    x, m = channels_of(columns, minutes, design, sheet, clean, of.log_clean, of.events, slice(0, healthy_end))
    sizes, u = sheet["design"], minutes.operation.inputs
    fall, wet0 = float(sizes["water_inlet_C"]) - float(sizes["water_outlet_C"]), float(sizes["wet_bulb_C"])
    point = np.stack(
        [(u.wet - wet0) / 10.0, (u.t_in - u.wet) / 10.0 - 1.0, 2.0 * u.speed - 1.0, 2.0 * (u.m_w / design.m_w0 - 1.0)],
        axis=1,
    )
    point = np.where(minutes.known[:, None], point, np.nan)
    start = np.searchsorted(t, beliefs.start_s)
    span = SUBJECT.target
    whole = (start >= SUBJECT.context - span) & (start + span <= len(t))
    inside = start[:, None] + np.arange(span)
    inside = np.minimum(inside, len(t) - 1)
    known = (minutes.known & np.isfinite(beliefs.water))[inside].mean(axis=1)
    middle = np.minimum(start + span // 2, len(t) - 1)
    return CellTable(
        name=of.name,
        x=x,
        m=m,
        regime=minutes.regime,
        clock=clock_of(t),
        outlet=minutes.outlet.astype(np.float32),
        reading=reading_of(columns, len(t)).astype(np.float32),
        water=beliefs.water.astype(np.float32),
        slopes=np.nan_to_num(beliefs.slopes).astype(np.float32),
        chunk=beliefs.chunk.astype(np.int32),
        reference=beliefs.reference.astype(np.float32),
        commissioned=clean.astype(np.float32),
        true_water=of.true_water.astype(np.float32),
        point=np.clip(point, -6.0, 6.0).astype(np.float16),
        start=start.astype(np.int64),
        mean=beliefs.mean.astype(np.float32),
        sd=beliefs.sd.astype(np.float32),
        fit=beliefs.fit.astype(np.float32),
        fit_sd=beliefs.fit_sd.astype(np.float32),
        true=of.true[middle].astype(np.float32),
        condition=beliefs.condition.astype(np.float32),
        age_h=(beliefs.age_s / 3600.0).astype(np.float32),
        seen=beliefs.seen.astype(np.float32),
        kind=_kinds(point, x, inside, beliefs.start_s, of.events),
        valid=whole & (known >= LEAST_KNOWN) & (beliefs.seen >= LEAST_SEEN),
        jumped=_jumped(of.true, inside),
        statics=statics_of(sheet, design).astype(np.float32),
        design=np.array([fall, float(sizes["water_outlet_C"]) - wet0], dtype=np.float32),
        memory=memory_of(minutes, clean, design.m_w0, fall, wet0, slice(0, healthy_end)),
        healthy_end=healthy_end,
    )


def trimmed(table: CellTable, keep: NDArray[np.bool_], settled: NDArray[np.bool_]) -> CellTable:
    """Return a table of some of its minutes.

    Parameters:
        keep: (n,) minutes that stay. settled: (n,) minutes in which a target may begin; a window is a cycle that is one
        of these and has its whole day.
    """
    whole = np.r_[0, np.cumsum(keep)]
    last = np.minimum(table.start + SUBJECT.target, len(keep))
    first = np.maximum(last - SUBJECT.context, 0)
    valid = table.valid & (whole[last] - whole[first] == SUBJECT.context)
    valid &= settled[np.minimum(table.start, len(keep) - 1)]
    return replace(
        table,
        **{name: getattr(table, name)[keep] for name in MINUTELY},
        start=whole[np.minimum(table.start, len(keep))],
        valid=valid,
        healthy_end=int(whole[table.healthy_end]),
    )


def _kinds(
    point: Array, x: NDArray[np.float16], inside: NDArray[np.int64], start_s: Array, events: Sequence[Event]
) -> NDArray[np.uint8]:
    """Return the kind of each cycle: the first that holds of maintenance, fan, load and weather."""

    def ptp(values: Array) -> Array:
        part = values[inside]
        low, high = (
            np.where(np.isfinite(part), part, np.inf).min(axis=1),
            np.where(np.isfinite(part), part, -np.inf).max(axis=1),
        )
        return np.where(high >= low, high - low, 0.0)

    wet = point[:, 0]
    hot = np.nanquantile(wet, HOT_QUANTILE) if np.isfinite(wet).any() else np.inf
    warm = np.nan_to_num(np.where(np.isfinite(wet[inside]), wet[inside], -9.0).max(axis=1), nan=-9.0) >= hot
    kind = np.where(warm, HOT, STABLE)
    load = x[:, SUBJECT.index("load")].astype(np.float64)
    kind = np.where(ptp(load) > RAMPED, RAMP, kind)
    kind = np.where(ptp(point[:, 2]) > 2.0 * STAGED, STAGING, kind)
    for event in events:
        if event.by_day and event.kind not in ("inspection", "airflow_traverse"):
            days = (start_s - event.time_s) / DAY_S
            kind = np.where((days >= 0.0) & (days < 1.0 + AFTER_D), MAINTAINED, kind)
    return kind.astype(np.uint8)


def _jumped(true: Array, inside: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return the cycles in which a true deviation moves by more than a twentieth of its bound."""
    part = true[inside]
    bounds = np.array([one.bound for one in SUBJECT.deviations])
    assert true.shape[1] == len(DEVIATIONS)
    return np.asarray(((np.ptp(np.nan_to_num(part), axis=1)) > 0.05 * bounds).any(axis=1))
