"""A run of the synthetic coolant loop whose alarms are known: its journal grows as a test asks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.alarms.definitions import META_KEY, AlarmDefinition, as_document
from tests.hil import streamed_run

TANK = AlarmDefinition(id="T_tank.H", kind="high", priority="high", points=("T_tank",), limit=50.0, unit="degC")
FLOW = AlarmDefinition(
    id="flow.L", kind="low", priority="medium", points=("flow",), limit=1.0, unit="L/min", latch=True
)
RUN = tuple(
    AlarmDefinition(id=name, kind="run", priority="critical")
    for name in ("run.trip", "run.interrupted", "run.guardian", "twin.disturbance")
)


@dataclass
class AlarmedRun:
    """Run that goes on. `step` appends one block of ticks with a tank and a flow."""

    run: streamed_run.StreamedRun

    @property
    def path(self) -> Path:
        """Return the folder."""
        return self.run.path

    def step(self, tank_C: float, flow: float = 8.0, ticks: int = 15) -> None:
        """Append ticks, longer than every off-delay, on which tank and flow have these values."""
        self.set_from_here(tank_C, flow)
        self.run.write(ticks)

    def set_from_here(self, tank_C: float, flow: float) -> None:
        """Let tank and flow have these values on all ticks to come."""
        names = [signal.name for signal in self.run.truth.header.signals]
        self.run.truth.values[self.run.written :, names.index("T_tank")] = tank_C
        self.run.truth.values[self.run.written :, names.index("flow")] = flow

    def finish(self) -> None:
        """Append the ticks that are left, with the values of the last one, and end the run."""
        self.run.finish()


def alarmed_run(parent: Path, definitions: tuple[AlarmDefinition, ...] = (TANK, FLOW, *RUN)) -> AlarmedRun:
    """Return a live run in which nothing has happened yet."""
    run = AlarmedRun(streamed_run.live_run(parent, 600))
    run.run.truth.values[:] = np.nan_to_num(run.run.truth.values)
    run.run.truth.quality[:] = 0
    run.step(25.0)
    assert run.run.writer is not None
    run.run.writer.put_meta(META_KEY, as_document(definitions))
    run.run.writer.commit()
    return run
