"""Only module that imports rerun: writes batches to a file or a viewer, reads them back, takes screenshots."""

from __future__ import annotations

import time
import uuid
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from rerun.chunk import RrdReader
from rerun.experimental import ViewerClient

from hil.files import printable, utf8_path
from hil.review.batches import Estimates, ReviewBatch, Rows, States, Texts
from hil.review.plan import NEUTRAL, Colour, Panel, ReviewPlan, Stack, symbol, twin_colours

TIMELINE, DATES = "test_time", "UTC"
_AFTER = 0.07
"""Part of the time axis behind the run: the last time on the axis would be cut else."""
_SETTLED = 3
_AFTER_TIME = "  "


class Recording:
    """Stream of a run to Rerun: to a file (`path`) or to a viewer (`url`), each with its own batches."""

    def __init__(self, plan: ReviewPlan, name: str, *, path: Path | None = None, url: str | None = None) -> None:
        # A unique id: a viewer of the live stream must not merge the file into it.
        self._stream = rr.RecordingStream(printable(f"hil {plan.header.profile}"), recording_id=str(uuid.uuid4()))
        if path is not None:
            self._stream.save(path)
        if url is not None:
            self._stream.connect_grpc(url)
        self._stream.send_recording_name(printable(name))
        self._header = plan.header
        self._live = url is not None
        self._start_s = plan.start_s
        self._colours: dict[str, Colour] = {}
        self._send_styles(plan)
        self._plan: ReviewPlan | None = None
        self._units: set[str] = set()

    def layout(self, plan: ReviewPlan, end_s: float) -> None:
        """Send the blueprint, time axes from 0 to `end_s`, s."""
        self._plan = plan
        self._stream.send_blueprint(_blueprint(plan, end_s, self._live))

    @property
    def plan(self) -> ReviewPlan | None:
        """Return the plan whose layout was sent last."""
        return self._plan

    def extend(self, plan: ReviewPlan) -> None:
        """Add the styles of new entities of a plan; `layout` shows them."""
        self._send_styles(plan)

    def note(self, entity: str, markdown: str) -> None:
        """Send a text that holds at all times."""
        self._stream.log(entity, rr.TextDocument(printable(markdown), media_type=rr.MediaType.MARKDOWN), static=True)

    def _send_styles(self, plan: ReviewPlan) -> None:
        self._colours |= plan.colours
        for lines in plan.lines:
            style = rr.SeriesLines(
                names=lines.names,
                colors=lines.colours or None,
                widths=(lines.widths * len(lines.names))[: len(lines.names)],
                aggregation_policy="MinMax" if lines.extremes else "Average",
                interpolation_mode="StepAfter" if lines.steps else "Linear",
            )
            self._stream.log(lines.entity, style, static=True)
        for entity, text in plan.notes.items():
            self._stream.log(entity, rr.TextDocument(printable(text)), static=True)
        for lane in plan.lanes:
            states = list(lane.colours)
            colours = rr.StateConfiguration(values=states, labels=states, colors=list(lane.colours.values()))
            self._stream.log(lane.entity, colours, static=True)

    def send(self, batch: ReviewBatch) -> None:
        """Send one batch as one chunk."""
        times = [rr.TimeColumn(TIMELINE, duration=_nanoseconds(batch.time_s))]
        if self._start_s is not None:
            moments = np.round((self._start_s + batch.time_s) * 1e3).astype("datetime64[ms]")
            times.append(rr.TimeColumn(DATES, timestamp=moments.astype("datetime64[ns]")))
        match batch:
            case Rows(entity, time_s, values):
                columns = rr.Scalars.columns(scalars=np.ascontiguousarray(values).ravel())
                self._stream.send_columns(entity, times, columns.partition([values.shape[1]] * len(time_s)))
            case Estimates(entity, name, unit, _, values, variances):
                if entity not in self._units:
                    colour = self._colours.get(entity) or twin_colours(self._header.twin_names).get(name, NEUTRAL)
                    style = rr.Measurements.from_fields(names=[name], units=[symbol(unit)], colors=[colour])
                    self._stream.log(entity, style, static=True)
                    self._units.add(entity)
                self._stream.send_columns(entity, times, rr.Measurements.columns(values=values, variances=variances))
            case States(entity, _, states):
                self._stream.send_columns(entity, times, rr.StateChange.columns(state=pa.array(states)))
            case Texts(entity, time_s, texts, levels):
                said = [self._moment(at) for at in time_s.tolist()]
                words = [at + _AFTER_TIME + printable(text) for at, text in zip(said, texts, strict=True)]
                self._stream.send_columns(entity, times, rr.TextLog.columns(text=words, level=levels))

    def _moment(self, time_s: float) -> str:
        """Return a time as the axes of this stream write it: since the beginning, or a date."""
        if self._start_s is None:
            return axis_time(time_s)
        return str(np.datetime64(round(self._start_s + time_s), "s")).replace("T", " ")

    def flush(self, timeout_s: float) -> bool:
        """Return True if everything arrived within `timeout_s`."""
        try:
            self._stream.flush(timeout_sec=timeout_s)
        except (RuntimeError, ValueError, OSError):
            return False
        return True

    def close(self) -> None:
        """Finish: a file gets its index and can be opened."""
        self._stream.disconnect()


def axis_time(time_s: float) -> str:
    """Return a time as Rerun's time axes write it: `+1h 10m 05s`."""
    sign, whole = "-" if time_s < 0.0 else "+", round(abs(time_s))
    minutes, seconds = divmod(whole, 60)
    hours, minutes = divmod(minutes, 60)
    days, hours = divmod(hours, 24)
    parts = [f"{days}d"] * bool(days) + [f"{hours}h"] * bool(days or hours) + [f"{minutes:02d}m {seconds:02d}s"]
    return sign + " ".join(parts)


def _nanoseconds(time_s: NDArray[np.float64]) -> NDArray[Any]:
    return np.round(time_s * 1e9).astype("timedelta64[ns]")


def _text_columns() -> rrb.TextLogColumns:
    kinds = rrb.encodings.TextLogColumnKind
    shown = [rrb.encodings.TextLogColumn(kind, visible=kind != kinds.EntityPath) for kind in kinds]
    # Rerun's own column counts seconds: each text begins with the time in the format of the axes.
    hidden = [rrb.encodings.TimelineColumn(TIMELINE, visible=False)]
    return rrb.TextLogColumns(timeline_columns=hidden, text_log_columns=shown)


def _blueprint(plan: ReviewPlan, end_s: float, live: bool) -> rrb.Blueprint:
    timeline, origin = (TIMELINE, 0.0) if plan.start_s is None else (DATES, plan.start_s)

    def view(panel: Panel, around: float) -> Any:
        margin = max(around, panel.margin)
        start = rrb.TimeRangeBoundary.absolute(seconds=origin - margin * end_s)
        end = rrb.TimeRangeBoundary.absolute(seconds=origin + (1.0 + _AFTER) * end_s)
        whole = rrb.TimeRange(start=start, end=end)
        axis = rrb.TimeAxis(view_range=whole)
        contents = list(panel.contents)
        match panel.kind:
            case "lines":
                legend = rrb.PlotLegend(visible=panel.legend)
                y = None if panel.reach is None else rrb.ScalarAxis(range=(-panel.reach, panel.reach))
                return rrb.TimeSeriesView(
                    name=panel.title, contents=contents, axis_x=axis, axis_y=y, plot_legend=legend
                )
            case "lanes":
                return rrb.StateTimelineView(name=panel.title, contents=contents, time_view=axis)
            case "texts":
                return rrb.TextLogView(name=panel.title, contents=contents, columns=_text_columns())
            case "note":
                return rrb.TextDocumentView(name=panel.title, contents=contents, titlebar=False)

    def part(item: Panel | Stack, margin: float) -> Any:
        if isinstance(item, Panel):
            return view(item, margin)
        parts = [part(inner, max(margin, item.margin)) for inner in item.parts]
        shares = [inner.share for inner in item.parts]
        name = item.title or None
        match item.arrange:
            case "rows":
                return rrb.Vertical(*parts, row_shares=shares, name=name)
            case "columns":
                return rrb.Horizontal(*parts, column_shares=shares, name=name)
            case "grid":
                return rrb.Grid(*parts, name=name)

    return rrb.Blueprint(
        rrb.Tabs(*(part(tab, tab.margin) for tab in plan.tabs), active_tab=0),
        rrb.TimePanel(timeline=timeline, play_state="following" if live else "paused", state="collapsed"),
        auto_layout=False,
        auto_views=False,
        collapse_panels=True,
    )


def read_columns(rrd: Path, entity: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return `time_s (n,)` and `values (n, k)` of an entity with scalars or measurements, in the order of sending.

    Raises KeyError where the file has no such entity.
    """
    times, blocks = [], []
    for batch in _record_batches(rrd, entity):
        for name in ("Scalars:scalars", "Measurements:values"):
            if name in batch.schema.names and TIMELINE in batch.schema.names:
                nanoseconds = batch.column(TIMELINE).cast(pa.int64()).to_numpy()
                values = batch.column(name).flatten().to_numpy(zero_copy_only=False)
                times.append(nanoseconds / 1e9)
                blocks.append(values.reshape(len(nanoseconds), -1))
    if not times:
        raise KeyError(f"{rrd} holds no values of {entity}")
    return np.concatenate(times), np.concatenate(blocks)


def read_words(rrd: Path, entity: str) -> list[tuple[float, str | None]]:
    """Return time in s and text of each log line, or of each new state of a lane, of `entity`."""
    rows: list[tuple[float, str | None]] = []
    for batch in _record_batches(rrd, entity):
        for name in ("TextLog:text", "StateChange:state"):
            if name in batch.schema.names and TIMELINE in batch.schema.names:
                nanoseconds = batch.column(TIMELINE).cast(pa.int64()).to_pylist()
                words = [None if not cell else cell[0] for cell in batch.column(name).to_pylist()]
                if name == "TextLog:text":  # Without the time at its beginning.
                    words = [None if word is None else word.partition(_AFTER_TIME)[2] for word in words]
                rows += [(stamp / 1e9, word) for stamp, word in zip(nanoseconds, words, strict=True)]
    return rows


def _record_batches(rrd: Path, entity: str) -> list[Any]:
    # Read without the store: a file of a killed writer has no index, but all rows up to its last flush.
    with utf8_path(rrd) as path:
        chunks = RrdReader(path).stream().filter(content=entity, has_timeline=TIMELINE).to_chunks()
        return [chunk.to_record_batch() for chunk in chunks]


class Camera:
    """Driver of a running viewer at `url` that takes screenshots of a recording."""

    def __init__(self, url: str) -> None:
        self._client = ViewerClient.connect(url)

    def open(self, rrd: Path, tab: str | None = None) -> None:
        """Load a recording and show `tab` (by its title, else the first); raise KeyError if there is none."""
        self._client.open(str(rrd.absolute()))
        if tab is not None:
            layout = self._client.get_blueprint(of="recording").blueprint
            containers = {name: part["ContainerBlueprint"] for name, part in layout.items() if "/container/" in name}
            tabs = next(part for part in containers.values() if part["container_kind"] == "Tabs")
            titles = {containers["/" + name].get("display_name"): name for name in tabs["contents"]}
            if tab not in titles:
                raise KeyError(f"the review has no tab {tab!r}; there are {', '.join(map(str, titles))}")
            tabs["active_tab"] = titles[tab]
            self._client.set_blueprint(layout, of="recording")

    def picture(self, timeout_s: float) -> tuple[bytes, bool]:
        """Return a PNG of the whole viewer, and True if it had settled; coinciding curves may never do so."""
        deadline = time.monotonic() + timeout_s
        last, equal = b"", 0
        while equal < _SETTLED and time.monotonic() < deadline:
            now = self._client.take_screenshot()
            equal = equal + 1 if now == last else 1
            last = now
        return last, equal == _SETTLED

    def complaints(self) -> list[str]:
        """Return the reports of the visible views: `view: severity: summary`."""
        views = self._client.get_state().views
        return [f"{view.name}: {report.severity}: {report.summary}" for view in views for report in view.reports]
