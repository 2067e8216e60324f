"""Information model of an OPC UA server: objects of rig and run, a variable a signal, its history from the journal."""

from __future__ import annotations

import asyncio
import dataclasses
import datetime
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from asyncua import Server, ua
from asyncua.common.event_objects import BaseEvent
from asyncua.server.history import HistoryManager, HistoryStorageInterface

from drivers.signals import Quality, Signal
from hil.files import printable
from hil.stream.journal_source import JournalSource
from hil.stream.store import Block, Position, RunEvent, RunIdentity

NAMESPACE = "urn:hil-rig:runs"
"""Namespace of all nodes of this server. Their ids do not name the run, so that a client configured once serves all."""
MOST_VALUES = 5_000
"""Values of a node in one answer about the past; a continuation point leads to the rest. A node takes some 150 kB."""
_CEFACT = "http://www.opcfoundation.org/UA/units/un/cefact"
_COMMON_CODES = {
    "W": "WTT",
    "kW": "KWT",
    "%": "P1",
    "degC": "CEL",
    "K": "KEL",
    "L/min": "L2",
    "m3/h": "MQH",
    "kg/s": "KGS",
    "rpm": "RPM",
    "V": "VLT",
    "A": "AMP",
    "Hz": "HTZ",
    "Pa": "PAL",
    "kPa": "KPA",
    "bar": "BAR",
    "mbar": "MBR",
    "MPa": "MPA",
    "L/s": "G51",
    "L/h": "E32",
    "m/s": "MTS",
    "mV": "2Z",
    "kV": "KVT",
    "mA": "4K",
    "VA": "D46",
    "var": "D44",
    "kJ": "KJO",
    "Wh": "WHR",
    "kWh": "KWH",
    "ohm": "OHM",
    "s": "SEC",
    "ms": "C26",
    "1": "C62",
}
"""Common codes of UN/CEFACT Recommendation 20 by unit; OPC 10000-8, 5.6.3 makes the number of a unit of them."""
_STATUS: dict[int, int] = {
    Quality.GOOD: ua.StatusCodes.Good,
    Quality.STALE: ua.StatusCodes.UncertainLastUsableValue,
    Quality.OUT_OF_RANGE: ua.StatusCodes.UncertainEngineeringUnitsExceeded,
    Quality.SENSOR_FAULT: ua.StatusCodes.BadSensorFailure,
    Quality.LINK_FAULT: ua.StatusCodes.BadNoCommunication,
}
_SEVERITY = {"INFO": 167, "WARN": 500, "ERROR": 833}
"""Middle of the ranges low, medium and high of OPC 10000-5, 6.4.2 by level of an event."""
_READ = 1 << ua.AccessLevel.CurrentRead
_EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
_MICROSECOND = datetime.timedelta(microseconds=1)
_BEFORE_ALL = datetime.datetime(1602, 1, 1, tzinfo=datetime.UTC)
"""Time before every run that is not the one for no time, 1601."""
_PAST = Position(-1, 2**62)
"""Position after every event."""


class RunModel:
    """Nodes of one run in the address space of `server`.

    Parameters
    ----------
    server
        Server with its standard address space.
    run
        Identity of the run.
    """

    def __init__(self, server: Server, run: RunIdentity) -> None:
        self._server, self._run = server, run
        self._index = 0
        self.signals: list[ua.NodeId] = []

    @property
    def run_node(self) -> ua.NodeId:
        """Return the node of the run."""
        return ua.NodeId("run", self._index)

    async def build(self) -> None:
        """Add the objects and variables."""
        self._index = await self._server.register_namespace(NAMESPACE)
        rig = ua.NodeId("rig", self._index)
        self._add_object(rig, ua.NodeId(ua.ObjectIds.ObjectsFolder), ua.ObjectIds.Organizes, self._run.rig, "", 0)
        notifies = 1 << ua.EventNotifier.SubscribeToEvents | 1 << ua.EventNotifier.HistoryRead
        self._add_object(
            self.run_node, rig, ua.ObjectIds.HasComponent, self._run.name, f"Run of {self._run.profile}", notifies
        )
        for name, text in (("uid", self._run.uid), ("profile", self._run.profile)):
            self._add_property(self.run_node, f"run/{name}", name, _text(text), ua.ObjectIds.String)
        self._add_property(self.run_node, "run/period_s", "period_s", self._run.period_s, ua.ObjectIds.Double)
        for name in ("state", "reason"):
            self._add_variable(f"run/{name}", name, "", ua.ObjectIds.String, history=False)
        for signal in self._run.signals:
            self.signals.append(self._add_signal(signal))

    async def show(self, block: Block) -> None:
        """Set the values of all signals to each tick of a block in order, and report its events."""
        for i in range(len(block.tick)):
            for k, node in enumerate(self.signals):
                await self._server.write_attribute_value(node, data_value(block, i, k))
        for event in block.events:
            for source in (self.run_node, ua.NodeId(ua.ObjectIds.Server)):
                report = self.event(event)
                report.emitting_node = source
                await self._server.iserver.subscription_service.trigger_event(report)

    async def show_state(self, name: str, reason: str, time_us: int) -> None:
        """Set state and reason of the run."""
        for part, text in (("state", name), ("reason", reason)):
            value = ua.DataValue(
                ua.Variant(_text(text), ua.VariantType.String),
                SourceTimestamp=_moment(time_us),
                ServerTimestamp=datetime.datetime.now(datetime.UTC),
            )
            await self._server.write_attribute_value(ua.NodeId(f"run/{part}", self._index), value)

    def event(self, row: RunEvent) -> Any:
        """Return an event of the run; its id is the same whenever it is read."""
        made: Any = BaseEvent(self.run_node, _text(row.text), _SEVERITY.get(row.level, _SEVERITY["INFO"]))
        made.EventId = f"{self._run.uid}/{row.id}".encode("utf-8", "replace")
        made.SourceName = _text(self._run.name)
        made.Time = made.ReceiveTime = _moment(row.time_us)
        made.emitting_node = self.run_node
        return made

    def _add_signal(self, signal: Signal) -> ua.NodeId:
        node = self._add_variable(
            f"signal/{signal.column}", signal.column, signal.doc, ua.ObjectIds.Double, history=True
        )
        self._add_property(
            node, f"signal/{signal.column}/unit", "EngineeringUnits", unit_of(signal.unit), ua.ObjectIds.EUInformation
        )
        if signal.plausible is not None:
            low, high = signal.plausible
            limits = ua.Range(Low=low, High=high)
            self._add_property(node, f"signal/{signal.column}/range", "EURange", limits, ua.ObjectIds.Range)
        self._add_property(node, f"signal/{signal.column}/kind", "kind", signal.kind, ua.ObjectIds.String)
        return node

    def _add_object(
        self, node: ua.NodeId, parent: ua.NodeId, reference: int, name: str, description: str, notifies: int
    ) -> None:
        attributes = ua.ObjectAttributes(
            DisplayName=ua.LocalizedText(_text(name)),
            Description=ua.LocalizedText(_text(description)),
            EventNotifier=notifies,
        )
        self._add(node, parent, reference, name, ua.NodeClass.Object, (ua.ObjectIds.BaseObjectType, attributes))

    def _add_variable(self, identifier: str, name: str, description: str, kind: int, *, history: bool) -> ua.NodeId:
        node = ua.NodeId(identifier, self._index)
        access = _READ | (1 << ua.AccessLevel.HistoryRead if history else 0)
        attributes = ua.VariableAttributes(
            DisplayName=ua.LocalizedText(_text(name)),
            Description=ua.LocalizedText(_text(description)),
            Value=ua.Variant(math.nan if history else "", ua.VariantType(kind)),
            DataType=ua.NodeId(kind),
            ValueRank=ua.ValueRank.Scalar,
            AccessLevel=access,
            UserAccessLevel=access,
            MinimumSamplingInterval=1e3 * self._run.period_s if history else 0.0,
            Historizing=history,
        )
        of = ua.ObjectIds.BaseAnalogType if history else ua.ObjectIds.BaseDataVariableType
        self._add(node, self.run_node, ua.ObjectIds.HasComponent, name, ua.NodeClass.Variable, (of, attributes))
        return node

    def _add_property(self, parent: ua.NodeId, identifier: str, name: str, value: Any, kind: int) -> None:
        node = ua.NodeId(identifier, self._index)
        is_structure = kind in (ua.ObjectIds.EUInformation, ua.ObjectIds.Range)
        variant = ua.VariantType.ExtensionObject if is_structure else ua.VariantType(kind)
        attributes = ua.VariableAttributes(
            DisplayName=ua.LocalizedText(name),
            Value=ua.Variant(value, variant),
            DataType=ua.NodeId(kind),
            ValueRank=ua.ValueRank.Scalar,
            AccessLevel=_READ,
            UserAccessLevel=_READ,
        )
        # Names of the standard are those of its own namespace, 0.
        known = 0 if is_structure else self._index
        self._add(
            node,
            parent,
            ua.ObjectIds.HasProperty,
            ua.QualifiedName(name, known),
            ua.NodeClass.Variable,
            (ua.ObjectIds.PropertyType, attributes),
        )

    def _add(
        self,
        node: ua.NodeId,
        parent: ua.NodeId,
        reference: int,
        name: str | ua.QualifiedName,
        of_class: ua.NodeClass,
        type_and_attributes: tuple[int, Any],
    ) -> None:
        of_type, attributes = type_and_attributes
        item = ua.AddNodesItem(
            ParentNodeId=parent,
            ReferenceTypeId=ua.NodeId(reference),
            RequestedNewNodeId=node,
            BrowseName=name if isinstance(name, ua.QualifiedName) else ua.QualifiedName(_text(name), self._index),
            NodeClass=of_class,
            NodeAttributes=attributes,
            TypeDefinition=ua.NodeId(of_type),
        )
        for result in self._server.iserver.node_mgt_service.add_nodes([item]):
            result.StatusCode.check()


class BackwardHistory(HistoryManager):
    """Reader of the past that goes on backwards where a client gave the last time alone.

    asyncua puts the time of a continuation point in place of the first time, and would turn round.
    """

    async def _read_datavalue_history(self, rv: ua.HistoryReadValueId, details: ua.ReadRawModifiedDetails) -> Any:
        first, last = _microseconds(details.StartTime), _microseconds(details.EndTime)
        if rv.ContinuationPoint and first is None and last is not None:
            details = dataclasses.replace(details, EndTime=_BEFORE_ALL)
        return await super()._read_datavalue_history(rv, details)


class JournalHistory(HistoryStorageInterface):
    """Past of a run, read from its journal when a client asks. Nothing is stored a second time.

    Parameters
    ----------
    folder
        Run folder.
    model
        Nodes of the run.
    """

    def __init__(self, folder: Path, model: RunModel) -> None:
        super().__init__(MOST_VALUES)
        self._folder, self._model = folder, model
        self._opened: JournalSource | None = None

    async def init(self) -> None:
        """Do nothing: the journal is opened by the first client that asks."""

    async def read_node_history(
        self, node_id: ua.NodeId, start: datetime.datetime | None, end: datetime.datetime | None, nb_values: int
    ) -> tuple[list[ua.DataValue], datetime.datetime | None]:
        """Return values of a signal by OPC 10000-11, 6.5.3: `start` included, `end` not, backwards if `end` is earlier.

        The second result is the time of the next value where there are more.
        """
        await asyncio.sleep(0)  # other clients come first after each node
        if node_id not in self._model.signals:
            return [], None
        k, limit = self._model.signals.index(node_id), min(nb_values or MOST_VALUES, MOST_VALUES)
        values: list[ua.DataValue] = []
        for block, i in self._ticks(start, end, limit + 1):
            if len(values) == limit:
                return values, _moment(int(block.time_us[i]))
            values.append(data_value(block, i, k))
        return values, None

    async def read_event_history(
        self,
        source_id: ua.NodeId,
        start: datetime.datetime | None,
        end: datetime.datetime | None,
        nb_values: int,
        evfilter: ua.EventFilter,
    ) -> tuple[list[Any], datetime.datetime | None]:
        """Return events of the run in the same way; all of them fit into one answer."""
        if source_id not in (self._model.run_node, ua.NodeId(ua.ObjectIds.Server)):
            return [], None
        first, last, forward = _bounds(start, end)
        events = self._source().read(Position(2**62, 0), 1, ended=True).events
        found = [event for event in events if _is_within(event.time_us, first, last, forward)]
        ordered = found if forward else found[::-1]
        return [self._model.event(event) for event in ordered[: nb_values or None]], None

    async def new_historized_node(self, node_id: ua.NodeId, period: Any, count: int = 0) -> None:
        """Do nothing: the journal has all nodes."""

    async def save_node_value(self, node_id: ua.NodeId, datavalue: ua.DataValue) -> None:
        """Do nothing: the run itself writes the journal."""

    async def new_historized_event(self, source_id: ua.NodeId, evtypes: Any, period: Any, count: int = 0) -> None:
        """Do nothing: the journal has all events."""

    async def save_event(self, event: Any) -> None:
        """Do nothing: the run itself writes the journal."""

    async def stop(self) -> None:
        """Close the journal."""
        if self._opened is not None:
            self._opened.close()
            self._opened = None

    def _source(self) -> JournalSource:
        """Return the open journal, of the thread that serves clients."""
        if self._opened is None:
            self._opened = JournalSource(self._folder)
        return self._opened

    def _ticks(
        self, start: datetime.datetime | None, end: datetime.datetime | None, limit: int
    ) -> Iterator[tuple[Block, int]]:
        """Return block and row of at most `limit` ticks within a time, in its direction."""
        source = self._source()
        first, last, forward = _bounds(start, end)

        def read(tick: int, rows: int) -> Block:
            return source.read(Position(tick, _PAST.event), rows, ended=False)

        if forward:
            block = read(source.tick_before(first), limit)
            rows = np.arange(len(block.tick))
        else:
            top = source.tick_before(first + 1)
            span = limit
            while True:
                block = read(max(top - span, -1), span)
                rows = np.flatnonzero(block.tick <= top)[::-1]
                if len(rows) >= limit or top - span <= -1:
                    break
                span *= 4  # ticks are missing there
        for i in rows[:limit].tolist():
            if not _is_within(int(block.time_us[i]), first, last, forward):
                return
            yield block, i


def data_value(block: Block, i: int, k: int) -> ua.DataValue:
    """Return row `i` of signal `k`: value, status by its quality, time of the sample.

    A value that is stale or out of range is there as it was received, with status Uncertain; one of a failed sensor or
    link is not.
    """
    status = _STATUS.get(int(block.quality[i, k]), ua.StatusCodes.Bad)
    value = float(block.received[i, k])
    if not math.isfinite(value) and not ua.StatusCode(status).is_bad():
        status = ua.StatusCodes.BadNoData
    code = ua.StatusCode(status)
    return ua.DataValue(
        ua.Variant(None, ua.VariantType.Null) if code.is_bad() else ua.Variant(value, ua.VariantType.Double),
        code,
        SourceTimestamp=_moment(int(block.time_us[i])),
        ServerTimestamp=datetime.datetime.now(datetime.UTC),
    )


def unit_of(unit: str) -> ua.EUInformation:
    """Return the description of a unit, with its number by UN/CEFACT Recommendation 20; -1 for one that has none."""
    code = _COMMON_CODES.get(unit)
    return ua.EUInformation(
        NamespaceUri=_CEFACT if code else NAMESPACE,
        UnitId=int.from_bytes(code.encode("ascii"), "big") if code else -1,
        DisplayName=ua.LocalizedText(_text(unit)),
        Description=ua.LocalizedText(_text(unit)),
    )


def _bounds(start: datetime.datetime | None, end: datetime.datetime | None) -> tuple[int, int | None, bool]:
    """Return first and last time, µs since 1970, and True for a read forwards; a last time of None is no bound."""
    first, last = _microseconds(start), _microseconds(end)
    if first is None:
        return (-(2**62), None, True) if last is None else (last, None, False)
    return first, last, last is None or last >= first


def _is_within(time_us: int, first: int, last: int | None, forward: bool) -> bool:
    """Return True for a time between the bounds: the first is included, the last only where both are equal."""
    if forward:
        return time_us >= first and (last is None or time_us < last or time_us == first == last)
    return time_us <= first and (last is None or time_us > last)


def _microseconds(moment: datetime.datetime | None) -> int | None:
    """Return a time in µs since 1970; None for the time that stands for none, the first one of OPC UA."""
    if moment is None:
        return None
    moment = moment if moment.tzinfo is not None else moment.replace(tzinfo=datetime.UTC)
    return None if moment.year <= 1601 else (moment - _EPOCH) // _MICROSECOND


def _moment(time_us: int) -> datetime.datetime:
    return _EPOCH + datetime.timedelta(microseconds=time_us)


def _text(text: str) -> str:
    """Return text without lone surrogates."""
    return printable(text)
