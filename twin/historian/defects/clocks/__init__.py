"""Clocks of tags that are wrong: local time, off by hours, or moved in the middle of the record."""

from twin.historian.defects.clocks.changes import ByChange, local_by_change
from twin.historian.defects.clocks.course import moved_clocks
from twin.historian.defects.clocks.search import Clocks, changed_clocks, shifted_clocks
from twin.historian.defects.clocks.shift import Shift, corrected, repeated_hours

__all__ = [
    "ByChange",
    "Clocks",
    "Shift",
    "changed_clocks",
    "corrected",
    "local_by_change",
    "moved_clocks",
    "repeated_hours",
    "shifted_clocks",
]
