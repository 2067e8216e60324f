"""The engine on the virtual rig, in separate processes, over Modbus and CAN: the heater ends safe on every way out."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.rig.connection import RigConnection
from drivers.rig_file.reader import load_rig
from drivers.signals.points import Quality
from drivers.virtual.rig import start_virtual_rig
from hil.journal.store import JournalStore
from hil.journal.writer import Header, JournalError, JournalReader, JournalWriter
from hil.profile.load_profile import read_profile
from hil.run.engine.clock import LockstepClock, MonotonicClock
from hil.run.engine.components import Options
from hil.run.engine.engine import Engine
from hil.run.engine.status import Outcome
from hil.run.outputs.safing import make_safe

PROJECT = Path(__file__).resolve().parents[2]
RIG = load_rig(PROJECT / "profiles" / "rigs" / "virtual.toml")
LOAD = "time_s,heater_power_W,pump_speed_pct,fan_speed_pct\n0,700,100,70\n300,850,100,70\n{end},850,100,70\n"


class Trial:
    """One run of a short profile on a fresh virtual rig."""

    def __init__(self, folder: Path, *, duration_s: int = 700, effects: str | None = None, **rig: Any) -> None:
        self.folder = folder
        self.profile_path = folder / "load.csv"
        self.profile_path.write_text(LOAD.format(end=duration_s), encoding="utf-8")
        self.effects = None
        if effects is not None:
            self.effects = folder / "effects.toml"
            self.effects.write_text(effects, encoding="utf-8")
        self.rig = {"mode": "lockstep", "seed": 1} | rig
        self.journal = folder / "journal.sqlite"
        self.power_at_the_end = float("nan")
        self.engine: Engine
        self.outcome: Outcome

    async def run(self, during: Any = None) -> Outcome:
        """Run; `during(trial, virtual)` goes on beside it. The heater's power is read by a client of its own."""
        virtual = await start_virtual_rig(effects=self.effects, **self.rig)
        lockstep = self.rig["mode"] == "lockstep"
        async with virtual:
            if lockstep:
                clock: Any = LockstepClock("127.0.0.1", virtual.control_port)
                await clock.connect()
            else:
                clock = MonotonicClock(1.0, self.rig.get("speed", 1.0))
            rig = RIG.with_ports({"plc": virtual.modbus_port, "thermocouples": virtual.can_port})
            connection = RigConnection(rig, clock.now)
            profile = read_profile(self.profile_path)
            signals = connection.signals + tuple(p.as_signal() for p in rig.setpoints)
            journal = JournalWriter(self.journal, Header(signals, {}, (), "load", profile.duration_s, 1.0, {}))
            self.engine = Engine(connection, clock, profile, journal, Options(lockstep=lockstep))
            beside = asyncio.create_task(during(self, virtual)) if during is not None else None
            try:
                outcome = self.outcome = await self.engine.run()
            finally:
                if beside is not None:
                    beside.cancel()
                    await asyncio.gather(beside, return_exceptions=True)
                if virtual.running:
                    self.power_at_the_end = await self._set_power(virtual.modbus_port)
                journal.close()
        return outcome

    @staticmethod
    async def _set_power(port: int) -> float:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(bytes.fromhex("000100000006010300000001"))
        answer = await reader.readexactly(11)
        writer.close()
        await writer.wait_closed()
        return int.from_bytes(answer[9:11], "big") * 0.1

    def column(self, name: str) -> np.ndarray:
        reader = JournalReader(self.journal)
        index = [signal.name for signal in reader.header.signals].index(name)
        values = reader.samples().values[:, index]
        reader.close()
        return values

    def events(self) -> str:
        reader = JournalReader(self.journal)
        text = "\n".join(f"{row.level} {row.text}" for row in reader.events())
        reader.close()
        return text


async def test_a_whole_profile_is_followed_journaled_and_ends_safe(tmp_path):
    trial = Trial(tmp_path)
    outcome = await trial.run()
    assert (outcome.status, outcome.reason, outcome.safe) == ("done", "", True)
    commanded = trial.column("heater_power_set")
    assert len(commanded) == 701
    assert commanded[:8].tolist() == [100, 200, 300, 400, 500, 600, 700, 700]
    assert commanded[299:303].tolist() == [700, 800, 850, 850]
    assert trial.column("heater_power")[250] == pytest.approx(700, rel=0.03)
    assert trial.column("T_heater")[-1] > trial.column("T_heater")[0] + 3
    assert trial.power_at_the_end == 0.0
    assert "safe: heater_power_set 0 W" in trial.events()


async def test_lockstep_runs_of_one_seed_are_the_same_to_the_bit(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    first, second = Trial(tmp_path / "a"), Trial(tmp_path / "b")
    await first.run()
    await second.run()
    for name in ("heater_power", "flow", "T_ambient", "T_heater", "T_pm4", "T_tank", "tc_uptime"):
        assert np.array_equal(first.column(name), second.column(name)), name


async def test_every_tick_holds_the_samples_of_that_tick(tmp_path):
    trial = Trial(tmp_path, duration_s=650)
    await trial.run()
    plc, module = trial.column("plc_uptime"), trial.column("tc_uptime")
    assert np.array_equal(plc, module)
    assert np.all(np.diff(plc) == pytest.approx(1.0))
    reader = JournalReader(trial.journal)
    samples = reader.samples()
    reader.close()
    assert np.all(samples.quality == Quality.GOOD)
    assert samples.source_time_s[:, 0] == pytest.approx(plc)
    assert samples.source_time_s[:, 12] == pytest.approx(plc)


async def stop_after(trial: Trial, ticks: int, times: int = 1) -> None:
    while not hasattr(trial, "engine") or trial.engine.tick < ticks:
        await asyncio.sleep(0.005)
    for _ in range(times):
        trial.engine.request_stop("stopped by the test")
        await asyncio.sleep(0.6)


@pytest.mark.parametrize("times", [1, 2])
async def test_a_stop_request_ends_safe_and_a_second_one_skips_nothing(tmp_path, times):
    trial = Trial(tmp_path, duration_s=20000)
    outcome = await trial.run(lambda t, _: stop_after(t, 200, times))
    assert (outcome.status, outcome.reason, outcome.safe) == ("aborted", "stopped by the test", True)
    assert trial.power_at_the_end == 0.0


async def test_an_open_thermocouple_ends_the_run_safe(tmp_path):
    effect = '[[effect]]\nkind = "sensor"\nwhere = "T_pm2_C"\ndriver = "constant"\nopen_circuit = true\nonset_s = 300\n'
    trial = Trial(tmp_path, effects=effect)
    outcome = await trial.run()
    assert outcome.status == "faulted"
    assert "T_pm2 has been without a good value for 5 s: sensor fault" in outcome.reason
    assert outcome.safe
    assert trial.power_at_the_end == 0.0
    reader = JournalReader(trial.journal)
    samples = reader.samples()
    index = [signal.name for signal in reader.header.signals].index("T_pm2")
    reader.close()
    assert 290 <= int(np.argmax(samples.quality[:, index] == Quality.SENSOR_FAULT)) <= 310


async def test_an_exception_in_the_loop_still_ends_safe(tmp_path):
    trial = Trial(tmp_path)

    async def break_it(trial: Trial, _: Any) -> None:
        while not hasattr(trial, "engine") or trial.engine.tick < 100:
            await asyncio.sleep(0.005)
        trial.engine._outputs.move = None  # type: ignore[assignment, method-assign]

    with pytest.raises(TypeError):
        await trial.run(break_it)
    assert "safe: heater_power_set 0 W" in trial.events()


async def test_a_journal_that_cannot_be_written_ends_the_run_safe(tmp_path, monkeypatch):
    trial = Trial(tmp_path, duration_s=20000)

    async def fill_the_disk(trial: Trial, _: Any) -> None:
        while not hasattr(trial, "engine") or trial.engine.tick < 100:
            await asyncio.sleep(0.005)

        def write(self: JournalStore, batch: list[Any]) -> list[str]:
            raise JournalError("journal.sqlite cannot be written (database or disk is full)")

        monkeypatch.setattr(JournalStore, "write", write)

    with contextlib.suppress(JournalError):
        await trial.run(fill_the_disk)
    assert trial.outcome.status == "faulted"
    assert "disk is full" in trial.outcome.reason
    assert trial.outcome.safe
    assert trial.power_at_the_end == 0.0


async def test_a_rig_that_dies_ends_the_run_and_says_that_it_is_not_safe(tmp_path, monkeypatch):
    monkeypatch.setattr("hil.run.outputs.safing.WRITE_DEADLINE_S", 1.0)
    trial = Trial(tmp_path, mode="scaled", speed=20.0)

    async def kill_plc(trial: Trial, virtual: Any) -> None:
        while not hasattr(trial, "engine") or trial.engine.tick < 40:
            await asyncio.sleep(0.01)
        import os

        os.kill(virtual.pids["plc"], signal.SIGKILL)

    outcome = await trial.run(kill_plc)
    assert outcome.status == "faulted"
    assert not outcome.safe
    assert "could not be made safe from here" in trial.events()


async def test_a_run_on_a_hot_rig_is_refused_and_nothing_is_written(tmp_path):
    cold = RIG.model_copy(
        update={
            "point": tuple(p.model_copy(update={"alarm": (-5.0, 10.0)}) if p.name == "T_tank" else p for p in RIG.point)
        }
    )
    trial = Trial(tmp_path)
    globals_rig = globals()["RIG"]
    globals()["RIG"] = cold
    try:
        outcome = await trial.run()
    finally:
        globals()["RIG"] = globals_rig
    assert outcome.status == "faulted"
    assert "not started: T_tank is 2" in outcome.reason and outcome.untouched
    assert trial.power_at_the_end == 0.0


async def test_making_safe_tries_again_until_the_rig_holds_the_values():
    class Stubborn:
        """A rig that loses its link twice and then drops one write."""

        rig = RIG
        points = ()

        def __init__(self) -> None:
            self.held = {"heater_power_set": 800.0, "pump_speed_set": 50.0, "fan_speed_set": 50.0}
            self.calls = 0
            self.order: list[str] = []

        async def write(self, values: dict[str, float]) -> None:
            from drivers.signals.points import LinkError

            self.calls += 1
            if self.calls <= 2:
                raise LinkError("link lost")
            if self.calls != 3:
                self.held.update(values)
                self.order += values

        def by_wire(self, names: Iterable[str]) -> list[tuple[str, ...]]:
            return [tuple(names)]

        async def write_and_read_back(self, values: dict[str, float], names: tuple[str, ...]) -> dict[str, float]:
            await self.write(values)
            return await self.read_back(names)

        async def read_back(self, names: tuple[str, ...]) -> dict[str, float]:
            return {name: self.held[name] for name in names}

        async def read(self) -> Any:
            from drivers.signals.points import Snapshot

            return Snapshot([], [], [])

    rig = Stubborn()

    async def advance() -> None:
        await asyncio.sleep(0)

    safe = {"heater_power_set": 0.0, "pump_speed_set": 100.0, "fan_speed_set": 100.0}
    result = await make_safe(
        rig,
        safe,
        heartbeat=dict,
        advance=advance,
        period_s=1.0,
        hurried=lambda: True,  # type: ignore[arg-type]
    )
    assert result.written
    assert rig.held == safe
    assert rig.order[-3:] == list(safe)
