"""A run in Rerun: measured against twins, residuals, set-points, calibrations, quality and events.

The review follows the journal and never the engine. So a live run is not delayed, a second terminal can follow it, and
the file can be rebuilt at any time. Only `hil.review.rerun_io` imports rerun.
"""

from hil.review.follower import follow, write_findings_review, write_review
from hil.review.rerun_io import read_columns, read_words
from hil.review.show import Follower, follow_review, screenshot, screenshot_review, show_review, start_follower
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
]
