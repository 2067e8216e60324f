"""A run that is served by OPC UA: values, units, quality and past as clients read them, reconnection."""

from __future__ import annotations

import asyncio
import datetime
import json
import math
import os
import signal
import socket
import subprocess
import sys
from collections import Counter
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import pytest_asyncio

from tests.hil.opcua_peers import CLIENT_OF_NODE, Server, node_modules, served
from tests.hil.streamed_run import NAME, StreamedRun, finished_run, live_run

pytest.importorskip("asyncua", reason="asyncua is not installed")

from asyncua import Client, Node, ua
from asyncua.ua.uaerrors import BadUserAccessDenied

from drivers.signals import Quality
from hil.journal import JournalReader
from hil.stream import opcua_model, opcua_store

NAMESPACE = "urn:hil-rig:runs"
STATUS = {
    Quality.GOOD: "Good",
    Quality.STALE: "UncertainLastUsableValue",
    Quality.OUT_OF_RANGE: "UncertainEngineeringUnitsExceeded",
    Quality.SENSOR_FAULT: "BadSensorFailure",
    Quality.LINK_FAULT: "BadNoCommunication",
}
Sample = tuple[str, int, float | None, str]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> StreamedRun:
    return finished_run(tmp_path_factory.mktemp("finished"), 120)


@pytest.fixture(scope="module")
def server(finished: StreamedRun) -> Iterator[Server]:
    with served(finished) as made:
        yield made


@pytest_asyncio.fixture
async def client(server: Server) -> AsyncIterator[Client]:
    async with Client(server.url) as made:
        yield made


async def _node(client: Client, identifier: str) -> Node:
    return client.get_node(ua.NodeId(identifier, await client.get_namespace_index(NAMESPACE)))


async def _signal(client: Client, column: str) -> Node:
    return await _node(client, f"signal/{column}")


def _sample(column: str, value: ua.DataValue) -> Sample:
    assert value.SourceTimestamp is not None and value.StatusCode is not None and value.Value is not None
    return column, _us(value.SourceTimestamp), value.Value.Value, value.StatusCode.name


def _us(moment: datetime.datetime) -> int:
    return round(moment.replace(tzinfo=moment.tzinfo or datetime.UTC).timestamp() * 1e6)


def _expected(run: StreamedRun) -> Counter[Sample]:
    """Return each sample of the journal as a client has to see it."""
    reader = JournalReader(run.path / "journal.sqlite")
    found, columns = reader.samples(), [one.column for one in reader.header.signals]
    reader.close()
    expected: Counter[Sample] = Counter()
    for i in range(len(found.tick)):
        for k, column in enumerate(columns):
            status, value = STATUS[Quality(int(found.quality[i, k]))], float(found.values[i, k])
            missing = status.startswith("Bad") or not math.isfinite(value)
            at = round((run.started_s + found.time_s[i]) * 1e6)
            expected[
                column, at, None if missing else value, status if status != "Good" or not missing else "BadNoData"
            ] = 1
    return expected


async def _past(client: Client, run: StreamedRun, after_us: int | None = None) -> list[Sample]:
    start = None if after_us is None else opcua_model._moment(after_us + 1)
    return [
        _sample(column, value)
        for column in (one.column for one in run.truth.header.signals)
        for value in await (await _signal(client, column)).read_raw_history(start)
    ]


async def test_the_past_has_each_sample_of_the_journal_once_with_value_time_and_quality(
    client: Client, finished: StreamedRun
) -> None:
    found = Counter(await _past(client, finished))
    assert found == _expected(finished)
    statuses = {sample[3] for sample in found}
    assert {"Good", "UncertainLastUsableValue", "BadSensorFailure", "BadNoCommunication"} <= statuses


async def test_a_variable_has_the_last_value_its_unit_its_range_and_its_place(
    client: Client, finished: StreamedRun
) -> None:
    index = await client.get_namespace_index(NAMESPACE)
    path = ["0:Objects", f"{index}:rig", f"{index}:{NAME}", f"{index}:T_tank_C"]
    node = await client.nodes.root.get_child(path)
    assert node == await _signal(client, "T_tank_C")
    last = _sample("T_tank_C", await node.read_data_value())
    assert last in _expected(finished) and last[1] == round((finished.started_s + 119) * 1e6)
    unit = await (await node.get_child("0:EngineeringUnits")).read_value()
    assert (unit.UnitId, unit.DisplayName.Text) == (4408652, "degC")  # CEL: the number that OPC 10000-8 has
    assert await (await node.get_child(f"{index}:kind")).read_value() == "measured"
    assert await (await _node(client, "run/state")).read_value() == "done"
    assert await (await _node(client, "run/reason")).read_value() == "profile over"
    assert await (await _node(client, "run/period_s")).read_value() == 1.0
    children = {(await one.read_browse_name()).Name for one in await (await _node(client, "run")).get_children()}
    assert {one.column for one in finished.truth.header.signals} <= children


def test_every_unit_of_a_rig_file_has_a_number_of_its_own() -> None:
    from drivers.signals.units import SUFFIX_OF_UNIT

    numbers = {unit: opcua_model.unit_of(unit).UnitId for unit in SUFFIX_OF_UNIT}
    assert min(numbers.values()) > 0 and len(set(numbers.values())) == len(numbers)
    # Numbers that other makers publish for the same units.
    assert (numbers["W"], numbers["bar"], numbers["m3/h"], numbers["kg/s"]) == (5723220, 4342098, 5067080, 4933459)
    assert opcua_model.unit_of("furlong").UnitId == -1


async def test_a_client_changes_nothing(client: Client, finished: StreamedRun) -> None:
    node = await _signal(client, "heater_power_set_W")
    before = await node.read_value()
    with pytest.raises(BadUserAccessDenied):
        await node.write_value(1.0)
    with pytest.raises(BadUserAccessDenied):
        await node.write_attribute(ua.AttributeIds.DisplayName, ua.DataValue(ua.LocalizedText("mine")))
    with pytest.raises(BadUserAccessDenied):
        await client.nodes.objects.add_variable(2, "mine", 1.0)
    with pytest.raises(BadUserAccessDenied):
        await client.delete_nodes([node])
    with pytest.raises(BadUserAccessDenied):
        await client.nodes.server.call_method(ua.NodeId(ua.ObjectIds.Server_GetMonitoredItems), 1)
    assert await node.read_value() == before
    access = await node.get_access_level()
    assert access == {ua.AccessLevel.CurrentRead, ua.AccessLevel.HistoryRead}


async def test_the_past_is_read_within_bounds_in_both_directions(client: Client, finished: StreamedRun) -> None:
    node = await _signal(client, "heartbeat")
    at = {tick: opcua_model._moment(round((finished.started_s + tick) * 1e6)) for tick in range(121)}

    async def ticks(start: int | None, end: int | None, most: int = 0) -> list[int]:
        found = await node.read_raw_history(
            None if start is None else at[start], None if end is None else at[end], most
        )
        return [_us(one.SourceTimestamp or at[0]) // 1_000_000 - int(finished.started_s) for one in found]

    assert await ticks(10, 14) == [10, 11, 12, 13]
    assert await ticks(14, 10) == [14, 13, 12, 11]
    assert await ticks(10, 10) == [10]
    assert await ticks(118, None) == [118, 119]
    assert await ticks(None, 3) == [3, 2, 1, 0]
    assert await ticks(None, 50, 3) == [50, 49, 48]
    assert await ticks(5, None, 3) == [5, 6, 7]
    assert await ticks(120, None) == []
    assert await ticks(None, 120, 1) == [119]


@pytest.mark.parametrize(
    ("start", "end", "expected"),
    [(None, 119, range(119, -1, -1)), (119, 0, range(119, 0, -1)), (0, None, range(120)), (None, None, range(120))],
)
async def test_a_client_that_takes_the_past_in_parts_gets_each_tick_once(
    client: Client, finished: StreamedRun, start: int | None, end: int | None, expected: range
) -> None:
    def moment(tick: int | None) -> datetime.datetime:
        return ua.get_win_epoch() if tick is None else opcua_model._moment(round((finished.started_s + tick) * 1e6))

    node = await _signal(client, "heartbeat")
    details = ua.ReadRawModifiedDetails(StartTime=moment(start), EndTime=moment(end), NumValuesPerNode=50)
    found: list[int] = []
    point = None
    for _ in range(3):
        result = await node.history_read(details, point)
        values = result.HistoryData.DataValues
        assert len(values) <= 50
        found += [_us(one.SourceTimestamp) // 1_000_000 - int(finished.started_s) for one in values]
        point = result.ContinuationPoint
    assert point is None and found == list(expected)


async def test_a_long_past_comes_in_parts(finished: StreamedRun, monkeypatch: pytest.MonkeyPatch) -> None:
    model = SimpleNamespace(signals=[ua.NodeId(one.column, 2) for one in finished.truth.header.signals])
    monkeypatch.setattr(opcua_model, "MOST_VALUES", 50)
    history = opcua_model.JournalHistory(finished.path, model)
    try:
        first, last = opcua_model._moment(0), opcua_model._moment(4 * 10**15)
        for start, end in ((first, last), (last, first)):
            found, after, parts = [], start, 0
            while after is not None:
                values, after = await history.read_node_history(model.signals[-2], after, end, 0)
                assert len(values) <= 50
                found += [_us(one.SourceTimestamp or first) for one in values]
                parts += 1
            assert parts == 3 and len(set(found)) == len(found) == 120
            assert found == sorted(found, reverse=start is last)
        assert await history.read_node_history(ua.NodeId("other", 2), first, last, 0) == ([], None)
    finally:
        await history.stop()


async def test_events_of_the_run_are_in_the_past(client: Client) -> None:
    run = await _node(client, "run")
    found = await run.read_event_history(None, None, 0, ua.ObjectIds.BaseEventType)
    assert [(one.Message.Text, one.Severity) for one in found] == [("run started", 167), ("tick 120", 500)]
    assert len({one.EventId for one in found}) == 2


class _Kept:
    """Handler of a subscription that keeps each notification."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []
        self.events: list[str] = []

    def datachange_notification(self, node: Node, _value: Any, data: Any) -> None:
        name = str(node.nodeid.Identifier)
        if name.startswith("signal/"):
            self.samples.append(_sample(name.removeprefix("signal/"), data.monitored_item.Value))

    def event_notification(self, event: Any) -> None:
        self.events.append(event.Message.Text)


async def _subscribed(client: Client, run: StreamedRun) -> _Kept:
    """Subscribe to every sample of all signals and to the events of the run."""
    kept = _Kept()
    subscription = await client.create_subscription(50, kept)
    nodes = [await _signal(client, one.column) for one in run.truth.header.signals]
    every = ua.DataChangeFilter(Trigger=ua.DataChangeTrigger.StatusValueTimestamp)
    await subscription._subscribe(nodes, mfilter=every, queuesize=1000)
    await subscription.subscribe_events(await _node(client, "run"))
    return kept


async def _until(condition: Any, what: str) -> None:
    for _ in range(600):
        if condition():
            return
        await asyncio.sleep(0.05)
    raise AssertionError(f"in vain: {what}")


async def test_a_live_run_reaches_a_subscriber_once_and_one_that_comes_back_misses_nothing(tmp_path: Path) -> None:
    run = live_run(tmp_path, 40)
    run.write(5)
    columns = len(run.truth.header.signals)
    with served(run) as server:
        async with Client(server.url) as client:
            kept = await _subscribed(client, run)
            await _until(lambda: len(kept.samples) == columns, "the present values come")
            run.write(10)
            await _until(lambda: len(kept.samples) >= 11 * columns, "ten ticks come")
            assert kept.events == ["tick 15"]
            seen = list(kept.samples)
            assert max(Counter(seen).values()) == 1
            assert len({sample[1] for sample in seen}) == 11, "the last tick before, and ten"
        run.write(10)
        server.process.kill()
    run.write(5)
    with served(run) as server:
        async with Client(server.url) as client:
            kept = await _subscribed(client, run)
            await _until(lambda: len(kept.samples) == columns, "the present values come")
            run.finish()
            await _until(lambda: len({sample[1] for sample in kept.samples}) == 11, "the rest comes")
            last = max(sample[1] for sample in seen)
            missed = await _past(client, run, last)
            assert Counter(seen + missed) == {
                sample: 1 for sample in _expected(run) if sample[1] >= min(one[1] for one in seen)
            }
            assert max(Counter(kept.samples).values()) == 1 and set(kept.samples) <= set(missed)
            assert Counter(await _past(client, run)) == _expected(run)
            state = await _node(client, "run/state")
            for _ in range(100):
                if await state.read_value() == "done":
                    break
                await asyncio.sleep(0.05)
            assert await state.read_value() == "done"
        code, printed = server.interrupt()
    assert code == 130 and "was stopped; start it again to go on" in printed
    assert len(printed.splitlines()) == 1


STALLING = """
import asyncio, sys
from asyncua import Client, ua
async def main():
    async with Client(sys.argv[1]) as client:
        index = await client.get_namespace_index("urn:hil-rig:runs")
        handler = type("Handler", (), {"datachange_notification": lambda *_: None})()
        subscription = await client.create_subscription(50, handler)
        await subscription.subscribe_data_change(client.get_node(f"ns={index};s=signal/heartbeat"))
        print("ready", flush=True)
        await asyncio.sleep(3600)
asyncio.run(main())
"""


async def test_a_client_that_stalls_keeps_no_other_from_its_samples(tmp_path: Path) -> None:
    run = live_run(tmp_path, 40)
    run.write(5)
    with served(run) as server:
        stalled = await asyncio.create_subprocess_exec(
            sys.executable, "-c", STALLING, server.url, stdout=asyncio.subprocess.PIPE
        )
        try:
            assert stalled.stdout is not None and await stalled.stdout.readline() == b"ready\n"
            stalled.send_signal(signal.SIGSTOP)
            async with Client(server.url) as client:
                kept = await _subscribed(client, run)
                run.write(20)
                await _until(lambda: len({sample[1] for sample in kept.samples}) == 21, "all ticks come")
            code, _ = server.interrupt()
            assert code == 130, "it ends in spite of the client"
        finally:
            stalled.kill()
            await stalled.wait()
    run.finish()


async def test_a_connection_whose_client_does_not_read_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opcua_store, "MOST_UNREAD_BYTES", 1_000_000)
    monkeypatch.setattr(opcua_store, "CHECK_S", 0.02)
    writers: list[asyncio.StreamWriter] = []
    listener = await asyncio.start_server(lambda _reader, writer: writers.append(writer), "127.0.0.1", 0)
    port = listener.sockets[0].getsockname()[1]
    clients = [socket.create_connection(("127.0.0.1", port)) for _ in range(2)]
    await _until(lambda: len(writers) == 2, "both are connected")
    inner = SimpleNamespace(asyncio_transports=[writer.transport for writer in writers])
    watch = asyncio.ensure_future(opcua_store._cut_clients_that_stall(SimpleNamespace(iserver=inner)))
    writers[0].write(bytes(100_000))
    writers[1].write(bytes(50_000_000))
    await _until(lambda: writers[1].transport.is_closing(), "the connection is cut")
    assert not writers[0].transport.is_closing()
    watch.cancel()
    for client in clients:
        client.close()
    writers[0].transport.abort()
    listener.close()
    await listener.wait_closed()


def test_a_client_of_another_maker_reads_the_same(server: Server, finished: StreamedRun, tmp_path: Path) -> None:
    modules = node_modules()
    if modules is None:
        pytest.skip("node-opcua-client is not installed (npm install --global node-opcua-client)")
    done = subprocess.run(
        ["node", "-e", CLIENT_OF_NODE, server.url],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, "NODE_PATH": modules, "HOME": str(tmp_path)},
    )
    assert done.returncode == 0, done.stderr
    answer = json.loads(next(line for line in done.stdout.splitlines() if line.startswith("{")))
    expected = {sample for sample in _expected(finished) if sample[0] == "T_tank_C"}
    past = {("T_tank_C", 1000 * at, value, status) for at, value, status in answer["past"]}
    assert past == expected and len(answer["past"]) == len(expected)
    last = ("T_tank_C", 1000 * answer["time"], answer["value"], answer["status"])
    assert last == max(expected, key=lambda sample: sample[1])
    assert (answer["unit"], answer["state"]) == (4408652, "done")
    assert "BadUserAccessDenied" in answer["written"]
