"""`hil init --from telegraf.toml`: its inputs become buses and points, or one sentence with the line."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.importers.draft import ImportFileError
from drivers.importers.telegraf import import_telegraf
from tests.drivers.import_files import CELLS, complaint, table, written

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
    source = table(tmp_path, TELEGRAF, "telegraf.toml")
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
    text = TELEGRAF.replace('controller = "tcp://localhost:1502"', line, 1)
    text = text.replace('"request"\n', '"request"\n  transmission_mode = "RTUoverTCP"\n')
    first, second = written(tmp_path, import_telegraf(table(tmp_path, text, "telegraf.toml"))).bus.values()
    assert (first.transport, first.serial_port, first.serial_baud) == ("modbus_rtu", "/dev/ttyUSB0", 19200)
    assert (first.parity, first.stop_bits, first.device_id) == ("even", 1, 1)
    assert (second.transport, second.port, second.device_id) == ("modbus_rtu_tcp", 1502, 2)


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("FIXED", "FLOAT16-IEEE", 9, "FLOAT16-IEEE cannot be read here"),
        ("FIXED", "FLOAT64", 9, "type 'FLOAT64' has no counterpart here"),
        ('"FIXED"', '"UINT16"\n', 9, "is not valid TOML"),
        ("tcp://localhost:1502", "http://localhost", 4, "is neither tcp://host:port nor file:///dev/PORT"),
        ("tcp://localhost:1502", "file:///dev/ttyUSB0", 4, "the serial line /dev/ttyUSB0 has no speed"),
        ("slave_id = 1", 'transmission_mode = "ASCII"', 3, "'ASCII' is not spoken here"),
        ("address = [5,6]", "address = [5,7]", 10, "do not follow one another"),
        ("address = [5,6]", "address = [5]", 10, "byte_order ABCD names 4 bytes and the addresses hold 2"),
        ('register = "input"', 'register = "inputs"', 20, "register 'inputs' is not known"),
        ('"CDAB"', '"CADB"', 19, "byte_order 'CADB' is not known"),
        ("slave_id = 2", "slave_id = 300", 18, "slave_id 300 is no whole number from 0 to 255"),
    ],
)
def test_each_mistake_in_a_telegraf_file_is_named(tmp_path, old, new, line, said):
    assert old in TELEGRAF
    text = TELEGRAF.replace(old, new, 1)
    text = complaint(lambda: import_telegraf(table(tmp_path, text, "telegraf.toml")))
    assert said in text
    assert f"line {line}" in text


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_any_telegraf_file_is_imported_well_or_refused(tmp_path_factory, data):
    lines = TELEGRAF.splitlines()
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


REGISTERS = """\
[[inputs.modbus]]
  slave_id = 4
  controller = "tcp://10.0.0.3:502"
  input_registers = [
    { name = "level", byte_order = "BA", data_type = "FIXED", scale = "0.5", address = [7] },
    { name = "volume", byte_order = "GHEFCDAB", data_type = "UFIXED", scale = 0.01, address = [20, 21, 22, 23] },
    { name = "speed", byte_order = "CDAB", data_type = "FLOAT32", scale = 0.1, address = [30, 31] },
    { name = "torque", byte_order = "CDAB", data_type = "FLOAT32-IEEE", scale = 1, address = [32, 33] },
    { name = "mode", byte_order = "AB", data_type = "UINT8H", scale = 1.0, address = [40] },
    { name = "state", byte_order = "AB", data_type = "UINT8L", scale = 1.0, address = [40] },
  ]
"""


def test_fixed_point_types_are_integers_of_as_many_registers_as_addresses(tmp_path):
    draft = import_telegraf(table(tmp_path, REGISTERS, "telegraf.toml"))
    by_name = {point.name: point for point in written(tmp_path, draft).point}
    assert {name: (p.type, p.order, p.scale) for name, p in by_name.items()} == {
        "level": ("int16", "BADC", 0.5),
        "volume": ("uint64", "CDAB", 0.01),
        "speed": ("uint32", "CDAB", 0.1),
        "torque": ("float32", "CDAB", 1.0),
        "mode": ("uint16", "ABCD", 1.0),
        "state": ("uint16", "ABCD", 1.0),
    }
    assert (by_name["mode"].bits, by_name["state"].bits) == ((8, 15), (0, 7))
    assert draft.notes == ["line 7: speed: FLOAT32 of the register style is a whole number without sign (UFIXED)"]


def test_float32_of_the_request_style_is_an_ieee_number(tmp_path):
    text = """\
[[inputs.modbus]]
  controller = "tcp://10.0.0.3:502"
  [[inputs.modbus.request]]
    slave_id = 1
    fields = [ { address = 2, name = "speed", type = "FLOAT32", scale = 0.0 } ]
"""
    draft = import_telegraf(table(tmp_path, text, "telegraf.toml"))
    (point,) = written(tmp_path, draft).point
    assert (point.type, point.scale, point.table) == ("float32", 1.0, "holding")
    assert "configuration_type = 'request' is missing" in draft.notes[0]


@pytest.mark.parametrize(
    ("old", "new", "notes"),
    [
        ('"BA"', '"BA", skale = 10', ["line 5: key skale was not used"]),
        ("slave_id = 4", "slave_id = 4\n  timeout = '2s'", []),
        ("slave_id = 4", "slave_id = 4\n  multiplier = 10", ["line 3: key multiplier was not used"]),
        ("slave_id = 4", "", ["line 1: slave_id is not given, which Telegraf takes as 0"]),
        ("scale = 0.01", "scale = 0.0", ["line 6: volume: scale 0 loses the value"]),
        ("[7]", "[7, 8, 9]", ["line 5: level: FIXED takes 1, 2 or 4 addresses, and has 3"]),
        ('"level"', '"${PLACE}_level"', ["line 5: ${PLACE}_level: name is ${PLACE}; write what that stands for"]),
        ('"0.5"', '"$SCALE"', ["line 5: level: scale is $SCALE; write the number that it stands for"]),
        ("]\n", "]\n[[processors.scale]]\n  x = 1\n", ["line 12: processors.scale is not taken over"]),
        (
            "  input_registers",
            '  configuration_type = "register"\n  metric = [ { fields = [] } ]\n  input_registers',
            ["line 5: metric is left out: Telegraf does not read it in the register style"],
        ),
    ],
)
def test_every_key_of_a_telegraf_file_is_used_or_harmless_or_noted_with_its_line(tmp_path, old, new, notes):
    assert old in REGISTERS
    at = REGISTERS.rindex(old) if old == "]\n" else REGISTERS.index(old)
    text = REGISTERS[:at] + new + REGISTERS[at + len(old) :]
    draft = import_telegraf(table(tmp_path, text, "telegraf.toml"))
    said = [note for note in draft.notes if "UFIXED" not in note]
    assert len(said) == len(notes), said
    for note, start in zip(said, notes, strict=True):
        assert note.startswith(start)
    assert len(written(tmp_path, draft).point) == 6 - sum("left out)" in note for note in said)


@pytest.mark.parametrize("host", ["00", "10.0.0.256", "my%20plc"])
@pytest.mark.parametrize("mode", ["TCP", "RTUoverTCP"])
def test_a_host_that_no_rig_file_takes_is_refused_with_its_line(tmp_path, host, mode):
    controller = 'controller = "tcp://10.0.0.3:502"'
    assert controller in REGISTERS
    text = REGISTERS.replace(controller, f'{controller.replace("10.0.0.3", host)}\n  transmission_mode = "{mode}"')
    with pytest.raises(ImportFileError, match=rf"telegraf.toml, line 3: .*host: '{host}' is no "):
        import_telegraf(table(tmp_path, text, "telegraf.toml"))


def test_a_controller_that_only_stands_for_one_is_refused(tmp_path):
    text = REGISTERS.replace("10.0.0.3", "${PLC}")
    with pytest.raises(ImportFileError, match=r"telegraf.toml, line 3: .*controller is \$\{PLC\}; write what that"):
        import_telegraf(table(tmp_path, text, "telegraf.toml"))
    with pytest.raises(ImportFileError, match=r"line 2.*write the value of \$UNIT in its place"):
        import_telegraf(table(tmp_path, REGISTERS.replace("slave_id = 4", "slave_id = $UNIT"), "telegraf.toml"))
