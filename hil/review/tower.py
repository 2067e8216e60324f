"""Review of a tower's calibration: outlet measured, by the twin and with its interval, and the four deviations.

/tower/cell<N>/measured, /tower/cell<N>/twin   degC, (n, 1) and (n, 4): calibrated, interval, as commissioned
/tower/cell<N>/error                           measured minus calibrated, minus commissioned, and the former's interval,
                                               K, (n, 4)
/tower/cell<N>/<deviation>                     deviation with its 90 % interval, (n, 3)
/tower/cell<N>/network/outlet, .../<deviation> the same of a network that was asked, degC and share or K, (n, 3)
/tower/cell<N>/events/<lane>, .../events       events of the cell and of the station: states of lanes, and texts
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.files import replacing, utf8_path
from hil.journal import Header
from hil.review.batches import Rows, States, Texts
from hil.review.plan import FAINT, GREEN, NEUTRAL, ORANGE, RED, TRACKED, Colour, Lane, Lines, Panel, ReviewPlan, Stack
from hil.review.rerun_io import Recording
from hil.review.viewer import require_complete
from hil.tower import seconds

EVERY = 10
"""Minutes of one point: a mean of ten minutes is a steady block of the calibration."""
DEVIATIONS = {
    "fill": "fill, share of clean",
    "air": "air, share of clean",
    "uniformity": "uniformity, share of clean",
    "bias": "bias of the outlet thermometer [K]",
}
LEGEND_OF_FOUR = 1.4
"""Share of the height, beside panels of 1, in which a legend of four lines is whole."""
LANE_SHARE, AXIS_SHARE = 0.42, 0.45
"""Shares of the height of a lane and of the lanes' axis, beside panels of 1."""
NARROWEST = 0.003
"""Share of the time axis, in which a state of a lane is seen."""
OPERATION = ("fan_trip", "station_outage", "start_up", "load_step", "overflow", "makeup_event")
"""Classes of events of operation; others that move no deviation are tests and inspections."""
LANES: dict[str, Colour] = {"operation": TRACKED["blue"], "maintenance": GREEN, "tests": NEUTRAL, "found": ORANGE}
BLUE, VIOLET = TRACKED["blue"], TRACKED["violet"]
STATE_COLOURS = {"fan trip": RED, "station outage": RED, "start up together": VIOLET}
TableColumns = dict[str, NDArray[np.float64]]


def write_tower_review(
    table: Path, rrd: Path, name: str, network: Path | None = None, events: Sequence[Mapping[str, Any]] = ()
) -> None:
    """Write the calibrated table of a station's cells to `rrd`, completely or not at all.

    Parameters
    ----------
    network
        Table of a network that was asked, whose curves are drawn beside.
    events
        Entries of `events.json`.

    Raises
    ------
    ValueError
        The table cannot be read, or lacks a column; one sentence.
    OSError
        The file cannot be written.
    """
    cells = _cells(table)
    asked = {} if network is None else _cells(network)
    start = min(float(c["time_s"][0]) for c in cells.values())
    end = max(float(c["time_s"][-1]) for c in cells.values()) - start
    happened = {cell: [e for e in events if e["cell"] in (0, cell)] for cell in cells}
    plan = replace(_plan(cells, name, end, frozenset(asked), happened), start_s=start)
    with replacing(rrd) as unfinished, utf8_path(unfinished) as path:
        recording = Recording(plan, name, path=path)
        for cell, columns in cells.items():
            for entity, values in _curves(cell, columns):
                recording.send(Rows(entity, columns["time_s"] - start, values))
        for cell, columns in asked.items():
            for entity, values in _network_curves(cell, columns):
                recording.send(Rows(entity, columns["time_s"] - start, values))
        for cell, of_cell in happened.items():
            for batch in _event_batches(cell, of_cell, start, end):
                recording.send(batch)
        recording.layout(plan, end)
        recording.close()
        require_complete(path)


def _cells(table: Path) -> dict[int, TableColumns]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        data = pq.read_table(table)
        found: dict[int, TableColumns] = {}
        number = np.asarray(data["cell"].to_numpy())
        time_s = data["time"].cast(pa.int64()).to_numpy().astype(np.float64) / 1e3
        for cell in np.unique(number):
            rows = np.flatnonzero(number == cell)
            columns = {"time_s": _thinned(time_s[rows])}
            for column in data.schema.names:
                if column not in ("time", "cell"):
                    columns[column] = _thinned(np.asarray(data[column].to_numpy(), dtype=np.float64)[rows])
            found[int(cell)] = columns
        for columns in found.values():
            for column in {"t_out", "t_out_lo", "t_out_hi", "t_out_commissioned", *DEVIATIONS} - columns.keys():
                raise KeyError(column)
    except (OSError, pa.ArrowInvalid, KeyError, ValueError) as error:
        raise ValueError(f"{table}: is no table of hil tower calibrate ({error}); calibrate again") from error
    if not found:
        raise ValueError(f"{table}: holds no minute; calibrate again")
    return found


def _thinned(values: NDArray[Any]) -> NDArray[np.float64]:
    """Return means of ten minutes; a part without a number stays empty."""
    padded = np.full(-(-len(values) // EVERY) * EVERY, np.nan)
    padded[: len(values)] = values
    parts = padded.reshape(-1, EVERY)
    there = np.isfinite(parts)
    total = np.where(there, parts, 0.0).sum(axis=1)
    return np.where(there.any(axis=1), total / np.maximum(there.sum(axis=1), 1), np.nan)


def _curves(cell: int, c: TableColumns) -> list[tuple[str, NDArray[np.float64]]]:
    base = f"/tower/cell{cell}"
    measured = c.get("t_out_measured", np.full(len(c["time_s"]), np.nan))
    twin = np.stack([c["t_out"], c["t_out_lo"], c["t_out_hi"], c["t_out_commissioned"]], axis=1)
    half = 0.5 * (c["t_out_hi"] - c["t_out_lo"])
    error = np.stack([measured - c["t_out"], measured - c["t_out_commissioned"], -half, half], axis=1)
    found = [(f"{base}/measured", measured[:, None]), (f"{base}/twin", twin), (f"{base}/error", error)]
    for name in DEVIATIONS:
        band = [c.get(f"{name}{end}", np.full(len(c[name]), np.nan)) for end in ("", "_lo", "_hi")]
        found.append((f"{base}/{name}", np.stack(band, axis=1)))
    return found


def _network_curves(cell: int, c: TableColumns) -> list[tuple[str, NDArray[np.float64]]]:
    ends = ("", "_lo", "_hi")
    named = {"outlet": "t_out", **{d: d for d in DEVIATIONS}}
    return [
        (f"/tower/cell{cell}/network/{entity}", np.stack([c[f"{column}{end}"] for end in ends], axis=1))
        for entity, column in named.items()
    ]


def _lane(event: Mapping[str, Any]) -> str:
    if event["source"] == "calibration":
        return "found"
    if event["parameters"]:
        return "maintenance"
    return "operation" if event["kind"] in OPERATION else "tests"


def _state(event: Mapping[str, Any]) -> str:
    together = " together" if event["kind"] == "start_up" and event.get("text") else ""
    return str(event["kind"]).replace("_", " ") + together


def _event_batches(
    cell: int, events: Sequence[Mapping[str, Any]], start_s: float, end_s: float
) -> list[States | Texts]:
    """Return the states of each lane and the texts of a cell's events.

    A state lasts as long as its event may have, at least as long as is seen; of several at once the last is shown.
    """
    base = f"/tower/cell{cell}/events"
    found: list[States | Texts] = []
    for lane in LANES:
        spans = []
        for event in (e for e in events if _lane(e) == lane):
            low = max(seconds(event["from"]) - start_s, 0.0)
            spans.append((low, max(min(seconds(event["to"]) - start_s, end_s), low + NARROWEST * end_s), _state(event)))
        if spans:
            edges = sorted({edge for low, high, _ in spans for edge in (low, high)})
            there = [[state for low, high, state in spans if low <= at < high] for at in edges]
            found.append(States(f"{base}/{lane}", np.array(edges), [one[-1] if one else None for one in there]))
    if events:
        at = np.clip([seconds(event["time"]) - start_s for event in events], 0.0, end_s)
        levels = ["WARN" if _lane(event) in ("found", "maintenance") else "INFO" for event in events]
        order = np.argsort(at, kind="stable")
        texts = [_told(event) for event in events]
        found.append(Texts(f"{base}/list", at[order], [texts[k] for k in order], [levels[k] for k in order]))
    return found


def _told(event: Mapping[str, Any]) -> str:
    words = f"{str(event['kind']).replace('_', ' ')} ({event['source']})"
    if event["by_day"]:
        words += ", date by the day"
    return f"{words}: {event['text']}" if event.get("text") else words


def _lanes(cell: int, events: Sequence[Mapping[str, Any]]) -> list[Lane]:
    base = f"/tower/cell{cell}/events"
    states = {lane: sorted({_state(e) for e in events if _lane(e) == lane}) for lane in LANES}
    return [
        Lane(f"{base}/{lane}", {state: STATE_COLOURS.get(state, LANES[lane]) for state in of})
        for lane, of in states.items()
        if of
    ]


def _plan(
    cells: dict[int, TableColumns],
    name: str,
    end_s: float,
    asked: frozenset[int],
    events: Mapping[int, Sequence[Mapping[str, Any]]],
) -> ReviewPlan:
    lines: list[Lines] = []
    lanes: list[Lane] = []
    tabs = []
    for cell in cells:
        base = f"/tower/cell{cell}"
        lines += [
            Lines(f"{base}/measured", ("measured",), (NEUTRAL,)),
            Lines(f"{base}/twin", ("calibrated", "5 %", "95 %", "as commissioned"), (BLUE, FAINT, FAINT, ORANGE)),
            Lines(
                f"{base}/error", ("minus calibrated", "minus commissioned", "5 %", "95 %"), (BLUE, ORANGE, FAINT, FAINT)
            ),
            *(Lines(f"{base}/{d}", (d, "5 %", "95 %"), (BLUE, FAINT, FAINT)) for d in DEVIATIONS),
        ]
        of_network = (f"{base}/network/outlet",) if cell in asked else ()
        if cell in asked:
            lines += [
                Lines(f"{base}/network/{d}", ("network", "5 %", "95 %"), (VIOLET, FAINT, FAINT))
                for d in ("outlet", *DEVIATIONS)
            ]
        outlet = Panel("lines", "outlet [°C]", (f"{base}/measured", f"{base}/twin", *of_network), 2.0)
        error = Panel("lines", "reading minus twin [K]", (f"{base}/error",), LEGEND_OF_FOUR)
        panels = tuple(
            Panel("lines", title, (f"{base}/{d}", *((f"{base}/network/{d}",) if cell in asked else ())))
            for d, title in DEVIATIONS.items()
        )
        of_cell = _lanes(cell, events[cell])
        lanes += of_cell
        every = tuple(lane.entity for lane in of_cell)
        shown = tuple(entity for entity in every if not entity.endswith("/tests"))
        rows = (Panel("lanes", "events", shown, AXIS_SHARE + LANE_SHARE * len(shown)),) if shown else ()
        tabs.append(Stack("rows", (outlet, error, *rows, *panels), title=f"Cell {cell}"))
        if every:
            texts = Panel("texts", "events", (f"{base}/events/list",), 3.0)
            tabs.append(Stack("rows", (Panel("lanes", "events", every), texts), title=f"Events of cell {cell}"))
    return ReviewPlan(Header((), {}, (), name, end_s, 1.0, {}), tuple(lines), tuple(lanes), tuple(tabs))
