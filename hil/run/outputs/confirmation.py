"""Set-points that a rig answers for no more, while it may well answer everything else."""

from __future__ import annotations

from hil.run.interlocks import TickValues
from hil.run.outputs.outputs import Outputs


class WriteConfirmation:
    """Condition of an alarm: the rig confirms nothing of what it is told.

    A device may serve readings and drop every write; then no reading is lost, and the heater stays as it was.
    """

    def __init__(self, outputs: Outputs, after_s: float) -> None:
        self._outputs = outputs
        self._after_s = after_s

    def judge(self, tick: TickValues, engaged: bool) -> str | None:
        """Return the violation while what was written last is not confirmed."""
        why = self._outputs.unconfirmed
        return f"the rig has not confirmed its set-points for {self._after_s:g} s: {why}" if why else None
