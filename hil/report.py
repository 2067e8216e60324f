"""The report of a run: one HTML file that needs nothing else, made from the journal and `run.json`."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.points import Quality
from hil.adoption import accepted, closed_gates
from hil.atomic import replacing
from hil.html_text import Html, document, element, image, joined, table
from hil.journal import JournalReader
from hil.journal_rows import Samples
from hil.run_folder import RunFolder
from hil.tracking import Proposed, parameter_cell, window_kind

COLOURS = {"measured": "#30343a", "static": "#e07b1f"}
LEVELS = ("ERROR", "WARN")
"""Levels of events that are coloured."""
RESIDUALS = "Residual, means of five minutes"
_TRACKED = ("#1f77c9", "#2a9d6f", "#8a4fbf", "#b03a5b")
_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 68rem; margin: 2rem auto; padding: 0 1rem; color: #22262b }
h1 { font-size: 1.5rem } h2 { font-size: 1.15rem; margin-top: 2rem } img { width: 100% }
table { border-collapse: collapse }
td, th { padding: .25rem .8rem; border-bottom: 1px solid #d8dce0; text-align: right }
td:first-child, th:first-child, td.text { text-align: left } .ERROR { color: #b3261e } .WARN { color: #9a6700 }
p.note { color: #5b636b; font-size: .9rem }
"""


def measured_sensors(reader: JournalReader, samples: Samples) -> dict[str, NDArray[np.float64]]:
    """Each twin sensor's measured value in degC, shape (n,): mean of its good columns, NaN where none is good."""
    index = {signal.column: position for position, signal in enumerate(reader.header.signals)}
    good = np.where(samples.quality == Quality.GOOD, samples.values, np.nan)
    found = {}
    for sensor, columns in reader.header.twin_sensors.items():
        block = good[:, [index[column] for column in columns]]
        count = np.isfinite(block).sum(axis=1)
        total = np.nansum(block, axis=1)
        found[sensor] = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return found


def write_report(folder: RunFolder) -> None:
    """Write `report.html` of a finished run; raises JournalError or RunFolderError where there is none."""
    manifest = folder.read_manifest()
    reader = JournalReader(folder.journal)
    try:
        samples = reader.samples()
        twins = {name: reader.twin_outputs(name).values for name in reader.header.twin_names}
        twins = {name: values for name, values in twins.items() if len(values) == len(samples.tick)}
        body = [
            _summary(manifest),
            _segments(manifest),
            _error_table(manifest),
            _band_table(manifest),
            _parameter_table(manifest),
            _pictures(reader, samples, twins),
            _calibrations(reader),
            _gates(reader),
            _timing(manifest, reader),
            _events(reader),
            _provenance(manifest),
        ]
    finally:
        reader.close()
    page = document(folder.path.name, _STYLE, [element("h1", folder.path.name), *body])
    with replacing(folder.report) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _part(title: str, *content: Html) -> Html:
    return joined([element("h2", title), *content])


def _note(text: str) -> Html:
    return element("p", text, class_="note")


def _summary(manifest: dict[str, Any]) -> Html:
    reason = f": {manifest['reason']}" if manifest["reason"] else ""
    is_safe = manifest.get("safe") and not manifest.get("away")
    safe = "The heater was left at its safe value, read back." if is_safe else "NOT confirmed safe."
    problems = (element("p", problem, class_="WARN") for problem in manifest.get("problems", []))
    return joined([element("p", element("b", manifest["exit_status"]), f"{reason}. {safe}"), *problems])


def _segments(manifest: dict[str, Any]) -> Html:
    segments = manifest.get("segments")
    if not segments:
        return joined([])
    rows = [
        [
            str(item["number"]),
            f"{item['from_s'] / 3600:.3f}",
            f"{item['gap_s'] / 60:.1f}",
            f"{item.get('soaked_s', float('nan')) / 60:.1f}",
            f"{item['profile_s'] / 3600:.3f}",
            item["why"],
            " ".join(filter(None, (item["exit_status"], item.get("reason", "")))),
        ]
        for item in segments
    ]
    head = ["segment", "from / h", "gap before / min", "soaked / min", "profile / h", "why", "ended"]
    note = (
        "The run was cut and resumed. Nothing is known of the gaps: curves and errors leave them out. The profile's "
        "clock stood while the rig was led back to where it was; the samples of that time are in the record."
    )
    return _part("Segments", table(head, rows), _note(note))


def _error_table(manifest: dict[str, Any]) -> Html:
    errors = manifest.get("errors_K")
    if not errors:
        return joined([])
    rows = [
        [sensor, *(f"{cell:.3f}" for cell in cells), f"{errors['noise_K'].get(sensor, float('nan')):.3f}"]
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
    rows = [[sensor, *("{:.3f} ({:.0%})".format(*bands[twin][sensor]) for twin in bands)] for sensor in sensors]
    note = "Foretold for ten minutes from the twin's own misses in the two hours before; in brackets the share held."
    return _part("90 % bands, ± K", table(["sensor", *bands], rows), _note(note))


def _parameter_table(manifest: dict[str, Any]) -> Html:
    parameters = manifest.get("parameters")
    if not parameters:
        return joined([])
    names = dict.fromkeys(name for values in parameters.values() for name in values)
    rows = [[name, *(parameter_cell(values.get(name)) for values in parameters.values())] for name in names]
    note = "held: the record does not tell it, or a gate is closed; the value is older than the end."
    adopted = manifest.get("adoption")
    became = [element("p", adopted["sentence"])] if adopted else []
    return _part("Parameters at the end, ± 90 %", table(["parameter", *parameters], rows), _note(note), *became)


def _gates(reader: JournalReader) -> Html:
    proposals = [Proposed(row.calibrator, row.time_s, row.document) for row in reader.proposals()]
    if not proposals:
        return joined([])
    rows = [
        [name, f"{a.value:.4g} ± {a.half_width:.2g}", f"{a.count}", f"{a.first_s / 3600:.2f}", f"{a.last_s / 3600:.2f}"]
        for name, a in accepted(proposals).items()
    ]
    head = ["parameter", "accepted last", "in a row", "since / h", "last / h"]
    return _part("What the network's gates let through", table(head, rows), _note(closed_gates(proposals)))


def _pictures(reader: JournalReader, samples: Samples, twins: dict[str, NDArray[np.float64]]) -> Html:
    if not reader.header.twin_sensors or len(samples.tick) < 2:
        return joined([])
    import matplotlib

    with matplotlib.rc_context({"text.parse_math": False}):  # a $ in somebody's name is a $
        return _drawn(reader, samples, twins)


def _drawn(reader: JournalReader, samples: Samples, twins: dict[str, NDArray[np.float64]]) -> Html:
    from matplotlib.figure import Figure

    cuts = np.searchsorted(samples.tick, [row.tick for row in reader.segments()])
    measured = {sensor: _broken(values, cuts) for sensor, values in measured_sensors(reader, samples).items()}
    twins = {name: _broken(values, cuts) for name, values in twins.items()}
    hours = samples.time_s / 3600
    step = max(1, len(hours) // 4000)
    figure = Figure(figsize=(11, 2.6 * len(measured) + 2.2), layout="constrained")
    rows = figure.subplots(len(measured) + 1, 1, sharex=True)
    for position, (sensor, values) in enumerate(measured.items()):
        axes = rows[position]
        axes.plot(hours[::step], values[::step], color=COLOURS["measured"], linewidth=0.8, label="measured")
        for number, (name, outputs) in enumerate(twins.items()):
            colour = COLOURS.get(name, _TRACKED[(number - 1) % len(_TRACKED)])
            axes.plot(hours[::step], outputs[::step, position], color=colour, linewidth=1.0, label=name)
        axes.set_ylabel(f"{sensor.removesuffix('_C')} / °C")
        axes.grid(alpha=0.25)
    figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper right", ncols=6, frameon=False)
    power = next((i for i, s in enumerate(reader.header.signals) if s.role == "heater_power"), None)
    if power is not None:
        heat = _broken(samples.values[:, power], cuts)
        rows[-1].plot(hours[::step], heat[::step], color="#a8322a", linewidth=0.8)
        rows[-1].set_ylabel("heater / W")
    rows[-1].set_xlabel("time / h")
    rows[-1].grid(alpha=0.25)
    residual = _residuals(hours, measured, twins)
    return joined([_part("Measured against twin", _embedded(figure)), _part(RESIDUALS, residual)])


def _broken(values: NDArray[np.float64], cuts: NDArray[np.int64]) -> NDArray[np.float64]:
    """`values` with the curve broken before each of `cuts`, for longer than what a picture skips."""
    broken = values.copy()
    step = max(1, len(values) // 4000)
    for cut in cuts.tolist():
        broken[cut : cut + step] = np.nan
    return broken


def _residuals(
    hours: NDArray[np.float64], measured: dict[str, NDArray[np.float64]], twins: dict[str, NDArray[np.float64]]
) -> Html:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 1.7 * len(measured) + 0.5), layout="constrained")
    rows = np.atleast_1d(figure.subplots(len(measured), 1, sharex=True))
    width = max(1, round(300 / (3600 * (hours[1] - hours[0]))))
    count = len(hours) // width * width
    middle = hours[:count].reshape(-1, width).mean(axis=1)
    for position, (sensor, values) in enumerate(measured.items()):
        axes = rows[position]
        for number, (name, outputs) in enumerate(twins.items()):
            difference = (values - outputs[:, position])[:count].reshape(-1, width)
            finite = np.isfinite(difference)
            mean = np.where(finite, difference, 0.0).sum(axis=1) / np.maximum(finite.sum(axis=1), 1)
            colour = COLOURS.get(name, _TRACKED[(number - 1) % len(_TRACKED)])
            axes.plot(middle, np.where(finite.any(axis=1), mean, np.nan), color=colour, linewidth=0.9, label=name)
        axes.axhline(0, color="#30343a", linewidth=0.6)
        axes.set_ylabel(f"{sensor.removesuffix('_C')} / K")
        axes.grid(alpha=0.25)
    figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper right", ncols=6, frameon=False)
    rows[-1].set_xlabel("time / h")
    return _embedded(figure)


def _embedded(figure: Any) -> Html:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    return image("png", buffer.getvalue())


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
        ["times real time", f"{factor:.1f}"],
    ]
    return _part("Timing", table(["", ""], rows))


def _events(reader: JournalReader) -> Html:
    lines = (
        element(
            "tr",
            element("td", f"{row.time_s / 3600:.3f} h"),
            element("td", row.level),
            element("td", row.text, class_="text"),
            class_=row.level if row.level in LEVELS else "",
        )
        for row in reader.events()
    )
    return _part("Events", element("table", *lines))


def _provenance(manifest: dict[str, Any]) -> Html:
    rows = [["run", manifest["uid"]], ["started", manifest["started"]], ["host", manifest["host"]]]
    rows += [[name, f"{item['path']}  sha256 {item['sha256'][:16]}"] for name, item in manifest["files"].items()]
    rows += [[name, version] for name, version in manifest["versions"].items()]
    rows += [[name, str(value)] for name, value in manifest["settings"].items()]
    return _part("Provenance", table(["", ""], rows))
