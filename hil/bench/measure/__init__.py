"""Measurement: machine, processes, tables and manifests.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.bench.measure.machine import cpu_s, in_new_process, manifest, median
    from hil.bench.measure.measured_code import code_state
    from hil.bench.measure.report import BenchReport, Cell, ReportTable, as_json, number, show, write

__all__ = [
    "BenchReport",
    "Cell",
    "ReportTable",
    "as_json",
    "code_state",
    "cpu_s",
    "in_new_process",
    "manifest",
    "median",
    "number",
    "processes",
    "show",
    "write",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "": ("processes",),
        "machine": (
            "cpu_s",
            "in_new_process",
            "manifest",
            "median",
        ),
        "measured_code": ("code_state",),
        "report": (
            "BenchReport",
            "Cell",
            "ReportTable",
            "as_json",
            "number",
            "show",
            "write",
        ),
    },
)
