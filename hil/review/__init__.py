"""A run in Rerun: measured against twins, residuals, set-points, calibrations, quality and events.

The review follows the journal and never the engine. So a live run is not delayed, a second terminal can follow it, and
the file can be rebuilt at any time. Only `hil.review.rerun_io` imports rerun.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.review.follower import follow, write_findings_review, write_review
    from hil.review.rerun_io import read_columns, read_words
    from hil.review.show import Follower, follow_review, screenshot, screenshot_review, show_review, start_follower
    from hil.review.tower import write_tower_review
    from hil.review.viewer import Viewer, ViewerError, has_display, open_viewer

__all__ = [
    "Follower",
    "Viewer",
    "ViewerError",
    "follow",
    "follow_review",
    "has_display",
    "open_viewer",
    "read_columns",
    "read_words",
    "screenshot",
    "screenshot_review",
    "show_review",
    "start_follower",
    "write_findings_review",
    "write_review",
    "write_tower_review",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "follower": (
            "follow",
            "write_findings_review",
            "write_review",
        ),
        "rerun_io": (
            "read_columns",
            "read_words",
        ),
        "show": (
            "Follower",
            "follow_review",
            "screenshot",
            "screenshot_review",
            "show_review",
            "start_follower",
        ),
        "tower": ("write_tower_review",),
        "viewer": (
            "Viewer",
            "ViewerError",
            "has_display",
            "open_viewer",
        ),
    },
)
