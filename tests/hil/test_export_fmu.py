"""Twins as FMUs: validated and simulated by FMPy, against the kernel of the twin."""

from __future__ import annotations

import re
import shutil
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.export import ExportError, export_twin
from tests.hil.command_line import typed
from twin import STAMP, Kernel, Network, load
from twin.kernel import c_source, with_stamps

fmpy = pytest.importorskip("fmpy")
needs_compiler = pytest.mark.skipif(
    not any(shutil.which(name) for name in ("cc", "gcc", "clang")), reason="no C compiler is installed"
)

LINE = """
format = 1
name = "heated line"
title = "Two volumes & a <pipe>"
[inputs]
pump_speed_pct = { nominal = 100.0, lower = 0.0, upper = 100.0, unit = "%" }
T_in_C = { nominal = 20.0, unit = "degC" }
heater_power_W = { nominal = 0.0, unit = "W" }
T_ambient_C = { nominal = 20.0, unit = "degC" }
time_s = { nominal = 0.0, unit = "s" }
[elements.a]
kind = "node"
capacitance = { value = 8000.0, status = "tunable" }
[elements.b]
kind = "node"
capacitance = 9000.0
[elements.stream]
kind = "flow"
path = ["a", "b"]
pump = "pump_speed_pct"
inlet = "T_in_C"
nominal = 6.0
[elements.tube]
kind = "pipe"
to = "b"
volume = 1.03
[elements.power]
kind = "heat_source"
node = "a"
driver = "heater_power_W"
[elements.cycle]
kind = "law_heat"
node = "b"
size = 400.0
course = "periodic"
start_s = 101.0
period_s = 170.0
duty = 0.4
[elements.relay]
kind = "actuator"
column = "heater_power_W"
dead_time_s = 12.5
lag_s = 9.0
[elements.T_a_C]
kind = "sensor"
node = "a"
columns = ["T_a_C"]
lag_s = 15.0
[elements.T_b_C]
kind = "sensor"
node = "b"
columns = ["T_b_C"]
drift_K_per_h = 0.5
"""
ROWS, STEP_S = 240, 5.0
START_C = {"a": 25.0, "b": 22.0}


def inputs_of(network: Network) -> np.ndarray:
    """Steps of all inputs (n, c), at times that do not coincide."""
    row = np.arange(ROWS)
    steps = {
        "pump_speed_pct": np.where(row % 90 < 50, 100.0, 55.0),
        "T_in_C": np.where(row % 70 < 30, 20.0, 31.0),
        "heater_power_W": np.where(row % 40 < 21, 0.0, 900.0),
    }
    return np.column_stack([steps.get(column, np.full(ROWS, 20.0)) for column in network.input_columns])


def expected(network: Network, values: np.ndarray | None = None) -> np.ndarray:
    """Readings (n, m) of the twin's own kernel."""
    time = np.arange(ROWS) * STEP_S
    start = np.array([START_C[node] for node in network.nodes])
    parameters = network.values if values is None else values
    inputs = with_stamps(network, time, inputs_of(network))
    return Kernel(network, ()).trace(parameters, start, time, inputs)[0][0]


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> tuple[Network, Path]:
    """The twin, and its FMU."""
    folder = tmp_path_factory.mktemp("fmu")
    (folder / "line.toml").write_text(LINE, encoding="utf-8")
    made = export_twin(folder / "line.toml", folder / "line.fmu")
    return load(folder / "line.toml"), made.path


def simulated(path: Path, network: Network, **start: float) -> Any:
    """Result of FMPy: a structured array with the outputs by name."""
    names = network.recorded_inputs
    columns = inputs_of(network)
    record = np.zeros(ROWS, dtype=[("time", float), *((name, float) for name in names)])
    record["time"] = np.arange(ROWS) * STEP_S
    for name in names:
        record[name] = columns[:, network.input_columns.index(name)]
    values = {f"{node}.initial": value for node, value in START_C.items()} | start
    end = (ROWS - 1) * STEP_S
    return fmpy.simulate_fmu(
        str(path), stop_time=end, step_size=STEP_S, output_interval=STEP_S, input=record, start_values=values
    )


def test_the_reference_uses_what_a_translation_could_lose(line: tuple[Network, Path]) -> None:
    source = c_source(line[0])
    assert source.looks_back, "a dead time"
    assert source.rows > 0, "a pipe"
    assert source.width > len(line[0].nodes), "lags"
    assert STAMP in line[0].inputs, "a time course"
    assert "k_modulo(" in source.text.partition("k_piece")[2], "a period"


def test_fmpy_finds_no_fault_in_the_fmu(line: tuple[Network, Path]) -> None:
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(line[1])) == []


@needs_compiler
def test_fmpy_simulates_what_the_kernel_does(line: tuple[Network, Path]) -> None:
    network, path = line
    result, wanted = simulated(path, network), expected(network)
    assert len(result) == ROWS
    for j, name in enumerate(network.sensor_names):
        assert np.ptp(wanted[:, j]) > 5.0, "the record moves the reading"
        assert np.abs(result[name] - wanted[:, j]).max() < 1e-6


@needs_compiler
def test_a_tunable_parameter_acts_as_in_the_twin(line: tuple[Network, Path]) -> None:
    network, path = line
    values = network.values.copy()
    values[network.index(["a.capacitance"])] = 5000.0
    wanted = expected(network, values)
    assert np.abs(wanted - expected(network)).max() > 0.1
    result = simulated(path, network, **{"a.capacitance": 5000.0})
    for j, name in enumerate(network.sensor_names):
        assert np.abs(result[name] - wanted[:, j]).max() < 1e-6


@pytest.fixture
def instances(line: tuple[Network, Path]) -> Iterator[list[Any]]:
    """Two instances of the FMU, initialised."""
    description = fmpy.read_model_description(str(line[1]))
    folder = fmpy.extract(str(line[1]))
    made = []
    for name in ("first", "second"):
        slave = fmpy.fmi2.FMU2Slave(
            guid=description.guid,
            unzipDirectory=folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        slave.instantiate()
        _initialise(slave)
        made.append(slave)
    yield made
    for slave in made:
        slave.terminate()
        slave.freeInstance()
    shutil.rmtree(folder)


def _initialise(slave: Any) -> None:
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()


def _heated(slave: Any, power: float, steps: int = 40) -> list[float]:
    """Readings after steps of 5 s with a heater power; references 0 to 2 are inputs, 4 and 5 outputs."""
    for k in range(steps):
        slave.setReal([0, 1, 2], [100.0, 20.0, power])
        slave.doStep(5.0 * k, 5.0)
    return list(slave.getReal([4, 5]))


@needs_compiler
def test_instances_share_nothing_and_a_reset_begins_anew(instances: list[Any]) -> None:
    first, second = instances
    hot = _heated(first, 1000.0)
    assert hot[0] > 21.0
    assert _heated(second, 0.0)[0] == pytest.approx(20.0, abs=0.01)
    first.reset()
    _initialise(first)
    assert _heated(first, 1000.0) == hot


@needs_compiler
def test_a_missing_input_holds_the_last_good_value(instances: list[Any]) -> None:
    first, second = instances
    wanted = _heated(first, 1000.0)
    for k in range(40):
        second.setReal([0, 1, 2], [100.0, 20.0, 1000.0] if k == 0 else [float("nan")] * 3)
        second.doStep(5.0 * k, 5.0)
    assert list(second.getReal([4, 5])) == wanted


def test_the_description_has_units_bounds_and_a_default_experiment(line: tuple[Network, Path]) -> None:
    description = fmpy.read_model_description(str(line[1]))
    by_name = {v.name: v for v in description.modelVariables}
    assert {n for n, v in by_name.items() if v.causality == "input"} == set(line[0].recorded_inputs)
    assert [n for n, v in by_name.items() if v.causality == "output"] == ["T_a_C", "T_b_C"]
    pump, capacity = by_name["pump_speed_pct"], by_name["a.capacitance"]
    assert (pump.unit, float(pump.start), float(pump.max)) == ("%", 100.0, 100.0)
    assert (capacity.unit, capacity.variability, float(capacity.start)) == ("J/K", "tunable", 8000.0)
    assert "b.capacitance" not in by_name, "it is fixed"
    assert float(description.defaultExperiment.stepSize) == 1.0
    assert description.description == "Two volumes & a <pipe>"


def test_the_same_twin_gives_the_same_sources(
    line: tuple[Network, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "")  # a library is the compiler's, and takes a second
    again = export_twin(line[1].with_name("line.toml"), tmp_path / "again.fmu").path
    with zipfile.ZipFile(line[1]) as one, zipfile.ZipFile(again) as other:
        for name in ("modelDescription.xml", "sources/twin.c"):
            assert one.read(name) == other.read(name)


def test_without_a_compiler_the_fmu_holds_its_source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fmpy.validation import validate_fmu

    monkeypatch.setenv("PATH", str(tmp_path))
    (tmp_path / "line.toml").write_text(LINE, encoding="utf-8")
    result = typed("export", tmp_path / "line.toml", "--to", "fmu", "--out", tmp_path / "line.fmu")
    assert result.returncode == 0
    assert "no C compiler is installed" in result.stderr
    with zipfile.ZipFile(tmp_path / "line.fmu") as archive:
        assert not any(name.startswith("binaries") for name in archive.namelist())
        assert b"FMI(DoStep)" in archive.read("sources/twin.c")
    assert validate_fmu(str(tmp_path / "line.fmu")) == []


def test_a_compiler_that_fails_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "cc").write_text("#!/bin/sh\necho 'cc: no such option' >&2\nexit 1\n")
    (tmp_path / "cc").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin:/usr/bin")
    (tmp_path / "line.toml").write_text(LINE, encoding="utf-8")
    with pytest.raises(ExportError, match=r"refuses the code of the twin .cc: no such option"):
        export_twin(tmp_path / "line.toml", tmp_path / "line.fmu")
    assert not (tmp_path / "line.fmu").exists()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["line.fmu"], "is not UTF-8 text"),
        (["line.toml", "--signals", "T_a_C"], "--signals chooses signals of a run"),
        (["line.toml", "--out", "line.fmu"], "exists; choose another name"),
        (["."], "holds no twin.toml"),
    ],
)
def test_bad_input_is_refused_in_a_sentence(
    line: tuple[Network, Path], monkeypatch: pytest.MonkeyPatch, arguments: list[str], sentence: str
) -> None:
    monkeypatch.chdir(line[1].parent)
    monkeypatch.setenv("PATH", "")
    before = line[1].read_bytes()
    result = typed("export", *arguments, "--to", "fmu")
    assert result.returncode == 2
    assert re.search(sentence, result.stderr), result.stderr
    assert line[1].read_bytes() == before
