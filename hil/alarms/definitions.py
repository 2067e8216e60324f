"""Definitions of the alarms of a run, made from its rig file and stored in its journal.

Identifiers follow process control: `T_tank.H` and `T_tank.L` warn, `T_tank.HH` and `T_tank.LL` trip the run.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, model_validator

from drivers.rig_file import (
    AlarmSpec,
    HeaterPowerSpec,
    InterlockSpec,
    LimitSpec,
    NoFlowSpec,
    Point,
    Priority,
    RateOfRiseSpec,
    ResidualSpec,
    Rig,
    SensorSpec,
)
from hil.alarms.errors import AlarmError
from hil.run_folder import wrong_place

META_KEY = "alarms"
"""Key of the definitions in the metadata of a journal."""
OFF_DELAY_S = 10.0
"""Off-delay of the alarms that have no section of their own, s: that of an interlock without one."""
PRIORITIES: tuple[Priority, ...] = ("critical", "high", "medium", "low")
"""Priorities from the first to attend to, to the last."""
RUN_TRIP, RUN_INTERRUPTED, GUARDIAN, TWIN = "run.trip", "run.interrupted", "run.guardian", "twin.disturbance"
Kind = Literal[
    "high", "low", "rate_of_rise", "no_flow", "sensor", "deviation", "disagreement", "residual", "link", "rig_trip",
    "rig_counter", "run",
]  # fmt: skip

_NEEDS: dict[Kind, tuple[int, bool]] = {
    "high": (1, True), "low": (1, True), "rate_of_rise": (1, True), "no_flow": (2, True), "sensor": (1, False),
    "deviation": (2, True), "disagreement": (2, True), "residual": (0, True), "rig_trip": (1, False),
    "rig_counter": (1, False),
}  # fmt: skip
"""Least number of points of a kind of alarm, and whether it needs a limit."""


class AlarmDefinition(BaseModel):
    """Definition of one alarm: its condition on `points`, and the delays and deadband between condition and alarm.

    `limit` and `deadband` are in `unit`, times in s of rig time. With `drains` the on-delay is a leaky integrator, as
    that of the interlock on a point without a good value. The alarms of kind `run` follow the journal's transitions.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    id: str = Field(min_length=1, max_length=200)
    kind: Kind
    priority: Priority
    points: tuple[str, ...] = ()
    limit: float | None = None
    above: float = 0.0
    unit: str = ""
    deadband: float = Field(default=0.0, ge=0)
    on_delay_s: float = Field(default=0.0, ge=0)
    off_delay_s: float = Field(default=OFF_DELAY_S, ge=0)
    window_s: float = Field(default=0.0, ge=0)
    mask: int = Field(default=0, ge=0, lt=1 << 63)
    bus: str = ""
    twin: str = ""
    sensor: str = ""
    latch: bool = False
    drains: bool = False
    doc: str = ""

    @model_validator(mode="after")
    def _complete(self) -> Self:
        points, has_limit = _NEEDS.get(self.kind, (0, False))
        if len(self.points) < points or (has_limit and self.limit is None):
            raise ValueError(f"an alarm of kind {self.kind} lacks a point or its limit")
        return self

    @property
    def rank(self) -> int:
        """Return the place of its priority, 0 for the first to attend to."""
        return PRIORITIES.index(self.priority)


_ALL = TypeAdapter(tuple[AlarmDefinition, ...])


def as_document(definitions: Iterable[AlarmDefinition]) -> dict[str, Any]:
    """Return definitions as plain data, without the keys that have their defaults."""
    return {"definitions": [item.model_dump(mode="json", exclude_defaults=True) for item in definitions]}


def from_document(document: Any, where: str) -> tuple[AlarmDefinition, ...]:
    """Return the definitions of a journal's metadata; `where` names it in messages.

    Raises
    ------
    AlarmError
        There are none, or they are damaged.
    """
    if document is None:
        raise AlarmError(
            f"{where} holds no alarm definitions: its run began with an earlier version; alarms need a new run"
        )
    try:
        found = _ALL.validate_json(json.dumps(document["definitions"] if isinstance(document, dict) else document))
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        why = wrong_place(error) if isinstance(error, ValidationError) else "they are no list of alarms"
        raise AlarmError(f"{where} holds damaged alarm definitions: {why}; start a new run") from None
    if len({item.id for item in found}) != len(found):
        raise AlarmError(f"{where} holds two alarm definitions of one id; start a new run")
    return found


def definitions_of(rig: Rig) -> tuple[AlarmDefinition, ...]:
    """Return the alarms of runs on `rig`: limits, interlocks, links, sensors, the rig's own trip, the run."""
    found = [
        AlarmDefinition(id=RUN_TRIP, kind="run", priority="critical", doc="the run has tripped, or ended with a fault"),
        AlarmDefinition(id=RUN_INTERRUPTED, kind="run", priority="critical", doc="the run was killed, or lost power"),
        AlarmDefinition(id=GUARDIAN, kind="run", priority="critical", doc="the guardian has made the rig safe"),
        AlarmDefinition(
            id=TWIN, kind="run", priority="low", unit="W", doc="a calibrator finds heat that the twin lacks"
        ),
    ]
    for point in rig.point:
        if point.alarm is not None and point.is_polled:
            low, high = point.alarm
            found += _bounds(point, low, high, tripping=True, priority="high")
    for spec in rig.interlock:
        found += _interlock(spec, rig)
    for alarm in rig.alarm:
        found += _alarm(alarm, rig.get(alarm.point))
    found += _links_and_sensors(rig)
    declared = {item.points[0] for item in found if item.kind == "disagreement"}
    found += [
        AlarmDefinition(
            id=f"{point.name}.deviation",
            kind="deviation",
            priority="low",
            points=(point.name, point.readback),
            limit=point.readback_tolerance,
            unit=point.unit,
            on_delay_s=point.readback_within_s,
            window_s=point.readback_within_s,
        )
        for point in rig.setpoints
        if point.readback is not None and point.name not in declared
    ]
    found += _rigs_own(rig)
    return tuple(_distinct(found))


def _bounds(
    point: Point, low: float | None, high: float | None, *, tripping: bool, priority: Priority, **rest: Any
) -> list[AlarmDefinition]:
    """Return an alarm for each bound that is there."""
    ends: tuple[tuple[Literal["high", "low"], float | None], ...] = (("high", high), ("low", low))
    return [
        AlarmDefinition(
            id=f"{point.name}.{kind[0].upper() * (2 if tripping else 1)}",
            kind=kind,
            priority=priority,
            points=(point.name,),
            limit=limit,
            unit=point.unit,
            **rest,
        )
        for kind, limit in ends
        if limit is not None
    ]


def _alarm(spec: AlarmSpec, point: Point) -> list[AlarmDefinition]:
    delays = spec.model_dump(include={"deadband", "on_delay_s", "off_delay_s", "latch", "doc"})
    return _bounds(point, spec.low, spec.high, tripping=False, priority=spec.priority, **delays)


def _interlock(spec: InterlockSpec, rig: Rig) -> list[AlarmDefinition]:
    """Return the alarms of a declared interlock: a residual's is low in priority, as a wrong twin is no danger."""
    tripping = spec.level == "alarm"
    default: Priority = "low" if isinstance(spec, ResidualSpec) else "high" if tripping else "medium"
    priority = spec.priority or default
    rest: dict[str, Any] = spec.model_dump(include={"deadband", "on_delay_s", "off_delay_s", "doc"})
    if isinstance(spec, LimitSpec):
        return _bounds(rig.get(spec.point), spec.low, spec.high, tripping=tripping, priority=priority, **rest)
    if isinstance(spec, RateOfRiseSpec):
        point = rig.get(spec.point)
        rest |= {"points": (point.name,), "limit": spec.high, "unit": f"{point.unit}/s", "window_s": spec.window_s}
        return [AlarmDefinition(id=f"{point.name}.rate", kind="rate_of_rise", priority=priority, **rest)]
    if isinstance(spec, NoFlowSpec):
        setpoint = rig.setpoint_of_column(spec.heater)
        points = (spec.flow, spec.heater, *(() if setpoint is None else (setpoint.name,)))
        rest |= {"points": points, "limit": spec.low, "above": spec.above, "unit": rig.get(spec.flow).unit}
        return [AlarmDefinition(id=f"{spec.flow}.no_flow", kind="no_flow", priority=priority, **rest)]
    if isinstance(spec, HeaterPowerSpec):
        point = rig.get(spec.setpoint)
        assert point.readback is not None
        rest["on_delay_s"] = point.readback_within_s if spec.on_delay_s is None else spec.on_delay_s
        rest |= {"points": (point.name, point.readback), "limit": spec.tolerance, "unit": point.unit}
        return [AlarmDefinition(id=f"{point.name}.disagreement", kind="disagreement", priority=priority, **rest)]
    if isinstance(spec, ResidualSpec):
        rest |= {"twin": spec.twin, "sensor": spec.sensor, "limit": spec.high, "unit": "K"}
        return [AlarmDefinition(id=f"{spec.sensor}.residual", kind="residual", priority=priority, **rest)]
    return []  # a sensor's, made for every point


def _links_and_sensors(rig: Rig) -> list[AlarmDefinition]:
    """Return an alarm for the link of each bus, and one for each sensor.

    They are due a tick before the interlocks trip the run. A lost link is one alarm, and not one of every point on it.
    """
    on_delay_s = max(0.0, rig.abort_after_s - rig.period_s)
    priorities = {spec.point: spec.priority for spec in rig.interlock if isinstance(spec, SensorSpec)}
    found = []
    for bus in rig.bus:
        points = [point for point in rig.point if point.bus == bus and point.is_polled]
        if not points:
            continue
        found.append(
            AlarmDefinition(id=f"link.{bus}", kind="link", priority="high", bus=bus, on_delay_s=on_delay_s, drains=True)
        )
        found += [
            AlarmDefinition(
                id=f"{point.name}.sensor",
                kind="sensor",
                priority=priorities.get(point.name) or ("low" if point.alarm is None else "medium"),
                points=(point.name,),
                bus=bus,
                on_delay_s=on_delay_s,
                drains=True,
            )
            for point in points
            if point.kind != "status"
        ]
    return found


def _rigs_own(rig: Rig) -> list[AlarmDefinition]:
    """Return the alarms on the rig's half of the heartbeat."""
    heartbeat, polled = rig.heartbeat, {point.name for point in rig.point if point.is_polled}
    if heartbeat is None:
        return []
    found = []
    if heartbeat.status in polled and heartbeat.status is not None and heartbeat.trip_mask:
        found.append(
            AlarmDefinition(
                id="rig.trip",
                kind="rig_trip",
                priority="critical",
                points=(heartbeat.status,),
                mask=heartbeat.trip_mask,
                off_delay_s=0.0,
                latch=True,
            )
        )
    if heartbeat.counter in polled and heartbeat.counter is not None:
        found.append(
            AlarmDefinition(
                id="rig.counter",
                kind="rig_counter",
                priority="high",
                points=(heartbeat.counter,),
                window_s=heartbeat.timeout_s,
                off_delay_s=0.0,
            )
        )
    return found


def _distinct(definitions: Iterable[AlarmDefinition]) -> list[AlarmDefinition]:
    """Return definitions with a number after each id that is taken already."""
    taken: set[str] = set()
    found = []
    for item in definitions:
        numbered = (f"{item.id}-{number}" for number in itertools.count(2))
        name = next(name for name in itertools.chain([item.id], numbered) if name not in taken)
        taken.add(name)
        found.append(item if name == item.id else item.model_copy(update={"id": name}))
    return found
