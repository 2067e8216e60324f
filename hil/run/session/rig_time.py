"""The rig that a run is for and whose time it goes by: the one at the rig file's addresses, or a virtual one."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable

from drivers.rig_file.model import Rig
from hil.run.engine.clock import LOCKSTEP_DEADLINE_S, Clock, LockstepClock, MonotonicClock
from hil.run.session.request import RunRequest

HICCUP_S = 0.25
"""Wall time that a busy machine may lose now and then: in scaled time it must not look like a lost sensor."""


@contextlib.asynccontextmanager
async def rig_and_clock(
    request: RunRequest, rig: Rig, starts_s: float, announce: Callable[[str], None]
) -> AsyncIterator[tuple[Rig, Clock]]:
    """The rig of `request` with its addresses, and its clock; a virtual one is started at `starts_s` of its time, and
    ended with the block. Raises LinkError or VirtualRigError."""
    if request.control is not None:
        lockstep = LockstepClock(*request.control)
        await lockstep.connect()
        yield _waiting(rig), lockstep
        return
    if not request.virtual:
        yield rig, MonotonicClock(rig.period_s, speed_of(request, rig))
        return
    from drivers.virtual.rig import start_virtual_rig

    hidden = f" with effects that no twin knows of ({request.effects})" if request.effects is not None else ""
    announce(f"starting the virtual rig{hidden}")
    virtual = await start_virtual_rig(
        seed=request.seed,
        mode=request.mode,
        speed=request.speed,
        period_s=rig.period_s,
        effects=request.effects,
        start_s=starts_s,
    )
    try:
        ports = {
            name: virtual.modbus_port if bus.transport == "modbus_tcp" else virtual.can_port
            for name, bus in rig.bus.items()
        }
        if request.mode == "lockstep":
            lockstep = LockstepClock("127.0.0.1", virtual.control_port)
            await lockstep.connect()
            yield _waiting(rig).with_ports(ports), lockstep
        else:
            patient = _patient(rig, request.speed) if request.mode == "scaled" else rig
            yield patient.with_ports(ports), MonotonicClock(rig.period_s, speed_of(request, rig))
    finally:
        await virtual.stop()


def speed_of(request: RunRequest, rig: Rig) -> float:
    """Return how many times real time the rig's clock runs: a virtual rig's as asked, a real one's as its file says."""
    if request.mode == "scaled":
        return request.speed
    return 1.0 if request.virtual or request.control is not None else rig.time_scale


def _waiting(rig: Rig) -> Rig:
    """Return `rig` with buses that wait as long for a reply as for a step: the rig's time stands still meanwhile, and a
    reply that a busy machine delays would be a lost sensor in one run of a seed and none in the next."""
    buses = {
        name: bus.model_copy(update={"timeout_s": max(bus.timeout_s, LOCKSTEP_DEADLINE_S)})
        for name, bus in rig.bus.items()
    }
    return rig.model_copy(update={"bus": buses})


def _patient(rig: Rig, speed: float) -> Rig:
    """`rig` with the limits of staleness and of its watchdog, in rig time, widened by a hiccup of the machine."""
    hiccup_s = HICCUP_S * speed
    points = tuple(p.model_copy(update={"stale_after_s": p.stale_after_s + hiccup_s}) for p in rig.point)
    changed: dict[str, object] = {"point": points, "abort_after_s": rig.abort_after_s + hiccup_s}
    if rig.heartbeat is not None and rig.heartbeat.watchdog_s is not None:
        longer = {"watchdog_s": rig.heartbeat.watchdog_s + hiccup_s}
        changed["heartbeat"] = rig.heartbeat.model_copy(update=longer)
    return rig.model_copy(update=changed)
