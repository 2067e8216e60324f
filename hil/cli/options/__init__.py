"""Options and questions that several commands share.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.cli.options.extra_arguments import explained_extras
    from hil.cli.options.init_questions import ask
    from hil.cli.options.labels import label_options
    from hil.cli.options.own_process import OWN_PROCESS, owns_process
    from hil.cli.options.paths import INPUT_CARD, INPUT_FILE, INPUT_PATH, PROJECT, RECORD_FILE, VIRTUAL_RIG
    from hil.cli.options.record_reading import reading, reading_tables
    from hil.cli.options.subject import record_of, subject_of
    from hil.cli.options.tracking import CALIBRATORS, NETWORK, NETWORK_MODE
    from hil.cli.options.workers import on_workers, workers_of

__all__ = [
    "CALIBRATORS",
    "INPUT_CARD",
    "INPUT_FILE",
    "INPUT_PATH",
    "NETWORK",
    "NETWORK_MODE",
    "OWN_PROCESS",
    "PROJECT",
    "RECORD_FILE",
    "VIRTUAL_RIG",
    "ask",
    "explained_extras",
    "label_options",
    "on_workers",
    "owns_process",
    "reading",
    "reading_tables",
    "record_of",
    "subject_of",
    "workers_of",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "extra_arguments": ("explained_extras",),
        "init_questions": ("ask",),
        "labels": ("label_options",),
        "own_process": (
            "OWN_PROCESS",
            "owns_process",
        ),
        "paths": (
            "INPUT_CARD",
            "INPUT_FILE",
            "INPUT_PATH",
            "PROJECT",
            "RECORD_FILE",
            "VIRTUAL_RIG",
        ),
        "record_reading": ("reading", "reading_tables"),
        "subject": (
            "record_of",
            "subject_of",
        ),
        "tracking": (
            "CALIBRATORS",
            "NETWORK",
            "NETWORK_MODE",
        ),
        "workers": ("on_workers", "workers_of"),
    },
)
