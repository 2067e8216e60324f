"""Components of a run and its options: made once, shared by the tick, the ending and the engine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from drivers.rig import RigConnection
from drivers.rig_file import CanBus
from hil.guardian import Guard, NoGuard
from hil.journal import JournalWriter
from hil.profile import Profile
from hil.run.engine.clock import LONGEST_WAIT_S, Clock
from hil.run.engine.recording import Position, Publisher, Recorder
from hil.run.engine.status import Status
from hil.run.engine.supervisor import Supervisor
from hil.run.interlocks import GuardedWatch, Residuals, Watch
from hil.run.outputs import GoodReadings, Outputs, SetpointReadback, WriteConfirmation, safe_limits
from hil.run.restore import Resumption


@dataclass(frozen=True, slots=True)
class Options:
    """Options of a run.

    Attributes
    ----------
    publisher
        Gets blocks of recorded ticks: calibrators, live diagnosis.
    observer
        Gets a status a few times a second.
    announce
        Gets every transition as a sentence.
    residuals
        Function that returns the residuals of the twins, K.
    lockstep
        The rig steps only when the clock grants it.
    resumption
        Cut of an earlier run, which continues there once the rig has its temperatures again.
    rearm
        Acknowledge a trip that the rig has latched before the run.
    guard
        Guardian, which makes the rig safe without this process.
    watch
        Gets the values of each tick and may trip the run.
    """

    publisher: Publisher | None = None
    observer: Callable[[Status], None] | None = None
    announce: Callable[[str], None] | None = None
    residuals: Callable[[], Residuals] = dict
    lockstep: bool = False
    resumption: Resumption | None = None
    rearm: bool = False
    guard: Guard = field(default_factory=NoGuard)
    watch: Watch | None = None


class Components:
    """Parts of one run of `profile` on `connection`, wired to each other; their state is the run's."""

    def __init__(
        self, connection: RigConnection, clock: Clock, profile: Profile, journal: JournalWriter, options: Options
    ) -> None:
        self.connection = connection
        self.rig = connection.rig
        self.clock = clock
        self.profile = profile
        self.options = options
        self.guard = options.guard
        self.first_tick = 0
        self.at = Position(clock.period_s)
        resumption = options.resumption
        if resumption is not None:
            self.first_tick = resumption.first_tick(clock.period_s)
            self.at = Position(clock.period_s, self.first_tick, resumption.position.profile_s)
        self.recorder = Recorder(
            journal, self.at, publisher=options.publisher, announce=options.announce, lockstep=options.lockstep
        )
        self.supervisor = Supervisor(
            self.rig, connection.points, log=self.recorder.transition, note=self.recorder.event
        )
        self.machine = self.supervisor.machine
        self.interlocks = self.supervisor.interlocks
        self.outputs = Outputs(connection)
        self.readback = SetpointReadback(connection, self.recorder.event, lockstep=options.lockstep)
        self.interlocks.add_alarm(self.readback)
        self.interlocks.add_alarm(WriteConfirmation(self.outputs, self.rig.abort_after_s), self.rig.abort_after_s)
        self.watch = None if options.watch is None else GuardedWatch(options.watch, self.recorder.event)
        if self.watch is not None:
            self.interlocks.add_alarm(self.watch)
        self.limits = safe_limits(self.rig)
        self.heater_meters = GoodReadings(connection.points, (limit.meter for limit in self.limits))
        timeouts_s = sum(bus.timeout_s for bus in self.rig.bus.values() if not isinstance(bus, CanBus))
        self.is_quick = clock.period_s <= LONGEST_WAIT_S and timeouts_s <= LONGEST_WAIT_S
        """True where no tick takes so long that a stop request has to interrupt it."""
        self.step_s = clock.period_s if options.lockstep else min(clock.period_s, LONGEST_WAIT_S)
        """Time between two readings of the meters while the rig is made safe, s; less than the period of a slow rig."""
        self._patience_s = clock.period_s + LONGEST_WAIT_S + self.rig.abort_after_s + 2.0 * timeouts_s

    def expect(self) -> None:
        """State to the guardian how long this run may be busy: until the next tick, and with devices that are mute."""
        self.guard.expect(self._patience_s)

    async def advance(self) -> None:
        """Let one period pass, outside the grid."""
        self.expect()
        await self.clock.advance()

    async def step(self) -> None:
        """Let `step_s` pass, outside the grid."""
        if self.step_s == self.clock.period_s:
            await self.advance()
        else:
            self.expect()
            await self.clock.advance(self.step_s)

    def trouble(self) -> str | None:
        """Return why the run has to end before its next tick: the guardian acted or is gone, the journal is lost."""
        return self.guard.failure() or self.recorder.failure
