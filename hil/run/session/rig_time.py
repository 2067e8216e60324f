"""Rig and clock of a run: the rig at the rig file's addresses, or a virtual one."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable

from drivers.rig_file import Rig
from drivers.virtual import is_own_rig
from hil.run.engine import LOCKSTEP_DEADLINE_S, Clock, LockstepClock, MonotonicClock
from hil.run.session.request import RunRequest, plant_twin
from hil.served_rig import ServedRigOptions, moved_rig, start_served_rig

SCHEDULING_DELAY_S = 0.25
"""Delay of a busy machine, s of wall time, that must not count as a lost sensor in scaled time."""


@contextlib.asynccontextmanager
async def rig_and_clock(
    request: RunRequest, rig: Rig, starts_s: float, announce: Callable[[str], None]
) -> AsyncIterator[tuple[Rig, Clock]]:
    """Yield the rig of `request` with its addresses, and its clock.

    A virtual rig starts `starts_s` seconds after the request's start in its time, and ends with the block.

    Raises
    ------
    LinkError
        The rig in lockstep cannot be reached.
    VirtualRigError
        The virtual rig cannot be started.
    ServedRigError
        The rig file cannot be served.
    """
    if request.control is not None:
        lockstep = LockstepClock(*request.control)
        await lockstep.connect()
        yield _waiting(rig), lockstep
        return
    if not request.virtual:
        yield rig, MonotonicClock(rig.period_s, speed_of(request, rig))
        return
    if not is_own_rig(rig):
        async with _served(request, rig, announce) as both:
            yield both
        return
    from drivers.virtual import start_virtual_rig

    hidden = f" with effects that no twin knows of ({request.effects})" if request.effects is not None else ""
    announce(f"starting the virtual rig{hidden}")
    virtual = await start_virtual_rig(
        seed=request.seed,
        mode=request.mode,
        speed=request.speed,
        period_s=rig.period_s,
        effects=request.effects,
        start_s=request.start_s + starts_s,
    )
    try:
        ports = {
            name: virtual.modbus_port if bus.transport == "modbus_tcp" else virtual.can_port
            for name, bus in rig.bus.items()
        }
        if request.mode == "lockstep":
            lockstep = LockstepClock("127.0.0.1", virtual.control_port, virtual.pids.values())
            await lockstep.connect()
            yield _waiting(rig).with_ports(ports), lockstep
        else:
            patient = _patient(rig, request.speed) if request.mode == "scaled" else rig
            yield patient.with_ports(ports), MonotonicClock(rig.period_s, speed_of(request, rig))
    finally:
        await virtual.stop()


@contextlib.asynccontextmanager
async def _served(request: RunRequest, rig: Rig, announce: Callable[[str], None]) -> AsyncIterator[tuple[Rig, Clock]]:
    """Yield the rig with the addresses of its served devices, and its clock; the devices end with the block."""
    announce(f"serving the devices of {request.rig}")
    twin = plant_twin(request, rig)
    options = ServedRigOptions(twin=twin, mode=request.mode, speed=request.speed, seed=request.seed)
    async with await start_served_rig(request.rig, options) as served:
        if request.mode == "lockstep":
            lockstep = LockstepClock("127.0.0.1", served.control_port, served.pids.values())
            await lockstep.connect()
            yield _waiting(moved_rig(rig, served.sections)), lockstep
        else:
            patient = _patient(rig, request.speed) if request.mode == "scaled" else rig
            yield moved_rig(patient, served.sections), MonotonicClock(rig.period_s, speed_of(request, rig))


def speed_of(request: RunRequest, rig: Rig) -> float:
    """Return the factor of the rig's clock to real time: from the request for a virtual rig, else from the rig file."""
    if request.mode == "scaled":
        return request.speed
    return 1.0 if request.virtual or request.control is not None else rig.time_scale


def _waiting(rig: Rig) -> Rig:
    """Return `rig` with time-outs of its buses as long as that of a step.

    The rig's time stands meanwhile. A reply that a busy machine delays would otherwise make runs of one seed differ.
    """
    buses = {
        name: bus.model_copy(update={"timeout_s": max(bus.timeout_s, LOCKSTEP_DEADLINE_S)})
        for name, bus in rig.bus.items()
    }
    return rig.model_copy(update={"bus": buses})


def _patient(rig: Rig, speed: float) -> Rig:
    """Return `rig` with limits of staleness and watchdog, in rig time, longer by a delay of the machine."""
    delay_s = SCHEDULING_DELAY_S * speed
    points = tuple(p.model_copy(update={"stale_after_s": p.stale_after_s + delay_s}) for p in rig.point)
    changed: dict[str, object] = {"point": points, "abort_after_s": rig.abort_after_s + delay_s}
    if rig.heartbeat is not None and rig.heartbeat.watchdog_s is not None:
        longer = {"watchdog_s": rig.heartbeat.watchdog_s + delay_s}
        changed["heartbeat"] = rig.heartbeat.model_copy(update=longer)
    return rig.model_copy(update=changed)
