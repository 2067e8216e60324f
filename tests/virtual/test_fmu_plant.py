"""An FMU as the plant of the virtual rig; the FMU is that of a twin with another name for one input."""

from __future__ import annotations

import asyncio
import shutil
from pathlib import Path

import numpy as np
import pytest

from drivers.virtual.fmu import FmuPlant, FmuPlantError, fmu_ports
from drivers.virtual.plant import CHANNELS
from hil.export import export_twin
from tests.hil.command_line import typed

fmpy = pytest.importorskip("fmpy")
pytestmark = pytest.mark.skipif(
    not any(shutil.which(name) for name in ("cc", "gcc", "clang")), reason="no C compiler is installed"
)
LOOP = """
format = 1
name = "plain loop"
[inputs]
heating_W = { nominal = 0.0, unit = "W" }
T_ambient_C = { nominal = 20.0, unit = "degC" }
[elements.heater]
kind = "node"
capacitance = 4000.0
[elements.rest]
kind = "node"
capacitance = 20000.0
[elements.power]
kind = "heat_source"
node = "heater"
driver = "heating_W"
[elements.link]
kind = "conduction"
from = "heater"
to = "rest"
resistance = 0.02
[elements.loss]
kind = "ambient_loss"
node = "rest"
hA = 10.0
"""
SENSORS = {"T_heater_C": "heater", "T_modules_C": "rest", "T_radiator_C": "rest", "T_tank_C": "rest"}
NAMES = {"heater_power_W": "heating_W"}


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An FMU with the outputs of the coolant loop."""
    folder = tmp_path_factory.mktemp("fmu")
    sensors = [f'[elements.{n}]\nkind = "sensor"\nnode = "{at}"\ncolumns = ["{n}"]\n' for n, at in SENSORS.items()]
    (folder / "loop.toml").write_text(LOOP + "".join(sensors), encoding="utf-8")
    return export_twin(folder / "loop.toml", folder / "loop.fmu").path


def test_an_fmu_heats_and_cools_with_the_set_points(fmu: Path) -> None:
    plant = FmuPlant(fmu, NAMES, seed=3, period_s=2.0)
    start = plant.junction.copy()
    for _ in range(300):
        plant.step(800.0, 0.5, 1.0)
    assert plant.time_s == 600.0
    assert (plant.heater_power_W, plant.pump_speed_pct, plant.fan_speed_pct) == (800.0, 50.0, 100.0)
    assert plant.flow_L_per_min == pytest.approx(0.5 * 3.785)
    # 800 W over 0.02 K/W between the volumes: 16 K, less the share of the heat that the heater itself stores.
    assert 10.0 < plant.junction[0] - plant.junction[-1] < 16.0
    assert plant.junction[0] - start[0] > 20.0
    assert len(set(plant.junction[1:7])) == 1, "one output is all six modules"
    hot = plant.junction[0]
    for _ in range(300):
        plant.step(0.0, 0.5, 1.0)
    assert plant.junction[0] < hot - 10.0


def test_ports_are_found_by_name_and_others_are_named(fmu: Path) -> None:
    ports = fmu_ports(fmu, NAMES)
    assert list(ports.inputs) == ["heater_power_W", "T_ambient_C"], "the FMU has neither pump nor fan"
    assert len(ports.channels) == len(CHANNELS)
    again = fmu_ports(fmu, {**NAMES, "T_pm3_C": "T_heater_C"})
    assert again.channels[3] == ports.channels[0]


def test_a_temperature_in_kelvin_is_converted(fmu: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    description = fmpy.read_model_description(str(fmu))
    for variable in description.modelVariables:
        if variable.unit == "degC":
            variable.unit = "K"
    cold = FmuPlant(fmu, NAMES).junction
    monkeypatch.setattr(fmpy, "read_model_description", lambda path: description)
    assert np.allclose(FmuPlant(fmu, NAMES).junction, cold - 273.15)


@pytest.mark.parametrize(
    ("names", "sentence"),
    [
        ({}, "has no input 'heater_power_W' for heater_power_W; name one of heating_W, T_ambient_C"),
        ({**NAMES, "T_tank_C": "T_tnk"}, "has no output 'T_tnk' for T_tank_C"),
        ({**NAMES, "T_tank_C": "heating_W"}, "has no output 'heating_W'"),
        ({"heater": "heating_W"}, "the virtual rig has no signal 'heater'"),
    ],
)
def test_a_name_without_a_variable_is_refused(fmu: Path, names: dict[str, str], sentence: str) -> None:
    with pytest.raises(FmuPlantError, match=sentence):
        fmu_ports(fmu, names)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--fmu", "no.fmu"], "is no FMU that can be read"),
        (["--fmu", "loop.fmu"], "has no input 'heater_power_W'"),
        (["--fmu", "loop.fmu", "--fmu-variable", "heating_W"], "has no '='"),
        (["--fmu", "loop.fmu", "--with", "no.fmu"], "leave one of the two out"),
        (["--fmu-variable", "heater_power_W=x"], "but no FMU"),
    ],
)
def test_the_command_refuses_bad_input_in_a_sentence(
    fmu: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], sentence: str
) -> None:
    monkeypatch.chdir(fmu.parent)
    Path("no.fmu").write_bytes(b"no archive")
    result = typed("rig", "--modbus-port", "0", "--can-port", "0", *arguments)
    assert result.returncode == 2
    assert sentence in result.stderr
    assert "Traceback" not in result.stderr


async def test_an_fmu_that_fails_ends_the_rig_with_a_sentence(
    fmu: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from drivers.virtual.devices.plc import Plc

    plc = Plc("lockstep", 1.0, 1.0, 0, (), plant=FmuPlant(fmu, NAMES))
    assert plc.grant() == "t 1.000\n"

    def broken(slave: object, at: float, step: float) -> None:
        raise RuntimeError("fmi2DoStep failed")

    monkeypatch.setattr(fmpy.fmi2.FMU2Slave, "doStep", broken)
    assert plc.grant() == "error the plant has failed; the rig ends.\n"
    assert plc.stop.is_set()
    assert plc.failed
    assert "loop.fmu failed at 1 s (fmi2DoStep failed); the rig ends" in capsys.readouterr().err


async def test_the_virtual_rig_serves_an_fmu_in_lockstep(fmu: Path) -> None:
    from drivers.virtual import start_virtual_rig

    rig = await start_virtual_rig(mode="lockstep", fmu=fmu, fmu_variables=tuple(NAMES.items()))
    async with rig:
        reader, writer = await asyncio.open_connection(rig.host, rig.control_port)
        assert (await reader.readline()).startswith(b"virtual-rig")
        for step in (1, 2):
            writer.write(b"step\n")
            assert await reader.readline() == f"t {step}.000\n".encode()
        writer.close()
        await writer.wait_closed()
    assert rig.failure is None
