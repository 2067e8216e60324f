"""Diagnosis of a record or a run: input, results as files, page.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.diagnosis.columns import choice_for, columns_of, read_columns, read_healthy, with_clock
    from hil.diagnosis.experiment_file import rig_of
    from hil.diagnosis.forecast import show_forecast
    from hil.diagnosis.healthy_record import (
        commissioned_on,
        copy_record,
        healthy_path,
        save_with_record,
        without_stuck,
    )
    from hil.diagnosis.live import END_ONLY, LiveConfig, LiveDiagnosis, Reply, interval_of
    from hil.diagnosis.page import PAGE_STYLE
    from hil.diagnosis.page import STYLE as FIGURE_STYLE
    from hil.diagnosis.revision import revise
    from hil.diagnosis.session import (
        DiagnosisRequest,
        PreparedDiagnosis,
        Written,
        columns_in_use,
        described,
        diagnose_files,
        prepare,
        write_results,
    )
    from hil.diagnosis.store import (
        CURVES,
        DOCUMENT,
        REVIEW,
        DiagnosisFolderError,
        Findings,
        ResidualCurves,
        Unknown,
        has_diagnosis,
        read_findings,
        write_curves,
        write_document,
    )
    from hil.diagnosis.terminal import errors_of, held_out, print_diagnosis
    from hil.diagnosis.wording import after_label, ambiguity_group, plain, reasons, short

__all__ = [
    "CURVES",
    "DOCUMENT",
    "END_ONLY",
    "FIGURE_STYLE",
    "PAGE_STYLE",
    "REVIEW",
    "DiagnosisFolderError",
    "DiagnosisRequest",
    "Findings",
    "LiveConfig",
    "LiveDiagnosis",
    "PreparedDiagnosis",
    "Reply",
    "ResidualCurves",
    "Unknown",
    "Written",
    "after_label",
    "ambiguity_group",
    "choice_for",
    "columns_in_use",
    "columns_of",
    "commissioned_on",
    "copy_record",
    "described",
    "diagnose_files",
    "errors_of",
    "has_diagnosis",
    "healthy_path",
    "held_out",
    "interval_of",
    "plain",
    "prepare",
    "print_diagnosis",
    "read_columns",
    "read_findings",
    "read_healthy",
    "reasons",
    "revise",
    "rig_of",
    "save_with_record",
    "short",
    "show_forecast",
    "with_clock",
    "without_stuck",
    "write_curves",
    "write_document",
    "write_results",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "columns": (
            "choice_for",
            "columns_of",
            "read_columns",
            "read_healthy",
            "with_clock",
        ),
        "experiment_file": ("rig_of",),
        "page.figure_style": ("FIGURE_STYLE = STYLE",),
        "forecast": ("show_forecast",),
        "healthy_record": (
            "commissioned_on",
            "copy_record",
            "healthy_path",
            "save_with_record",
            "without_stuck",
        ),
        "live": (
            "END_ONLY",
            "LiveConfig",
            "LiveDiagnosis",
            "Reply",
            "interval_of",
        ),
        "page.document": ("PAGE_STYLE",),
        "revision": ("revise",),
        "session": (
            "DiagnosisRequest",
            "PreparedDiagnosis",
            "Written",
            "columns_in_use",
            "described",
            "diagnose_files",
            "prepare",
            "write_results",
        ),
        "store": (
            "CURVES",
            "ResidualCurves",
            "DOCUMENT",
            "DiagnosisFolderError",
            "Findings",
            "REVIEW",
            "Unknown",
            "has_diagnosis",
            "read_findings",
            "write_curves",
            "write_document",
        ),
        "terminal.table": (
            "errors_of",
            "held_out",
        ),
        "terminal.report": ("print_diagnosis",),
        "wording": (
            "after_label",
            "ambiguity_group",
            "plain",
            "reasons",
            "short",
        ),
    },
)
