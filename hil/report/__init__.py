"""Report of a run as one HTML file.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.report.actuators import pair_actuators
    from hil.report.page import load_libraries, write_report
    from hil.report.pdf import PdfError, write_pdf
    from hil.report.plot_script import SCRIPT
    from hil.report.statistics import number, symbol, time_unit
    from hil.report.verdict import earlier_verdicts
    from hil.report.zoom import HINT, PLOT_STYLE, ZoomCurve, zoom_plot

__all__ = [
    "HINT",
    "PLOT_STYLE",
    "SCRIPT",
    "PdfError",
    "ZoomCurve",
    "earlier_verdicts",
    "load_libraries",
    "number",
    "pair_actuators",
    "symbol",
    "time_unit",
    "write_pdf",
    "write_report",
    "zoom_plot",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "actuators": ("pair_actuators",),
        "page": (
            "load_libraries",
            "write_report",
        ),
        "pdf": (
            "PdfError",
            "write_pdf",
        ),
        "plot_script": ("SCRIPT",),
        "statistics": (
            "number",
            "symbol",
            "time_unit",
        ),
        "verdict": ("earlier_verdicts",),
        "zoom": (
            "HINT",
            "PLOT_STYLE",
            "ZoomCurve",
            "zoom_plot",
        ),
    },
)
