"""Crash-safe journal of a run, its states, and the export of its record.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.journal.check import require_alone
    from hil.journal.export import (
        ExportedRecord,
        all_samples,
        export_record,
        record_sha256,
        recorded_rows,
        samples_sha256,
    )
    from hil.journal.profile_clock import profile_times
    from hil.journal.reader import JournalReader
    from hil.journal.rows import (
        BandRow,
        CalibrationRow,
        EventRow,
        Header,
        JournalError,
        JournalSamples,
        ProposalRow,
        SegmentRow,
        StateRow,
        TwinOutput,
    )
    from hil.journal.states import (
        ACKNOWLEDGED,
        ENDED,
        HEATED,
        LIVE,
        NO_TICK,
        UNTOUCHED,
        WAITING,
        RunEvent,
        State,
        StateMachine,
        Transition,
        TransitionError,
        event_level,
        next_state,
    )
    from hil.journal.writer import JournalWriter

__all__ = [
    "ACKNOWLEDGED",
    "ENDED",
    "HEATED",
    "LIVE",
    "NO_TICK",
    "UNTOUCHED",
    "WAITING",
    "BandRow",
    "CalibrationRow",
    "EventRow",
    "ExportedRecord",
    "Header",
    "JournalError",
    "JournalReader",
    "JournalSamples",
    "JournalWriter",
    "ProposalRow",
    "RunEvent",
    "SegmentRow",
    "State",
    "StateMachine",
    "StateRow",
    "Transition",
    "TransitionError",
    "TwinOutput",
    "all_samples",
    "event_level",
    "export_record",
    "next_state",
    "profile_times",
    "record_sha256",
    "recorded_rows",
    "require_alone",
    "samples_sha256",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "check": ("require_alone",),
        "export": (
            "ExportedRecord",
            "all_samples",
            "export_record",
            "record_sha256",
            "recorded_rows",
            "samples_sha256",
        ),
        "profile_clock": ("profile_times",),
        "reader": ("JournalReader",),
        "rows": (
            "BandRow",
            "CalibrationRow",
            "EventRow",
            "Header",
            "JournalError",
            "ProposalRow",
            "JournalSamples",
            "SegmentRow",
            "StateRow",
            "TwinOutput",
        ),
        "states": (
            "ACKNOWLEDGED",
            "ENDED",
            "RunEvent",
            "HEATED",
            "LIVE",
            "NO_TICK",
            "State",
            "StateMachine",
            "Transition",
            "TransitionError",
            "UNTOUCHED",
            "WAITING",
            "event_level",
            "next_state",
        ),
        "writer": ("JournalWriter",),
    },
)
