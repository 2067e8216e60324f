"""Streams to PostgreSQL: tables against the journal, kills, a server that goes away, refusals, the dashboard."""

from __future__ import annotations

import json
import re
import socket
import threading
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.drivers.postgres_server import Server, emptied, serving
from tests.hil.command_line import typed
from tests.hil.mosquitto_broker import until
from tests.hil.streamed_run import NAME, InThread, StreamedRun, finished_run, killed_at_the_end, live_run

psycopg = pytest.importorskip("psycopg", reason="psycopg is not installed")
PROJECT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    yield from serving()


@pytest.fixture
def database(server: Server) -> str:
    """URL of an empty database."""
    return emptied(server, "rigs")


def _rows(url: str, query: str) -> list[tuple[Any, ...]]:
    with psycopg.connect(url) as base:
        found: list[tuple[Any, ...]] = base.execute(query).fetchall()
        return found


def _samples(url: str) -> Counter[Any]:
    """Return name, time in µs, value and quality of each row."""
    query = (
        "SELECT name, (extract(epoch FROM time) * 1000000)::bigint, value, quality FROM hil_samples "
        "JOIN hil_signals USING (run, signal)"
    )
    return Counter(_rows(url, query))


def _expected(run: StreamedRun) -> Counter[Any]:
    return Counter((*key, *row) for key, row in run.samples().items())


def _position(url: str) -> int:
    if _rows(url, "SELECT to_regclass('hil_runs')") == [(None,)]:
        return -1
    return int(_rows(url, "SELECT coalesce(max(position), -1) FROM hil_runs")[0][0])


def test_a_finished_run_has_each_sample_event_and_signal_once(database: str, tmp_path: Path) -> None:
    run = finished_run(tmp_path, 200)
    done = typed("stream", run.path, "--to", database)
    assert (done.returncode, done.stderr) == (0, "")
    assert "200 ticks and 2 events, run done" in done.stdout
    assert _samples(database) == _expected(run)
    assert _rows(database, "SELECT name, profile, state, position FROM hil_runs") == [(NAME, "battle_40h", "done", 199)]
    assert ("T_tank_C", "degC", "measured") in _rows(database, "SELECT name, unit, kind FROM hil_signals")
    assert _rows(database, "SELECT event, level, text, extract(epoch FROM time)::float FROM hil_events ORDER BY 1") == [
        (1, "INFO", "run started", run.started_s),
        (2, "WARN", "tick 200", run.started_s + 199),
    ]
    assert ("brin",) in _rows(
        database, "SELECT amname FROM pg_class JOIN pg_am ON relam = pg_am.oid WHERE relname = 'hil_samples_time'"
    )
    again = typed("stream", run.path, "--to", database)
    assert "0 ticks and 0 events" in again.stdout
    assert _samples(database) == _expected(run)


def test_a_killed_stream_of_a_live_run_goes_on_without_gap_and_double(database: str, tmp_path: Path) -> None:
    run = live_run(tmp_path, 500)
    run.write(100)
    with killed_at_the_end(run, "--to", database):
        until(lambda: _position(database) >= 99, "the first ticks came")
        run.write(300)
    assert _position(database) < 499
    run.finish()
    done = typed("stream", run.path, "--to", database)
    assert done.returncode == 0, done.stderr
    assert _samples(database) == _expected(run)
    assert len(_rows(database, "SELECT * FROM hil_events")) == 4


def test_a_server_that_goes_away_gets_the_rest_when_it_is_back(
    database: str, server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hil.stream.session.RETRY_S", 0.1)
    run = live_run(tmp_path, 300)
    run.write(100)
    server.stop()
    stream = InThread(run, database)
    until(lambda: stream.said, "it says that the server is down")
    server.start()
    until(lambda: _position(database) >= 99, "the first ticks came")
    server.stop()
    run.write(100)
    until(lambda: any("went away" in said for said in stream.said), "it says that the server went away")
    server.start()
    run.finish()
    assert stream.result().ticks == 300
    assert _samples(database) == _expected(run)
    assert not any(server.password in said for said in stream.said)


def test_a_crash_between_rows_and_commit_leaves_nothing_behind(
    database: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hil.stream.session.RETRY_S", 0.0)
    monkeypatch.setattr("hil.stream.postgres_store.ROWS", 19 * 50)
    run = finished_run(tmp_path, 200)
    commit, calls = psycopg.Connection.commit, []

    def failing(self: Any) -> None:
        calls.append(1)
        if len(calls) in (3, 6):  # after the rows of a block
            self.close()
            raise psycopg.OperationalError("server closed the connection unexpectedly")
        commit(self)

    monkeypatch.setattr(psycopg.Connection, "commit", failing)
    done = typed("stream", run.path, "--to", database)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("went away") == 2
    assert _samples(database) == _expected(run)


def test_two_streams_of_one_run_store_each_sample_once(
    database: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hil.stream.postgres_store.ROWS", 19 * 10)
    run = finished_run(tmp_path, 200)
    streams = [InThread(run, database) for _ in range(2)]
    assert [stream.result().state for stream in streams] == ["done", "done"]
    assert _samples(database) == _expected(run)
    assert threading.active_count() < 50


def test_two_runs_share_the_tables(database: str, tmp_path: Path) -> None:
    for name in "ab":
        (tmp_path / name).mkdir()
        assert typed("stream", finished_run(tmp_path / name, 3).path, "--to", database).returncode == 0
    assert _rows(database, "SELECT count(*) FROM hil_runs") == [(2,)]
    assert _rows(database, "SELECT count(DISTINCT signal) FROM hil_samples") == [(2 * 19,)]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("correct%20horse", "battery%20staple"), "the server refused the password; check user and password"),
        (("/rigs", "/absent"), 'database "absent" does not exist'),
    ],
)
def test_a_wrong_password_or_database_is_one_sentence(
    database: str, tmp_path: Path, change: tuple[str, str], said: str
) -> None:
    run = finished_run(tmp_path, 3)
    done = typed("stream", run.path, "--to", database.replace(*change))
    assert done.returncode == 2
    assert said in done.stderr and len(done.stderr.splitlines()) == 1
    for secret in ("correct", "battery"):
        assert secret not in done.stderr


def test_an_unknown_host_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(*_arguments: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", lost)
    done = typed("stream", finished_run(tmp_path, 3).path, "--to", "postgresql://u:s3cret@lost.example.org/rigs")
    assert (done.returncode, done.stderr) == (2, "hil: there is no host 'lost.example.org'; check the address\n")


def test_options_of_mqtt_and_tables_of_others_are_refused(database: str, tmp_path: Path) -> None:
    run = finished_run(tmp_path, 3)
    done = typed("stream", run.path, "--to", database, "--all")
    assert done.returncode == 2 and "a database gets every sample" in done.stderr
    with psycopg.connect(database) as base:
        base.execute("CREATE TABLE hil_runs (other text)")
    done = typed("stream", run.path, "--to", database)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
    done = typed("stream", run.path, "--to", "postgresql://u:s3cret@[/x")
    assert (done.returncode, "s3cret" in done.stderr) == (2, False)
    assert "the address of the database cannot be read" in done.stderr


def test_the_queries_of_the_dashboards_answer(database: str, tmp_path: Path) -> None:
    run = finished_run(tmp_path, 30)
    assert typed("stream", run.path, "--to", database).returncode == 0
    for path in (PROJECT / "profiles" / "grafana").glob("*.json"):
        document = json.loads(path.read_text(encoding="utf-8"))
        queries = [(target["rawSql"], panel["type"]) for panel in document["panels"] for target in panel["targets"]]
        queries += [(v["query"], v["type"]) for v in document["templating"]["list"] if v["type"] == "query"]
        assert len(queries) >= 5
        for query, kind in queries:
            filled = re.sub(r"\$__timeFilter\((\w+(\.\w+)?)\)", r"\1 IS NOT NULL", query)
            filled = filled.replace("${run}", "1").replace("${signals:sqlstring}", "'T_tank_C', 'flow_L_per_min'")
            assert "$" not in filled, query
            with psycopg.connect(database) as base:
                answer = base.execute(filled)
                rows, columns = answer.fetchall(), [column.name for column in answer.description or ()]
            assert rows, query
            if kind == "timeseries":  # the form from which Grafana makes a curve for each metric
                assert columns == ["time", "metric", "value"] and sorted(rows, key=lambda row: row[0]) == rows
                assert {row[1] for row in rows} == {"T_tank_C, degC", "flow_L_per_min, L/min"}
            if kind == "stat":
                assert len(rows) == len(columns) == 1
