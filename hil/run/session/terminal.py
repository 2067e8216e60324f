"""Output in the terminal: progress with ETA and temperatures, tables of errors, advice after a run."""

from __future__ import annotations

import math
import os
import re
import shlex
import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from hil.diagnosis import Reply
    from hil.run.engine import Outcome, Status
    from hil.run.session.run import RunResult
    from hil.tracking import Comparison, ErrorTable

LINE_EVERY_S = 5.0
"""Interval of progress lines where the output is no terminal, s."""
PLAIN_WIDTH = 140
"""Characters of a line where the output is no terminal: the widest table of errors has some 130."""

_SHOWN = ("T_heater", "T_pm1", "T_radiator", "T_tank", "T_ambient")
"""Temperatures in the live line; for a rig without any of them, as many of its first ones."""

_OBEYED = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
"""Characters that a terminal obeys, without line feed and tab."""


def console(*, stderr: bool = False, quiet: bool = False) -> Console:
    """Return a console; where the output is no terminal, its lines have `PLAIN_WIDTH` characters."""
    plain = _SafeConsole(stderr=stderr, quiet=quiet, highlight=False, markup=False)
    if plain.is_terminal:
        return plain
    return _SafeConsole(stderr=stderr, quiet=quiet, highlight=False, markup=False, width=PLAIN_WIDTH)


class _SafeConsole(Console):
    """Console that shows control characters in what it prints as escapes: text of a file may hold what a terminal
    obeys. Text in square brackets is text and no markup, since paths, names and reasons may have it."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterator[Segment]:
        """Return the segments of `renderable`; the console's own control codes stay."""
        for segment in super().render(renderable, options):
            if segment.control or segment.text.isprintable():
                yield segment
            else:
                yield Segment(_OBEYED.sub(lambda found: repr(found[0])[1:-1], segment.text), segment.style)


def invocation() -> str:
    """Return the command that calls `hil` from this shell: its name where that is on the path, else its file."""
    if shutil.which("hil") is not None:
        return "hil"
    place = Path(sys.argv[0])
    return os.path.relpath(place) if place.name == "hil" else "python -m hil"


def hours(seconds: float) -> str:
    """Return a time in seconds as text: `37 h 05 min`, or `95 s` for a short one."""
    if seconds < 600:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes // 60} h {minutes % 60:02d} min"


def error_table(errors: ErrorTable, title: str) -> Table:
    """Return the RMSE per sensor in K, one column a twin, with the sensor's noise."""
    table = Table(title=title, title_justify="left", caption_justify="left")
    table.add_column("sensor", no_wrap=True)
    for column in errors.columns:
        table.add_column(column, justify="right", min_width=6)
    if errors.noise_K:
        table.add_column("noise", justify="right", style="dim")
    for sensor, cells in errors.rows.items():
        noise = [f"{errors.noise_K[sensor]:.3f}"] if errors.noise_K else []
        table.add_row(sensor, *(f"{cell:.3f}" if math.isfinite(cell) else "-" for cell in cells), *noise)
    table.caption = (
        "static: as commissioned, never updated. ahead: predicted by the parameters of earlier windows, before the "
        "data came. fitted: the same window after its calibration."
    )
    return table


def band_table(comparison: Comparison) -> Table:
    """Return the half width of the twins' 90 % bands in K, and the share of readings within them."""
    table = Table(title="90 % bands: ± K (share held)", title_justify="left", caption_justify="left")
    table.add_column("sensor", no_wrap=True)
    for twin in comparison.bands:
        table.add_column(twin, justify="right")
    for sensor in comparison.errors.rows:
        cells = (comparison.bands[twin][sensor] for twin in comparison.bands)
        table.add_row(sensor, *(f"{half:.3f} ({inside:.0%})" for half, inside in cells))
    table.caption = "predicted for ten minutes from the twin's own errors in the two hours before."
    return table


def parameter_table(comparison: Comparison) -> Table:
    """Return the parameters of each calibrator at the end, with 90 % intervals, in their units."""
    table = Table(title="Parameters at the end, ± 90 %", title_justify="left", caption_justify="left")
    table.add_column("parameter", no_wrap=True)
    for name in comparison.parameters:
        table.add_column(name, justify="right")
    table.add_column("unit")
    from hil.tracking import parameter_cell

    names = dict.fromkeys(name for values in comparison.parameters.values() for name in values)
    for name in names:
        cells = (comparison.parameters[calibrator].get(name) for calibrator in comparison.parameters)
        table.add_row(name, *(parameter_cell(cell) for cell in cells), comparison.units.get(name, ""))
    table.caption = "held: not identifiable from the record, or a gate is closed."
    return table


def show_comparison(to: Console, comparison: Comparison, title: str) -> None:
    """Print errors, bands and parameters of the twins, and name those that are no better than the static twin."""
    to.print(error_table(comparison.errors, title))
    if comparison.bands:
        to.print(band_table(comparison))
    if comparison.parameters:
        to.print(parameter_table(comparison))
    for sentence in comparison.outdone.values():
        to.print(sentence, markup=False, soft_wrap=True)


class ProgressBar:
    """Progress bar from `begun` to `total` with ETA; plain lines where the output is no terminal.

    `what` names the work. Work that ends early sets `cut`, so that the bar is not completed.
    """

    def __init__(self, what: str, total: float, *, quiet: bool = False, begun: float = 0.0) -> None:
        self.cut = False
        self._begun = begun
        self._console = console(stderr=True, quiet=quiet)
        self._what = what
        self._progress = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=30),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeElapsedColumn(),
            TextColumn("ETA"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[note]}", style="dim", markup=False),
            console=self._console,
            transient=False,
            disable=quiet or not self._console.is_terminal,
        )
        self._task: TaskID = self._progress.add_task(what, total=total, completed=int(begun), note="")
        self._total = total
        self._seen = self._last_line = time.monotonic()
        self._done, self._spent = begun, 0.0
        self._lines = not self._console.is_terminal

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        if kind is None and not self.cut:
            self._progress.update(self._task, completed=self._total)
        self._progress.stop()

    def update(self, done: float, note: str = "") -> None:
        """Show that `done` of the total are done, with `note` beside the bar."""
        self._progress.update(self._task, completed=done, note=note)
        now = time.monotonic()
        if done > self._done:  # a thermal restore or a wait has no share in the ETA
            self._spent += now - self._seen
        self._done, self._seen = done, now
        if not self._lines or now - self._last_line < LINE_EVERY_S or (done <= self._begun and not note):
            return
        self._last_line = now
        eta = ""
        if done > self._begun:
            eta = f", ETA {self._spent * (self._total - done) / (done - self._begun):.0f} s"
        self._console.print(f"{self._what}: {100 * done / self._total:3.0f} %{eta}  {note}", markup=False)

    def print_line(self, text: str) -> None:
        """Print a line above the bar."""
        self._console.print(text, markup=False, soft_wrap=True)  # a path on two lines cannot be pasted


class RunProgress:
    """Progress of a run: profile time, ETA, a live line of temperatures."""

    def __init__(self, *, quiet: bool = False) -> None:
        self._quiet = quiet
        self._steps: ProgressBar | None = None
        self._console = console(stderr=True, quiet=quiet)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        if self._steps is not None:
            self._steps.__exit__(kind, error, tb)

    def announce(self, text: str) -> None:
        """Print one line about the work in progress."""
        if self._steps is not None:
            self._steps.print_line(text)
        else:
            self._console.print(text, markup=False, soft_wrap=True)

    def update(self, status: Status) -> None:
        """Show the status of the engine; it calls this a few times a second."""
        if self._steps is None:
            self._steps = ProgressBar("replaying", status.duration_s, quiet=self._quiet, begun=status.profile_s)
            self._steps.__enter__()
        every = [name for name in status.values if name.startswith("T_")]
        shown = [name for name in every if name in _SHOWN] or every[: len(_SHOWN)]
        temperatures = "  ".join(f"{name.removeprefix('T_')} {status.values[name]:.1f}" for name in shown)
        temperatures += " °C" if shown else ""
        power = status.values.get("heater_power")
        heater = f"{power:.0f} W  " if power is not None else ""
        state = "" if status.state == "running" else f"{status.state.upper()}  "
        if status.state == "restoring":
            self._steps.update(status.profile_s, f"RESTORING  {status.reason}")
            return
        self._steps.update(status.profile_s, f"{state}{hours(status.profile_s)}  {heater}{temperatures}")

    def show_result(self, result: RunResult) -> None:
        """Print the tables of errors, the end of the run, and its folder."""
        out = console()
        outcome = result.outcome
        out.print()
        if result.comparison is not None:
            show_comparison(out, result.comparison, f"RMSE in K over {hours(result.duration_s)}")
        gaps = interruption_summary(result.folder.read_manifest())
        out.print(
            f"{outcome.verdict}: {hours(result.duration_s)} of rig time in {result.wall_s:.1f} s{gaps}"
            + (f", {outcome.overruns} late ticks" if outcome.overruns else "")
            + (f": {outcome.reason}" if outcome.reason else ""),
            highlight=False,
        )
        for problem in [*outcome.problems, *outcome.deviations]:
            out.print(f"  {problem}", markup=False)
        if outcome.guardian:
            out.print(f"the guardian acted: {outcome.guardian}", markup=False)
        if result.gates is not None:
            out.print(result.gates, soft_wrap=True, markup=False)
        if result.adoption is not None:
            out.print(result.adoption.sentence, soft_wrap=True, markup=False)
        path = result.folder.path
        review = f"{invocation()} review {shlex.quote(str(path))}"
        out.print(f"run folder: {path}", soft_wrap=True)
        out.print(f"look at it: {review}", soft_wrap=True)
        if not result.viewed:
            out.print(f"no display here; a picture: {review} --screenshot review.png", soft_wrap=True)
        if result.diagnosis is not None:
            show_diagnosis(out, result.diagnosis, result.folder.review)
        for line in closing_advice(outcome, path):
            out.print(line, style="bold red" if line.startswith(NOT_SAFE) else "", soft_wrap=True, markup=False)


NOT_SAFE = "The rig was NOT confirmed safe"
"""Beginning of the advice after a run whose outputs are not confirmed to be safe."""


def closing_advice(outcome: Outcome, path: Path) -> list[str]:
    """Return advice after a run that did not go to its end, a line each.

    Where the rig may still heat, the last line says so, and `hil resume` is advised for afterwards only.
    """
    is_unsafe = bool(outcome.ticks) and (bool(outcome.away) or not outcome.safe)
    lines = []
    if outcome.status != "done" and outcome.ticks:
        when = "when its cause is gone, go on with it" if outcome.status == "faulted" else "go on with it"
        when = "once somebody has seen at the rig that nothing heats, and the cause is gone" if is_unsafe else when
        lines.append(f"{when}: {invocation()} resume {shlex.quote(str(path))}")
    if is_unsafe:
        lines.append(f"{NOT_SAFE}: go to the rig now, and switch the heater off there if it is on.")
    return lines


def show_diagnosis(out: Console, reply: Reply, review: Path) -> None:
    """Print the verdict of the diagnosis of a run, its errors on held-out segments, and the paths of page and
    review."""
    from hil.diagnosis import errors_of, held_out

    out.print()
    if reply.found is None:
        out.print(f"no diagnosis: {reply.problem}", soft_wrap=True, markup=False)
    else:
        sentence = reply.found.sentence.rstrip(".")
        out.print(Text.assemble((reply.found.verdict, "bold"), f": {sentence}."), soft_wrap=True)
    if reply.document is not None:
        out.print(held_out(reply.document), style="italic", soft_wrap=True, markup=False)
        out.print(errors_of(reply.document))
    if reply.revision is not None:
        out.print(f"revision of the twin: {shlex.quote(str(reply.revision))}", soft_wrap=True, markup=False)
    if reply.page is not None:
        out.print(f"diagnosis with pictures: {shlex.quote(str(reply.page))}", soft_wrap=True, markup=False)
    if review.is_file():
        out.print(f"run in Rerun: {shlex.quote(str(review))}", soft_wrap=True, markup=False)


def interruption_summary(manifest: dict[str, Any]) -> str:
    """Return the share of gaps and thermal restores in a run's time, in brackets; "" for an uninterrupted run."""
    segments = manifest.get("segments", [])
    if not segments:
        return ""
    times = "once" if len(segments) == 1 else f"{len(segments)} times"
    gap_s = sum(segment.get("gap_s", 0.0) for segment in segments)
    restore_s = sum(segment.get("restore_s", segment.get("soaked_s", 0.0)) for segment in segments)
    return f" (cut {times}: {hours(gap_s)} without a row, {hours(restore_s)} of thermal restore)"
