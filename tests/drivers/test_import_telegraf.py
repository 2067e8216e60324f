"""`hil init --from telegraf.toml`: its inputs become buses and points, or one sentence with the line."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.imports.draft import ImportFileError
from drivers.imports.telegraf import import_telegraf
from tests.drivers.import_files import CELLS, table, written

TELEGRAF = """\
[[inputs.modbus]]
  name = "Device"
  slave_id = 1
  controller = "tcp://localhost:1502"
  configuration_type = "register"
  discrete_inputs = [ { name = "start", address = [0] } ]
  coils = [ { name = "motor1_run", address = [0] } ]
  holding_registers = [
    { name = "power_factor", byte_order = "AB", data_type = "FIXED", scale=0.01, address = [8] },
    { name = "energy", byte_order = "ABCD", data_type = "FLOAT32", scale=0.001, address = [5,6] },
  ]
  input_registers = [ { name = "tank_level", byte_order = "AB", data_type = "INT16", scale=1.0, address = [0] } ]

[[inputs.modbus]]
  controller = "tcp://localhost:1502"
  configuration_type = "request"
  [[inputs.modbus.request]]
    slave_id = 2
    byte_order = "CDAB"
    register = "input"
    fields = [
      { address = 4, name = "flow", type = "FLOAT32" },
      { address = 6, name = "spare", type = "INT16", omit = true },
      { address = 7, name = "state", type = "BIT", bit = 3 },
      { address = 10, name = "serial", type = "STRING", length = 4 },
    ]
"""


def test_telegrafs_own_styles_become_buses_and_points(tmp_path):
    source = table(tmp_path, TELEGRAF.replace('"FIXED"', '"UINT16"'), "telegraf.toml")
    rig = written(tmp_path, import_telegraf(source))
    assert [(bus.host, bus.port, bus.device_id) for bus in rig.bus.values()] == [
        ("localhost", 1502, 1),
        ("localhost", 1502, 2),
    ]
    by_name = {point.name: point for point in rig.point}
    assert set(by_name) == {"start", "motor1_run", "power_factor", "energy", "tank_level", "flow", "state", "serial"}
    assert (by_name["energy"].table, by_name["energy"].address, by_name["energy"].scale) == ("holding", 5, 0.001)
    assert (by_name["flow"].bus, by_name["flow"].order, by_name["flow"].address) == ("plc2", "CDAB", 4)
    assert by_name["state"].bits == (3, 3)
    assert by_name["serial"].length == 4


def test_serial_lines_and_converters_become_their_buses(tmp_path):
    line = 'controller = "file:///dev/ttyUSB0"\n  baud_rate = 19200\n  parity = "E"\n  data_bits = 8\n  stop_bits = 1'
    text = TELEGRAF.replace('"FIXED"', '"UINT16"').replace('controller = "tcp://localhost:1502"', line, 1)
    text = text.replace('"request"\n', '"request"\n  transmission_mode = "RTUoverTCP"\n')
    first, second = written(tmp_path, import_telegraf(table(tmp_path, text, "telegraf.toml"))).bus.values()
    assert (first.transport, first.serial_port, first.serial_baud) == ("modbus_rtu", "/dev/ttyUSB0", 19200)
    assert (first.parity, first.stop_bits, first.device_id) == ("even", 1, 1)
    assert (second.transport, second.port, second.device_id) == ("modbus_rtu_tcp", 1502, 2)


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("", "", 9, "type 'FIXED' of power_factor has no counterpart here"),
        ('"FIXED"', '"UINT16"\n', 9, "is not valid TOML"),
        ("tcp://localhost:1502", "http://localhost", 4, "is neither tcp://host:port nor file:///dev/PORT"),
        ("tcp://localhost:1502", "file:///dev/ttyUSB0", 4, "the serial line /dev/ttyUSB0 has no speed"),
        ("slave_id = 1", 'transmission_mode = "ASCII"', 4, "'ASCII' is not spoken here"),
        ("address = [5,6]", "address = [5,7]", 10, "do not follow one another"),
        ("address = [5,6]", "address = [5]", 10, "takes 2 addresses, and has 1"),
        ('register = "input"', 'register = "inputs"', 20, "register 'inputs' is not known"),
        ('"CDAB"', '"CADB"', 22, "byte_order 'CADB' of flow is not known"),
        ("slave_id = 2", "slave_id = 300", 22, "slave_id 300 is no whole number from 0 to 255"),
    ],
)
def test_each_mistake_in_a_telegraf_file_is_named(tmp_path, old, new, line, said):
    text = TELEGRAF if not old else TELEGRAF.replace(old, new, 1)
    if old and "FIXED" not in old:
        text = text.replace('"FIXED"', '"UINT16"')
    with pytest.raises(ImportFileError) as caught:
        import_telegraf(table(tmp_path, text, "telegraf.toml"))
    assert said in str(caught.value)
    assert f"line {line}" in str(caught.value)


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_any_telegraf_file_is_imported_well_or_refused(tmp_path_factory, data):
    lines = TELEGRAF.replace('"FIXED"', '"UINT16"').splitlines()
    odd = st.sampled_from(
        ["", "x", '= "', "[[inputs.modbus]]", "address = -1", "slave_id = 1e9", "fields = 3", "request = {}"]
    )
    for _ in range(data.draw(st.integers(1, 4))):
        index = data.draw(st.integers(0, len(lines) - 1))
        words = lines[index].split("=")
        lines[index] = data.draw(odd) if data.draw(st.booleans()) else words[0] + "= " + data.draw(CELLS)
    folder = tmp_path_factory.mktemp("fuzz")
    source = folder / "telegraf.toml"
    source.write_text("\n".join(lines), encoding="utf-8", errors="replace")
    try:
        draft = import_telegraf(source)
    except ImportFileError as error:
        assert "telegraf.toml" in str(error)
    else:
        written(folder, draft)
