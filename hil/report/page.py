"""Report of a run: one self-contained HTML file, made from the journal and `run.json`."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.signals import Quality
from hil.files import Html, document, element, estimate_text, joined, replacing, table
from hil.journal import JournalReader, JournalSamples, TwinOutput
from hil.report.about import label_section, note_section, quality_section
from hil.report.alarm_table import alarm_section
from hil.report.figures import RunCurves, pictures, zoom_plots
from hil.report.limit_lines import limit_lines
from hil.report.plot_script import SCRIPT
from hil.report.statistics import (
    NONE,
    SETTLED_AFTER_S,
    TimeUnit,
    number,
    set_against_read,
    signal_statistics,
    time_unit,
)
from hil.report.verdict import verdict_section
from hil.report.zoom import PLOT_STYLE
from hil.run_folder import RunFolder, labels_of, left_safe, read_diagnosis_verdict, read_notes, read_verdict
from hil.tracking import Proposed, accepted, closed_gates, parameter_cell, window_kind

LEVELS = ("ERROR", "WARN")
"""Levels of events that are coloured."""
_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 68rem; margin: 2rem auto; padding: 0 1rem; color: #22262b }
h1 { font-size: 1.5rem } h2 { font-size: 1.15rem; margin-top: 2rem } img { width: 100% }
table { border-collapse: collapse; display: block; width: fit-content; max-width: 100%; overflow-x: auto }
td, th { padding: .25rem .8rem; border-bottom: 1px solid #d8dce0; text-align: right }
td:first-child, th:first-child { text-align: left; white-space: nowrap } td.text { text-align: left }
.ERROR { color: #b3261e } .WARN { color: #9a6700 } .PASS { color: #1b6e3c }
table.verdict td, table.verdict th, table.about td, table.about th { text-align: left; vertical-align: top }
table.about td:last-child, table.prose td:last-child { overflow-wrap: anywhere }
table.verdict td.text { overflow-wrap: anywhere; min-width: 7rem } table.verdict td:last-child { min-width: 16rem }
table.prose td, table.prose th { text-align: left; vertical-align: top }
table.segments td:nth-child(n+6), table.segments th:nth-child(n+6) { text-align: left; overflow-wrap: anywhere }
table.segments td:nth-child(n+6) { min-width: 8rem }
table.notes td:nth-child(2), table.notes th:nth-child(2) { white-space: nowrap; text-align: right }
table.notes td:last-child { white-space: pre-line }
p.note { color: #5b636b; font-size: .9rem }
"""


def measured_sensors(reader: JournalReader, samples: JournalSamples) -> dict[str, NDArray[np.float64]]:
    """Return each twin sensor's measured value in degC, shape (n,): mean of its good columns, NaN if none is good."""
    index = {signal.column: position for position, signal in enumerate(reader.header.signals)}
    good = np.where(samples.quality == Quality.GOOD, samples.values, np.nan)
    found = {}
    for sensor, columns in reader.header.twin_sensors.items():
        block = good[:, [index[column] for column in columns]]
        count = np.isfinite(block).sum(axis=1)
        total = np.nansum(block, axis=1)
        found[sensor] = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return found


def write_report(folder: RunFolder, missing: Mapping[str, str] | None = None) -> None:
    """Write `report.html` of a finished run; raise JournalError or RunFolderError if there is none.

    `missing` are the files that could not be made, with reasons; those of `run.json` by default.
    """
    manifest = folder.read_manifest() | ({} if missing is None else {"missing": dict(missing)})
    notes, judged = read_notes(folder), read_verdict(folder)
    reader = JournalReader(folder.journal)
    try:
        samples = reader.samples()
        wall_s = reader.timing()[:, 1] if notes else np.zeros(0)
        unit = time_unit(float(np.ptp(samples.time_s)) if len(samples.tick) else 0.0)
        body = [
            verdict_section(judged),
            _summary(manifest),
            label_section(labels_of(manifest, notes), manifest, read_diagnosis_verdict(folder)),
            note_section(notes, wall_s, samples.time_s if notes else wall_s, unit),
            _segments(manifest, unit),
            _error_table(manifest),
            _band_table(manifest),
            _parameter_table(manifest),
            _pictures(reader, samples, unit, judged),
            quality_section(reader.header, samples),
            _signals(reader, samples),
            _calibrations(reader),
            _gates(reader, unit),
            _timing(manifest, reader),
            alarm_section(folder, unit),
            _events(reader, unit),
            _provenance(manifest),
        ]
    finally:
        reader.close()
    page = document(folder.path.name, _STYLE + PLOT_STYLE, [element("h1", folder.path.name), *body], SCRIPT)
    with replacing(folder.report) as temporary:
        temporary.write_text(page, encoding="utf-8")


def load_libraries() -> None:
    """Import the libraries of the pictures, which takes a second that a command may spend on waiting."""
    import_module("matplotlib.backends.backend_agg")
    import_module("matplotlib.image")


def _part(title: str, *content: Html) -> Html:
    return joined([element("h2", title), *content])


def _note(text: str) -> Html:
    return element("p", text, class_="note")


def _summary(manifest: dict[str, Any]) -> Html:
    reason = f": {manifest['reason']}" if manifest["reason"] else ""
    safe = "The heater was left at its safe value, read back." if left_safe(manifest) else "NOT confirmed safe."
    if manifest.get("untouched") and not left_safe(manifest):
        safe = "It had written nothing to the rig."
    # A report is made while nobody runs the run: one that is still running then was interrupted.
    status = "interrupted" if manifest["exit_status"] == "running" else manifest["exit_status"]
    found = [*manifest.get("problems", []), *manifest.get("deviations", [])]
    problems = (element("p", problem, class_="WARN") for problem in found)
    return joined([element("p", element("b", status), f"{reason}. {safe}"), *problems])


def _segments(manifest: dict[str, Any], unit: TimeUnit) -> Html:
    segments = manifest.get("segments")
    if not segments:
        return joined([])
    rows = [
        [
            str(item["number"]),
            *(unit.of(item.get(key)) for key in ("from_s", "gap_s")),
            unit.of(item.get("restore_s", item.get("soaked_s"))),  # the latter before version 0.2
            unit.of(item.get("profile_s")),
            item["why"],
            " ".join(filter(None, (item["exit_status"], item.get("reason", "")))),
        ]
        for item in segments
    ]
    times = [f"{what} / {unit.symbol}" for what in ("from", "gap before", "thermal restore", "profile")]
    head = ["segment", *times, "why", "ended"]
    note = (
        "The run was interrupted and resumed. Curves and errors leave out the gaps. The profile's "
        "clock stood during the thermal restore; the samples of that time are in the record."
    )
    return _part("Segments", table(head, rows, class_="segments"), _note(note))


def _error_table(manifest: dict[str, Any]) -> Html:
    errors = manifest.get("errors_K")
    if not errors:
        return joined([])
    rows = [
        [sensor, *(number(cell, ".3f") for cell in (*cells, errors["noise_K"].get(sensor)))]
        for sensor, cells in errors["rows"].items()
    ]
    note = (
        "static: as commissioned. ahead: predicted with the parameters of earlier windows, before the data came. "
        "fitted: the same window after its calibration."
    )
    head = ["sensor", *errors["columns"], "noise"]
    return _part("RMSE in K", table(head, rows), _note(note))


def _band_table(manifest: dict[str, Any]) -> Html:
    bands = manifest.get("bands")
    if not bands:
        return joined([])
    sensors = next(iter(bands.values()))
    rows = [[sensor, *(_band(*bands[twin][sensor]) for twin in bands)] for sensor in sensors]
    note = "Predicted for ten minutes from the twin's own errors in the two hours before; in brackets the coverage."
    return _part("90 % bands, ± K", table(["sensor", *bands], rows), _note(note))


def _band(half: float | None, inside: float | None) -> str:
    return NONE if number(half) == NONE else f"{number(half, '.3f')} ({number(inside, '.0%')})"


def _parameter_table(manifest: dict[str, Any]) -> Html:
    parameters = manifest.get("parameters")
    if not parameters:
        return joined([])
    names = dict.fromkeys(name for values in parameters.values() for name in values)
    units = manifest.get("parameter_units") or {}
    rows = [
        [name, *(parameter_cell(values.get(name)) for values in parameters.values()), units.get(name, "")]
        for name in names
    ]
    note = "held: not identifiable from the record, or a gate is closed; the value is older than the end."
    adopted = manifest.get("adoption")
    became = [element("p", adopted["sentence"])] if adopted else []
    return _part("Parameters at the end, ± 90 %", table(["parameter", *parameters, "unit"], rows), _note(note), *became)


def _gates(reader: JournalReader, unit: TimeUnit) -> Html:
    proposals = [Proposed(row.calibrator, row.time_s, row.document) for row in reader.proposals()]
    if not proposals:
        return joined([])
    rows = [
        [name, estimate_text(a.value, a.half_width), f"{a.count}", unit.of(a.first_s), unit.of(a.last_s)]
        for name, a in accepted(proposals).items()
    ]
    head = ["parameter", "accepted last", "in a row", f"since / {unit.symbol}", f"last / {unit.symbol}"]
    shown = table(head, rows) if rows else _note("None.")
    return _part("Parameters accepted by the network's gates", shown, _note(closed_gates(proposals)))


def _pictures(reader: JournalReader, samples: JournalSamples, unit: TimeUnit, judged: dict[str, Any]) -> Html:
    cuts = np.searchsorted(samples.tick, [row.tick for row in reader.segments()])
    measured = measured_sensors(reader, samples)
    twins = {name: _at_ticks(reader.twin_outputs(name), samples) for name in reader.header.twin_names}
    twins = {name: values for name, values in twins.items() if np.isfinite(values).any()}
    limits = limit_lines(judged, reader.states(), (samples.tick, samples.time_s), reader.header.period_s)
    drawn = RunCurves(reader.header, samples, measured if twins else {}, twins, cuts, unit, limits)
    return joined([pictures(drawn), zoom_plots(drawn)])


def _at_ticks(output: TwinOutput, samples: JournalSamples) -> NDArray[np.float64]:
    """Return a twin's predictions (n, m) at the ticks of `samples`, NaN for those after the tick."""
    found = np.full((len(samples.tick), output.values.shape[1]), np.nan)
    known = np.isin(output.tick, samples.tick)
    found[np.searchsorted(samples.tick, output.tick[known])] = output.values[known]
    return found


def _signals(reader: JournalReader, samples: JournalSamples) -> Html:
    rows = [
        [s.name, s.unit, number(s.least), number(s.mean), number(s.greatest), f"{s.good:.1%}"]
        for s in signal_statistics(reader.header, samples)
    ]
    head = ["signal", "unit", "min", "mean", "max", "good"]
    body = [
        _part(
            "Signals in numbers", table(head, rows), _note("Statistics of all good values; - for a signal without any.")
        )
    ]
    pairs = [
        [p.name, p.unit, *map(number, (p.set_mean, p.read_mean, p.settled_difference, p.settled_greatest))]
        for p in set_against_read(reader.header, samples)
    ]
    if pairs:
        head = ["set-point", "unit", "set, mean", "read, mean", "read - set, mean", "read - set, greatest"]
        note = f"Differences on ticks whose set-point had been constant for {SETTLED_AFTER_S:g} s."
        body.append(_part("Set against read", table(head, pairs), _note(note)))
    return joined(body)


def _calibrations(reader: JournalReader) -> Html:
    kinds: dict[str, dict[str, int]] = {}
    for row in reader.calibrations():
        kind = window_kind(row.document)
        counts = kinds.setdefault(row.calibrator, {})
        counts[kind] = counts.get(kind, 0) + 1
        counts["flagged calibrated"] = counts.get("flagged calibrated", 0) + bool(row.document.get("calibrated"))
    if not kinds:
        return joined([])
    rows = [[name, ", ".join(f"{count} {kind}" for kind, count in counts.items())] for name, counts in kinds.items()]
    return _part("Windows", table(["calibrator", "windows"], rows))


def _timing(manifest: dict[str, Any], reader: JournalReader) -> Html:
    latency = reader.latencies() * 1e3
    if not len(latency):
        return joined([])
    p50, p99 = np.percentile(latency, [50, 99])
    header = reader.header
    factor = len(latency) * header.period_s / reader.wall_s()
    rows = [
        ["ticks", f"{len(latency)}"],
        ["work in a tick, median / 99 % / longest", f"{p50:.2f} / {p99:.2f} / {latency.max():.2f} ms"],
        ["ticks that began late", f"{manifest.get('overruns', 0)}"],
        ["restarts of the rig's program", f"{manifest.get('rig_restarts', 0)}"],
        ["times real time", number(factor, ".1f")],
    ]
    return _part("Timing", table(["", ""], rows))


def _events(reader: JournalReader, unit: TimeUnit) -> Html:
    lines = (
        element(
            "tr",
            element("td", f"{unit.of(row.time_s)} {unit.symbol}"),
            element("td", row.level),
            element("td", row.text, class_="text"),
            class_=row.level if row.level in LEVELS else "",
        )
        for row in reader.events()
    )
    return _part("Events", element("table", *lines, class_="prose"))


def _provenance(manifest: dict[str, Any]) -> Html:
    rows = [["run", manifest["uid"]], ["started", manifest["started"]], ["host", manifest["host"]]]
    rows += [[name, f"{item['path']}  sha256 {item['sha256'][:16]}"] for name, item in manifest["files"].items()]
    rows += [[name, version] for name, version in manifest["versions"].items()]
    rows += [[name, _setting(value)] for name, value in manifest["settings"].items()]
    return _part("Provenance", table(["", ""], rows, class_="prose"))


def _setting(value: Any) -> str:
    """Return the value of a setting as people read it."""
    if value is None or value in ([], {}, ""):
        return NONE
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, dict):
        return "; ".join(f"{name}: {part}" for name, part in value.items())
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)
