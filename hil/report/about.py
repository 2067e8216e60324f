"""Sections of a report on the run itself: labels, notes, the verdict of its diagnosis, quality of its data."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.signals import Quality
from hil.files import Html, element, joined, table
from hil.journal import Header, JournalSamples
from hil.report.statistics import NONE, TimeUnit
from hil.run_folder import DiagnosisVerdict, Labels, Note


def label_section(labels: Labels, manifest: dict[str, Any], diagnosis: DiagnosisVerdict | None) -> Html:
    """Return the table of test object, serial number, operator, tags, files and version; unknown ones are left out.

    `diagnosis` is the verdict of the diagnosis in the run's folder.
    """
    files = manifest["files"]
    rows = [
        ["test object", labels.test_object],
        ["serial number", labels.serial_number],
        ["operator", labels.operator],
        ["tags", ", ".join(labels.tags)],
        ["rig", files["rig"]["path"] if "rig" in files else ""],
        ["profile", files["profile"]["path"] if "profile" in files else ""],
        ["twin", _named_file(files["twin"]) if "twin" in files else ""],
        ["started", manifest["started"]],
        ["ended", manifest.get("ended") or ""],
        ["made by", f"hil {manifest['versions']['hil']}" if "hil" in manifest.get("versions", {}) else ""],
        ["diagnosis", (manifest.get("diagnosis") or "") if diagnosis is None else str(diagnosis)],
    ]
    rows = [row for row in rows if row[1]]
    return table(["", ""], rows, class_="about") if rows else joined([])


def note_section(notes: list[Note], wall_s: NDArray[np.float64], time_s: NDArray[np.float64], unit: TimeUnit) -> Html:
    """Return the table of notes; `wall_s` (n,) and `time_s` (n,) relate their time to that of the run, s."""
    if not notes:
        return joined([])
    rows: list[list[Html | str]] = []
    for note in notes:
        live = len(wall_s) > 0 and wall_s[0] <= note.wall_s <= wall_s[-1] + 1.0
        at = unit.of(float(np.interp(note.wall_s, wall_s, time_s))) if live else NONE
        labels = "; ".join(f"{name}: {_plain(value)}" for name, value in note.labels.items())
        rows.append([note.time, at, note.by, element("span", "; ".join(filter(None, (note.text, labels))))])
    head = ["time", f"in the run / {unit.symbol}", "by", "note"]
    return joined([element("h2", "Notes"), table(head, rows, class_="about notes")])


def quality_section(header: Header, samples: JournalSamples) -> Html:
    """Return the table of signals that were not always good, with the ticks of each quality."""
    if not len(samples.tick):
        return joined([])
    kinds = [quality for quality in Quality if quality is not Quality.GOOD]
    counts = np.array([(samples.quality == int(kind)).sum(axis=0) for kind in kinds])
    rows = [
        [signal.name, *(str(int(count)) if count else NONE for count in counts[:, index])]
        for index, signal in enumerate(header.signals)
        if counts[:, index].any()
    ]
    head = ["signal", *(kind.name.lower().replace("_", " ") for kind in kinds)]
    text = f"Ticks of {len(samples.tick)} with a value that is not good." if rows else "Every value was good."
    body = table(head, rows) if rows else joined([])
    return joined([element("h2", "Data quality"), body, element("p", text, class_="note")])


def _named_file(item: dict[str, Any]) -> str:
    """Return path and hash of a file of the run."""
    return f"{item['path']} (sha256 {item['sha256'][:16]})"


def _plain(value: object) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
