"""Twin files out of data sheets."""

import json
from pathlib import Path

import pytest

from twin.network import TwinFileError
from twin.twinfile import load, save
from twin.twinfile.datasheet import from_datasheet

SHEET = {
    "rig": "Z",
    "nominal_flow_L_per_min_at_pump_100pct": 4.2,
    "tank_volume_L": 30.0,
    "heater_water_volume_L": 0.6,
    "pipe_volumes_L": {
        "heater_to_modules": 0.2,
        "modules_to_radiator": 0.3,
        "radiator_to_tank": 0.4,
        "tank_to_heater": 0.5,
    },
    "heater_rated_W": 1200,
    "thermocouple_sigma_K": 0.06,
    "flow_is": "proportional to pump speed",
    "somebody": "added this",
}


def write(folder: Path, sheet: object) -> Path:
    path = folder / "datasheet.json"
    path.write_text(sheet if isinstance(sheet, str) else json.dumps(sheet))
    return path


def test_volumes_flow_and_noise_are_taken_over(tmp_path: Path) -> None:
    net = from_datasheet(write(tmp_path, SHEET))
    value = {name: p.value for name, p in net.parameters.items()}
    assert net.name == "rig_Z"
    assert value["tank.capacitance"] == pytest.approx((30.0 + 0.4) * 0.997 * 4180.0)
    assert value["heater.capacitance"] == pytest.approx((0.6 + 0.5) * 0.997 * 4180.0 + 900.0)
    assert value["circuit.nominal"] == 4.2
    assert net.sigma == pytest.approx([0.06, 0.06 / 6**0.5, 0.06, 0.06])
    assert net.inputs["heater_power_W"].upper == 1200.0
    again = load(save(net, tmp_path / "twin.toml"))
    assert again.parameters == net.parameters


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"tank_volume_L": -1.0}, "tank_volume_L must be a positive number"),
        ({"tank_volume_L": None}, "tank_volume_L must be a positive number"),
        ({"pipe_volumes_L": 3.0}, "must be a table"),
        ({"flow_is": "quadratic"}, "is not a pump law"),
    ],
)
def test_impossible_entries(tmp_path: Path, change: dict[str, object], words: str) -> None:
    with pytest.raises(TwinFileError, match=words):
        from_datasheet(write(tmp_path, SHEET | change))


def test_missing_entries_and_broken_files(tmp_path: Path) -> None:
    with pytest.raises(TwinFileError, match="tank_volume_L is missing"):
        from_datasheet(write(tmp_path, {k: v for k, v in SHEET.items() if k != "tank_volume_L"}))
    with pytest.raises(TwinFileError, match="not valid JSON"):
        from_datasheet(write(tmp_path, "{"))
    with pytest.raises(TwinFileError, match="must be a JSON object"):
        from_datasheet(write(tmp_path, "[]"))
    with pytest.raises(TwinFileError, match="cannot be read"):
        from_datasheet(tmp_path / "absent.json")


def test_a_template_with_pipes_gets_their_volumes(tmp_path: Path) -> None:
    net = from_datasheet(write(tmp_path, SHEET), Path(__file__).parents[2] / "profiles" / "twins" / "loop_six.toml")
    value = {name: p.value for name, p in net.parameters.items()}
    assert value["pipe_radiator_to_tank.volume"] == 0.4
    assert value["tank.capacitance"] == pytest.approx(30.0 * 0.997 * 4180.0)
    assert len(net.sensors) == 9
    again = load(save(net, tmp_path / "twin.toml"))
    assert again.parameters == net.parameters
