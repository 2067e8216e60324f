"""Time stamps of a store before its defects are looked for: strays, order, silence and a clock that was set."""

from twin.historian.stamps.clock_steps import with_clock_steps_undone
from twin.historian.stamps.order import order_and_silence, without_strays

__all__ = ["order_and_silence", "with_clock_steps_undone", "without_strays"]
