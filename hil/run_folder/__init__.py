"""Folder of a run: paths of its files, its lock, and the checks of its manifest.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.run_folder.folder import (
        FolderLostError,
        RunFolder,
        RunFolderError,
        create_run_folder,
        new_manifest,
        require_room,
    )
    from hil.run_folder.json_lines import append_json_line, read_json_lines
    from hil.run_folder.manifest_check import (
        DocumentShape,
        Labels,
        left_safe,
        require_settings,
        without_end,
        wrong_place,
    )
    from hil.run_folder.notes import LONGEST_LABEL, LONGEST_NOTE, Note, add_note, label_texts, labels_of, read_notes
    from hil.run_folder.output_path import require_output
    from hil.run_folder.room import RunSize
    from hil.run_folder.verdict import DiagnosisVerdict, read_diagnosis_verdict, read_verdict

__all__ = [
    "LONGEST_LABEL",
    "LONGEST_NOTE",
    "DiagnosisVerdict",
    "DocumentShape",
    "FolderLostError",
    "Labels",
    "Note",
    "RunFolder",
    "RunFolderError",
    "RunSize",
    "add_note",
    "append_json_line",
    "create_run_folder",
    "label_texts",
    "labels_of",
    "left_safe",
    "new_manifest",
    "read_diagnosis_verdict",
    "read_json_lines",
    "read_notes",
    "read_verdict",
    "require_output",
    "require_room",
    "require_settings",
    "without_end",
    "wrong_place",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "folder": (
            "FolderLostError",
            "RunFolder",
            "RunFolderError",
            "create_run_folder",
            "new_manifest",
            "require_room",
        ),
        "json_lines": ("append_json_line", "read_json_lines"),
        "manifest_check": (
            "DocumentShape",
            "Labels",
            "left_safe",
            "require_settings",
            "without_end",
            "wrong_place",
        ),
        "notes": (
            "LONGEST_LABEL",
            "LONGEST_NOTE",
            "Note",
            "add_note",
            "label_texts",
            "labels_of",
            "read_notes",
        ),
        "output_path": ("require_output",),
        "room": ("RunSize",),
        "verdict": (
            "DiagnosisVerdict",
            "read_diagnosis_verdict",
            "read_verdict",
        ),
    },
)
