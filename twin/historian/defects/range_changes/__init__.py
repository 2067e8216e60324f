"""Tags that read on another scale from one sample to the next: a transmitter that was given another range."""

from twin.historian.defects.range_changes.search import RangeChanges, range_changes

__all__ = ["RangeChanges", "range_changes"]
