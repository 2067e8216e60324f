"""Labels of a run (test object, serial number, operator, tags), and notes that are added at any time, live too.

Notes are lines of JSON in `notes.jsonl` beside the journal, which are only ever appended: a run that goes on is not
disturbed, and nobody's note is changed later. A line may also change labels.
"""

from __future__ import annotations

import contextlib
import datetime
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from hil.files import is_blank, plain
from hil.run_folder.folder import RunFolder, RunFolderError
from hil.run_folder.json_lines import append_json_line, read_json_lines
from hil.run_folder.manifest_check import DocumentShape, Labels

LONGEST_NOTE = 2000
"""Most characters of a note."""
LONGEST_LABEL = 200
"""Most characters of a label, and of the name of an author."""


def _iso_8601(time: str) -> str:
    datetime.datetime.fromisoformat(time)
    return time


class _Line(DocumentShape):
    time: Annotated[str, AfterValidator(_iso_8601)]
    by: str = ""
    text: str = ""
    labels: dict[str, str | list[str]] = Field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Note:
    """Note on a run at `time`, an ISO 8601 time; `labels` are those that it changes."""

    time: str
    by: str
    text: str
    labels: Mapping[str, str | list[str]] = field(default_factory=dict)

    @property
    def wall_s(self) -> float:
        """Return the time in s since 1970."""
        return datetime.datetime.fromisoformat(self.time).timestamp()


def add_note(folder: RunFolder, text: str, by: str, labels: Labels | None = None) -> Note:
    """Append a note to a run, live or ended; labels that are not empty replace those of the run.

    Raises
    ------
    RunFolderError
        This is no run folder, the note is empty or too long, or the file cannot be written.
    """
    folder.read_manifest()
    changed = {} if labels is None else labels.given()
    for what, given, longest in (
        ("the note", text.strip(), LONGEST_NOTE),
        ("the name of the author", by, LONGEST_LABEL),
        *((f"the label {name}", part, LONGEST_LABEL) for name, part in _label_texts(changed)),
    ):
        if len(given) > longest:
            raise RunFolderError(
                f"{what} has {len(given)} characters, at most {longest} are kept; shorten it, or write several notes"
            )
    if is_blank(text) and not changed:
        raise RunFolderError("the note is empty; write what you saw, or give a label such as --serial")
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    note = Note(now, plain(by, LONGEST_LABEL), plain(text.strip(), LONGEST_NOTE), changed)
    line = {"time": note.time, "by": note.by, "text": note.text, "labels": changed}
    append_json_line(folder.notes, line, RunFolderError)
    return note


def _label_texts(labels: Mapping[str, str | list[str]]) -> list[tuple[str, str]]:
    """Return name and text of each label."""
    return [(name, part) for name, given in labels.items() for part in ([given] if isinstance(given, str) else given)]


def read_notes(folder: RunFolder) -> list[Note]:
    """Return the notes of a run in order; none for a run without any. A last line that a crash cut is left out.

    Raises
    ------
    RunFolderError
        A line is damaged; the message names it.
    """
    lines = read_json_lines(folder.notes, _Line, "not a note", RunFolderError)
    return [Note(line.time, line.by, line.text, line.labels) for _, line in lines]


def labels_of(manifest: Mapping[str, Any], notes: Sequence[Note]) -> Labels:
    """Return the labels of a run: those of its beginning, each replaced by the last note that changes it."""
    known: dict[str, Any] = dict(manifest.get("labels") or {})
    for note in notes:
        known |= note.labels
    return Labels(
        **{name: str(known.get(name, "")) for name in ("test_object", "serial_number", "operator")},
        tags=tuple(str(tag) for tag in known.get("tags", ())),
    )


def label_texts(folder: RunFolder, manifest: Mapping[str, Any]) -> dict[str, str]:
    """Return the labels of a run for files of other programs, without the empty ones, the tags as one text.

    Damaged notes count as none: they prevent no export and no verdict.
    """
    notes: list[Note] = []
    with contextlib.suppress(RunFolderError):
        notes = read_notes(folder)
    given = labels_of(manifest, notes).given()
    return {name: value if isinstance(value, str) else ", ".join(value) for name, value in given.items()}
