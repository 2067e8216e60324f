"""A diagnosis while the run goes on: it says what is news, waits for nobody's tick, and adopts only what is sure."""

from __future__ import annotations

import asyncio
import json
import math
import sqlite3
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.signals.points import ConfigurationError, Signal
from hil.diagnosis.live import (
    InterimFinding,
    LiveConfig,
    LiveDiagnosis,
    Reply,
    changed,
    interim_finding,
    interval_of,
    refusal,
)
from hil.diagnosis.results import whole_results
from hil.diagnosis.store import has_diagnosis
from hil.journal.writer import Header, JournalReader, JournalWriter
from hil.review import read_columns, read_words
from hil.run.session.interrupted_run import request_of
from hil.run.session.manifest import settings_of
from hil.run.session.request import RunRequest
from hil.run_folder.folder import RunFolder, create_run_folder, new_manifest
from hil.run_folder.room import RunSize
from tests.hil.command_line import typed
from tests.hil.made_diagnosis import SAYS, effect, made
from tests.hil.slow_period import slow_period_rig
from twin.discovery.diagnosis import SensorError
from twin.network import Network
from twin.twinfile import load

PROJECT = Path(__file__).resolve().parents[2]
TWIN = PROJECT / "profiles" / "twins" / "virtual.toml"
LOAD = """time_s,heater_power_W,pump_speed_pct,fan_speed_pct
0,700,100,70
1800,900,85,70
3600,650,100,100
5400,850,85,80
{end},850,85,80
"""
PERIOD_S = 5.0
LAST_S = 7400
"""Just beyond the second hour, at which it is diagnosed while it goes on."""
HEAT = '[[effect]]\nkind = "heat_source"\nwhere = "modules"\ndriver = "constant"\npower_W = 180\nonset_s = 1805\n'


def found(**changes: Any) -> InterimFinding:
    return interim_finding(made(effects=(effect(**changes),)), 10_000.0)


@pytest.mark.parametrize(
    ("text", "seconds"), [("hourly", 3600.0), ("30min", 1800.0), ("2h", 7200.0), ("1.5 h", 5400), ("end", math.inf)]
)
def test_intervals_as_they_are_written(text, seconds):
    assert interval_of(text) == seconds


@pytest.mark.parametrize("text", ["", "soon", "30", "0h", "30s", "-1h"])
def test_another_interval_is_one_sentence(text):
    with pytest.raises(ConfigurationError, match="hourly, 30min or 2h"):
        interval_of(text)


def test_only_news_is_told():
    healthy = interim_finding(made("adequate"), 10_000.0)
    assert not changed(None, healthy)
    assert changed(None, found())
    assert not changed(found(), found(value=184.0, onset_s=7300.0))
    assert changed(found(), found(value=240.0))
    assert changed(found(), found(where="tank"))
    assert changed(found(), found(onset_s=20_000.0))
    assert changed(found(), interim_finding(made("ambiguous"), 10_000.0))
    assert changed(found(), healthy)


def test_an_ambiguous_finding_names_what_it_may_be_as_well():
    assert found().sentence == SAYS
    assert interim_finding(made("ambiguous"), 1.0).sentence.endswith(
        "is not distinguishable from heat source at heater"
    )


def error(before: float, after: float) -> SensorError:
    return SensorError(3.0, before, after, 0.05)


@pytest.mark.parametrize(
    ("verdict", "confidence", "errors", "why"),
    [
        ("effect found", 0.95, {"a": error(1.0, 0.06), "b": error(1.0, 0.06)}, None),
        ("effect found", 0.75, {"a": error(1.0, 0.06)}, "confidence is 0.75"),
        ("ambiguous", 0.95, {"a": error(1.0, 0.06)}, "verdict is ambiguous"),
        ("unexplained", 0.95, {"a": error(1.0, 0.06)}, "verdict is unexplained"),
        ("effect found", 0.95, {"a": error(1.0, 0.06), "b": error(0.5, 0.6)}, "b is worse"),
        ("effect found", 0.95, {"a": error(1.0, 1.0)}, "no better"),
        ("effect found", 0.95, {"a": error(1.0, float("nan"))}, "a is worse"),
    ],
)
def test_only_a_sure_finding_that_holds_on_unseen_data_is_adopted(verdict, confidence, errors, why):
    told = refusal(made(verdict, (effect(confidence=confidence),), errors, network=network()))
    assert told is None if why is None else why in str(told)


def network() -> Network:
    return load(TWIN)


def test_nothing_to_add_is_not_adopted():
    assert "nothing to add" in str(refusal(made()))


SIGNAL = Signal("T_tank", "degC")


class Deaf:
    """A connection whose other end never answers."""

    def __init__(self) -> None:
        self.asked: list[object] = []

    def send(self, what: object) -> None:
        self.asked.append(what)


@pytest.fixture
def live(tmp_path: Path) -> LiveDiagnosis:
    path = tmp_path / "journal.sqlite"
    journal = JournalWriter(path, Header((SIGNAL,), {}, (), "load", 36_000.0, 1.0, {}))
    return LiveDiagnosis(LiveConfig(TWIN, path, None, 3600.0), journal, lambda _: None)


def publish(live: LiveDiagnosis, time_s: float) -> None:
    """One block; anything that waited would not end at the first step."""
    block = live.publish([int(time_s)], [time_s], [[]])
    with pytest.raises(StopIteration):
        block.send(None)


def events(live: LiveDiagnosis) -> list[str]:
    live._journal.commit()
    reader = JournalReader(live._config.journal)
    try:
        return [f"{row.level} {row.text}" for row in reader.events()]
    finally:
        reader.close()


def test_no_block_waits_and_one_diagnosis_is_asked_for_at_a_time(live):
    deaf = Deaf()
    live._child = SimpleNamespace(connection=deaf)  # type: ignore[assignment]
    publish(live, 4000.0)
    assert deaf.asked == []  # not ready yet
    live._free = True
    for time_s in (4100.0, 7300.0, 20_000.0):
        publish(live, time_s)
    assert len(deaf.asked) == 1
    live._free = True
    publish(live, 20_060.0)
    assert len(deaf.asked) == 2  # overdue: at once
    live._free = True
    publish(live, 20_120.0)
    assert len(deaf.asked) == 2


def test_an_event_only_where_there_is_news(live):
    for reply in (
        Reply(),
        Reply(problem="too short"),
        Reply(interim_finding(made("adequate"), 3600.0)),
        Reply(found()),
        Reply(found(value=182.0)),
        Reply(found(), adopted=Path("my runs/twin.r2.toml")),
        Reply(interim_finding(made("adequate"), 9e3)),
    ):
        live._tell(reply)
    told = events(live)
    assert [line.split()[0] for line in told] == ["WARN", "INFO", "INFO"]
    assert SAYS in told[0]
    assert "static twin of this run is unchanged" in told[1]
    assert told[1].endswith("adopted as 'my runs/twin.r2.toml'")  # as a shell takes it


async def test_an_operator_may_skip_the_last_diagnosis(live):
    live._child = SimpleNamespace(connection=Deaf())  # type: ignore[assignment]
    asyncio.get_running_loop().call_soon(live.give_up)
    reply = await live.finish(Path("nowhere"))
    assert reply.problem == "skipped by the operator"


def test_results_that_are_stopped_while_they_are_made_leave_those_before(tmp_path):
    out, old = tmp_path / "diagnosis", {"record": "r", "provenance": {"files": {"twin": {"sha256": "1"}}}}
    for name, text in (("diagnosis.json", json.dumps(old)), ("diagnosis.html", "old")):
        with whole_results(out, old) as staged:
            (staged / name).write_text(text, encoding="utf-8")

    def stopped() -> None:
        with whole_results(out, old) as staged:
            (staged / "diagnosis.json").write_text("{}", encoding="utf-8")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert {path.name for path in tmp_path.iterdir()} == {"diagnosis"}
    assert json.loads((out / "diagnosis.json").read_text(encoding="utf-8")) == old
    assert {path.name for path in out.iterdir()} == {"diagnosis.json", "diagnosis.html"}


async def test_what_a_killed_process_has_not_finished_goes_with_it(live):
    left = live._config.journal.parent / ".diagnosis-x1"
    left.mkdir()
    live._child = SimpleNamespace(end=lambda: asyncio.sleep(0))  # type: ignore[assignment]
    await live.close()
    assert not left.exists()


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """Two hours in which the modules begin to heat after half an hour."""
    place = tmp_path_factory.mktemp("live")
    for name, end in (("healthy", 6000), ("load", LAST_S)):
        (place / f"{name}.csv").write_text(LOAD.format(end=end), encoding="utf-8")
    (place / "heat.toml").write_text(HEAT, encoding="utf-8")
    slow_period_rig(place, PERIOD_S)
    healthy = run(place, "healthy", "--no-twin").record
    return run(place, "load", "--with", place / "heat.toml", "--diagnose", "2h", "--adopt", "--healthy", healthy)


def run(place: Path, load: str, *more: object) -> RunFolder:
    words = ["run", place / f"{load}.csv", "--virtual", "--lockstep", "--no-viewer"]
    words += ["--rig", place / "slow.toml", "--runs", place / "runs", "--json", *more]
    words += ["--no-report"] if "--no-twin" in more else ["--calibrator", "least_squares"]
    done = typed(*words)
    assert done.returncode == 0, done.stderr
    return RunFolder(Path(json.loads(done.stdout)["folder"]))


def test_a_run_tells_what_its_twin_lacks_and_every_tick_is_there(ran):
    with sqlite3.connect(ran.journal) as database:
        told = [text for (text,) in database.execute("SELECT text FROM events") if text.startswith("diagnosis")]
        ticks = [tick for (tick,) in database.execute("SELECT tick FROM samples ORDER BY tick")]
    database.close()
    assert ticks == list(range(int(LAST_S / PERIOD_S) + 1)) and ran.read_manifest()["overruns"] == 0
    assert any("effect found" in text and "modules give off" in text and "since 30 min" in text for text in told)
    assert ran.read_manifest()["diagnosis"] == "effect found"
    assert has_diagnosis(ran.diagnosis) and (ran.diagnosis / "diagnosis.html").is_file()


def test_the_review_that_is_written_beside_the_last_diagnosis_has_every_tick_and_the_effect(ran):
    assert len(read_columns(ran.review, "/status")[0]) == int(LAST_S / PERIOD_S) + 1
    ((onset_s, says),) = read_words(ran.review, "/diagnosis/onsets")
    assert onset_s == pytest.approx(1800.0, abs=120.0) and "modules give off" in str(says)
    assert ran.read_manifest()["missing"] == {} and list(ran.path.glob("*.part")) == []


def test_what_was_adopted_is_a_revision_of_the_runs_twin(ran):
    reader = JournalReader(ran.journal)
    told = [row.text for row in reader.events() if "adopted as" in row.text]
    reader.close()
    revisions = sorted(ran.path.glob("twin.r*.toml"))
    assert revisions and [text.rpartition("adopted as ")[2] for text in told] == [str(path) for path in revisions]
    before = load(ran.twin)
    assert all(load(path).revision.parent == before.digest for path in revisions)
    document = json.loads((ran.diagnosis / "diagnosis.json").read_text(encoding="utf-8"))
    assert Path(document["revision"]) == revisions[-1]


def test_healthy_without_diagnose_is_a_usage_error(tmp_path):
    (tmp_path / "load.csv").write_text(LOAD.format(end=9000), encoding="utf-8")
    done = typed("run", tmp_path / "load.csv", "--virtual", "--adopt")
    assert done.returncode == 2 and "--diagnose" in done.stderr


@pytest.mark.parametrize(("asked", "written"), [(None, None), (1800.0, 1800.0), (math.inf, "end")])
def test_a_run_goes_on_with_the_diagnosis_that_it_was_asked_for(tmp_path, asked, written):
    profile = tmp_path / "load.csv"
    profile.write_text(LOAD.format(end=9000), encoding="utf-8")
    rig = PROJECT / "profiles" / "rigs" / "virtual.toml"
    request = RunRequest(profile, rig, None, tmp_path, virtual=True, mode="lockstep", diagnose_s=asked)
    folder = create_run_folder(tmp_path, "load", RunSize(100))
    settings = settings_of(request, None)
    folder.write_manifest(new_manifest({"rig": rig, "profile": profile}, **settings))
    JournalWriter(folder.journal, Header((SIGNAL,), {}, (), "load", 9000.0, 1.0, {})).close()
    manifest = folder.read_manifest()
    assert manifest["settings"]["diagnose_s"] == written
    assert request_of(folder, manifest, {}).diagnose_s == asked
