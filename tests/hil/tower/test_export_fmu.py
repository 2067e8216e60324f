"""The twin of a commissioned cooling-tower cell as an FMU, simulated by FMPy against the kernel of the twin."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from hil.export import export_twin
from twin import Kernel, load

fmpy = pytest.importorskip("fmpy")
ROWS, STEP_S = 360, 60.0


@pytest.mark.skipif(not any(shutil.which(name) for name in ("cc", "gcc", "clang")), reason="no C compiler is installed")
def test_a_commissioned_cell_is_simulated_as_its_twin_does(plant: Path, tmp_path: Path) -> None:
    from fmpy.validation import validate_fmu

    network = load(plant / "cell1.toml")
    path = export_twin(plant / "cell1.toml", tmp_path / "cell.fmu").path
    assert not validate_fmu(str(path))
    row = np.arange(ROWS)
    nominal = dict(zip(network.input_columns, network.nominal_inputs, strict=True))
    columns = {
        "t_in_C": 32.0 + 6.0 * np.sin(row / 40.0),
        "m_w_kg_s": nominal["m_w_kg_s"] * np.where(row % 120 < 100, 1.0, 0.4),
        "fan_speed_pct": np.where(row % 60 < 15, 0.0, 40.0 + row % 60),  # off, and from half to full speed
        "dry_C": 8.0 - 18.0 * np.cos(row / 50.0),
        "wet_C": 5.0 - 17.0 * np.cos(row / 50.0),  # over ice, too
        "pressure_kPa": np.full(ROWS, nominal["pressure_kPa"]),
        "bypass_pct": np.where(row % 90 < 80, 0.0, 60.0),
    }
    assert set(columns) == set(network.recorded_inputs) == set(network.input_columns)
    start, change = 24.0, {"cell.fill": 0.9, "outlet.bias_K": 0.3}
    record = np.zeros(ROWS, dtype=[("time", float), *((name, float) for name in columns)])
    record["time"] = row * STEP_S
    for name, values in columns.items():
        record[name] = values
    found = fmpy.simulate_fmu(
        str(path),
        stop_time=(ROWS - 1) * STEP_S,
        step_size=STEP_S,
        output_interval=STEP_S,
        input=record,
        start_values={"flume.initial": start, **change},
    )
    parameters = network.values.copy()
    parameters[network.index(change)] = list(change.values())
    inputs = np.column_stack([columns[name] for name in network.input_columns])
    ours = Kernel(network, ()).trace(parameters, np.array([start]), row * STEP_S, inputs)[0][0]
    (sensor,) = network.instruments
    np.testing.assert_allclose(found[sensor.name], ours[:, 0], rtol=0.0, atol=1e-6)
    assert np.ptp(ours) > 10.0
