"""`hil init --from homeassistant.yaml`: hubs become buses and points, or one sentence with the line."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.importers.draft import ImportFileError
from drivers.importers.homeassistant import draft_of, import_homeassistant
from drivers.importers.yaml_places import Placed
from tests.drivers.import_files import complaint, table, written


def placed(value: object, line: int = 1) -> Placed:
    """What the YAML reader makes of a value; every entry is a line further down."""
    if isinstance(value, Placed):
        return value
    if isinstance(value, dict):
        return Placed({key: placed(item, line + n) for n, (key, item) in enumerate(value.items())}, line)
    if isinstance(value, list):
        return Placed([placed(item, line + n) for n, item in enumerate(value)], line)
    return Placed(value, line)


def hub(*sensors: dict, **more: object) -> dict:
    return {
        "modbus": [{"name": "hub", "type": "tcp", "host": "10.0.0.9", "port": 5020, "sensors": list(sensors)} | more]
    }


def test_a_home_assistant_hub_becomes_points(tmp_path):
    document = hub(
        {"name": "Flow", "address": 2, "input_type": "input", "data_type": "float32", "swap": "word", "slave": 2}
        | {"unit_of_measurement": "L/min", "min_value": 0, "max_value": 8},
        {"name": "Supply", "address": 4, "scale": 0.1, "offset": -40, "nan_value": "0x8000"},
        binary_sensors=[{"name": "Pump", "address": 7, "input_type": "discrete_input"}],
        switches=[{"name": "Remote", "address": 9, "write_type": "coil"}],
        climates=[{"name": "c"}],
    )
    draft = draft_of(Path("ha.yaml"), placed(document))
    rig = written(tmp_path, draft)
    by_name = {point.name: point for point in rig.point}
    assert rig.bus["plc"].device_id == 2 and rig.bus["plc2"].device_id == 1
    assert (by_name["Flow"].order, by_name["Flow"].plausible, by_name["Flow"].unit) == ("CDAB", (0.0, 8.0), "L/min")
    assert (by_name["Supply"].type, by_name["Supply"].offset, by_name["Supply"].invalid) == ("int16", -40.0, (32768.0,))
    assert -32768.0 in by_name["Supply"].sentinels
    assert (by_name["Pump"].table, by_name["Remote"].access) == ("discrete", "rw")
    (note,) = draft.notes
    assert re.match(r"line \d+: climate c was left out: a rig has points only", note)


def test_hubs_on_serial_lines_and_converters_become_their_buses(tmp_path):
    line = {"type": "serial", "port": "/dev/ttyUSB0", "method": "rtu", "baudrate": 9600, "bytesize": 8}
    on_line = hub({"name": "Level", "address": 1, "slave": 3}, **line, parity="N", stopbits=2)
    rig = written(tmp_path, draft_of(Path("ha.yaml"), placed(on_line)))
    bus = rig.bus["plc"]
    assert (bus.transport, bus.serial_port, bus.serial_baud) == ("modbus_rtu", "/dev/ttyUSB0", 9600)
    assert (bus.parity, bus.stop_bits, bus.device_id) == ("none", 2, 3)
    over_tcp = draft_of(Path("ha.yaml"), placed(hub({"name": "Level", "address": 1}, type="rtuovertcp", port=4001)))
    assert (over_tcp.buses[0].keys["transport"], over_tcp.buses[0].keys["port"]) == ("modbus_rtu_tcp", 4001)


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ({}, "has no modbus: section"),
        (hub(type="udp"), "rig files know tcp, rtuovertcp and serial with method rtu"),
        (hub(type="serial", method="ascii"), "hub of type serial, method ascii"),
        (hub({"name": "x", "address": 1}, type="serial", port=502), "a serial hub has no port"),
        (hub({"name": "x", "address": 1}, type="serial", port="/dev/ttyS0"), "/dev/ttyS0 has no speed"),
        (hub({"name": "x", "address": 1}, type="serial", port="/dev/ttyS0", baudrate=9600, parity="X"), "parity 'X'"),
        (hub(), "without sensors or switches"),
        (hub({"address": 1}), "has no name"),
        (hub({"name": "x"}), "x: address None is no number"),
        (hub({"name": "x", "address": 70000}), "is no whole number from 0 to 65535"),
        (hub({"name": "x", "address": 1, "data_type": "custom"}), "structure None is not one number"),
        (hub({"name": "x", "address": 1, "swap": "all"}), "x: swap 'all' is not known"),
        (hub({"name": "x", "address": 1, "scale": "ten"}), "x: scale 'ten' is no number"),
        (hub({"name": "x", "address": 1}, host=None), "a hub has no host"),
        (hub({"name": "x", "address": 1}, host="10.0.0.256"), "hub hub: host: '10.0.0.256' is no address"),
        (hub({"name": "x", "address": 1}, host="10.0.0.9:502"), "holds a port; write host = "),
        (hub({"name": "x", "address": 1}, host="my plc", type="rtuovertcp"), "is no name of a host"),
        (hub({"name": "x", "address": 1}, {"name": "y", "address": 1}), "is x's already"),
    ],
)
def test_each_mistake_in_a_home_assistant_file_is_named(document, said):
    text = complaint(lambda: draft_of(Path("ha.yaml"), placed(document)))
    assert said in text
    assert "ha.yaml, line " in text


HOME = """\
modbus:
  - name: hub
    type: tcp
    host: chiller.local
    port: 502
    sensors:
      - name: Flow
        address: 0x10
        slave: 1
        data_type: float32
"""


def test_yaml_without_its_reader_is_refused_with_the_package_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "yaml", None)
    with pytest.raises(ImportFileError, match="takes PyYAML to read; install it"):
        import_homeassistant(table(tmp_path, HOME, "ha.yaml"))


def test_yaml_is_read_with_its_lines(tmp_path):
    source = table(tmp_path, HOME, "ha.yaml")
    (point,) = written(tmp_path, import_homeassistant(source)).point
    assert (point.name, point.address, point.type) == ("Flow", 16, "float32")
    with pytest.raises(ImportFileError, match=r"ha.yaml, line 8: Flow: address 'ten'"):
        import_homeassistant(table(tmp_path, HOME.replace("0x10", "ten"), "ha.yaml"))
    with pytest.raises(ImportFileError, match=r"ha.yaml, line \d+: is not valid YAML"):
        import_homeassistant(table(tmp_path, HOME.replace("host: ", "host: [", 1), "ha.yaml"))
    with pytest.raises(ImportFileError, match=r"ha.yaml, line 4: hub hub: host: '010.0.0.1' is no"):
        import_homeassistant(table(tmp_path, HOME.replace("chiller.local", "'010.0.0.1'"), "ha.yaml"))


VALUES = st.one_of(
    st.none(), st.booleans(), st.integers(-5, 70000), st.floats(), st.text(max_size=5), st.just([1]), st.just({})
)


def test_entries_that_stand_for_several_become_all_of_them(tmp_path):
    document = hub(
        {"name": "T", "address": 10, "data_type": "int32", "scale": 0.01, "virtual_count": 2},
        binary_sensors=[{"name": "Door", "address": 3, "slave_count": 1}],
    )
    by_name = {point.name: point for point in written(tmp_path, draft_of(Path("ha.yaml"), placed(document))).point}
    assert {name: (p.table, p.address) for name, p in by_name.items()} == {
        "T": ("holding", 10),
        "T_1": ("holding", 12),
        "T_2": ("holding", 14),
        "Door": ("coil", 3),
        "Door_1": ("coil", 4),
    }
    assert {by_name[name].scale for name in ("T", "T_1", "T_2")} == {0.01}


def test_a_switch_is_read_where_it_is_verified(tmp_path):
    verify = {"address": 8, "input_type": "input", "state_on": [3], "state_off": 0, "delay": 1}
    switch = {"name": "Fan", "address": 2, "command_on": 5, "command_off": 4, "verify": verify}
    draft = draft_of(Path("ha.yaml"), placed(hub(switches=[switch])))
    fan, state = written(tmp_path, draft).point
    assert (fan.address, fan.access, fan.doc) == (2, "rw", "5 switches on, 4 switches off")
    assert (state.name, state.table, state.address, state.labels) == ("Fan_state", "input", 8, {"3": "on", "0": "off"})
    assert draft.notes == []


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"unique_id": "a1", "scan_interval": 5, "precision": 1}, None),
        ({"zero_suppress": 0.2}, "key zero_suppress of x was not used; small values are kept"),
        ({"skale": 0.1}, "key skale of x was not used; see if it changes a value"),
        ({"min_value": 0}, "min_value or max_value alone is not taken over"),
        ({"slave": 1, "device_address": 2}, "slave and device_address differ"),
        ({"count": 2}, "int16 takes 1 registers and count is 2"),
        ({"data_type": "custom", "structure": ">hh", "count": 2}, "is not one number of registers"),
        ({"name": "${room}"}, "name is ${room}; write what that stands for"),
        ({"address": Placed("base", 9, "!secret")}, "line 9: x: address is !secret base; write what that stands for"),
    ],
)
def test_every_key_of_an_entry_is_used_or_harmless_or_noted(more, said):
    good = {"name": "good", "address": 90}
    draft = draft_of(Path("ha.yaml"), placed(hub({"name": "x", "address": 1} | more, good)))
    assert "good" in [point.name for point in draft.buses[0].points]
    notes = [note for note in draft.notes if said is not None and said in note]
    assert len(notes) == len(draft.notes) == (said is not None)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"data_type": "custom", "structure": ">f", "count": 2}, ("float32", "ABCD")),
        ({"data_type": "uint", "count": 4, "reverse_order": True}, ("uint64", "CDAB")),
        ({"data_type": "int", "swap": "word_byte", "count": 2}, ("int32", "DCBA")),
    ],
)
def test_older_and_custom_types_keep_their_meaning(tmp_path, more, said):
    (point,) = written(tmp_path, draft_of(Path("ha.yaml"), placed(hub({"name": "x", "address": 1} | more)))).point
    assert (point.type, point.order) == said


def test_a_host_that_only_stands_for_one_is_refused():
    document = placed(hub({"name": "x", "address": 1}))
    document.value["modbus"].value[0].value["host"] = Placed("gateway", 4, "!secret")
    with pytest.raises(ImportFileError, match=r"ha.yaml, line 4: hub hub: host is !secret gateway; write what that"):
        draft_of(Path("ha.yaml"), document)


def test_a_section_of_another_file_is_named_and_its_neighbours_are_taken():
    document = placed(hub(switches=[{"name": "Fan", "address": 2}]))
    document.value["modbus"].value[0].value["sensors"] = Placed("more.yaml", 6, "!include")
    draft = draft_of(Path("ha.yaml"), document)
    assert draft.notes == ["line 6: sensors are in more.yaml; put its entries here, or give that file (left out)"]
    assert [point.name for point in draft.buses[0].points] == ["Fan"]
    with pytest.raises(ImportFileError, match=r"line 1: modbus is !include hubs.yaml; give that file"):
        draft_of(Path("ha.yaml"), Placed({"modbus": Placed("hubs.yaml", 1, "!include")}, 1))


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_any_home_assistant_entry_is_imported_well_or_refused(tmp_path_factory, data):
    keys = ["name", "address", "input_type", "data_type", "scale", "offset", "swap", "count", "slave", "nan_value"]
    keys += ["min_value", "max_value", "unit_of_measurement"]
    entry = {"name": "x", "address": 1}
    entry |= data.draw(st.dictionaries(st.sampled_from(keys), VALUES, max_size=4))
    more = data.draw(
        st.dictionaries(st.sampled_from(["host", "port", "type", "switches", "binary_sensors"]), VALUES, max_size=2)
    )
    try:
        draft = draft_of(Path("ha.yaml"), placed(hub(entry, **more)))
    except ImportFileError as error:
        assert "ha.yaml" in str(error)
    else:
        written(tmp_path_factory.mktemp("fuzz"), draft)


@pytest.mark.parametrize(("kinds", "is_declared"), [(["holdings", "coils"], True), (["holding", "coil"], None)])
def test_a_switch_that_is_written_with_function_16_declares_it(kinds, is_declared):
    switches = [{"name": f"s{k}", "address": k, "write_type": kind} for k, kind in enumerate(kinds)]
    draft = draft_of(Path("ha.yaml"), placed(hub(switches=switches)))
    assert draft.buses[0].keys.get("write_multiple") is is_declared


def test_hubs_of_packages_are_read():
    packages = {"homeassistant": {"packages": {"a": hub({"name": "x", "address": 1}), "b": {"light": []}}}}
    draft = draft_of(Path("ha.yaml"), placed(packages))
    assert [point.name for bus in draft.buses for point in bus.points] == ["x"]


@pytest.mark.parametrize(
    "switch",
    [
        {"command_on": 0, "command_off": 1},
        {"command_on": 0, "command_off": 0},
        {"command_on": 1, "command_off": 1},
        {"verify": {"input_type": "discrete_input", "address": 9, "state_on": 0, "state_off": 1}},
        {"verify": {"input_type": "coil", "address": 9, "state_on": [1, 0]}},
    ],
)
def test_an_inverted_coil_is_left_out(tmp_path, switch):
    written_as = {"name": "Heater", "address": 5, "write_type": "coil"} | switch
    beside = {"name": "Fan", "address": 6, "write_type": "coil", "command_on": 1, "command_off": 0}
    draft = draft_of(tmp_path / "ha.yaml", placed(hub(switches=[written_as, beside])))
    assert [point.name for point in draft.buses[0].points] == ["Fan"]
    assert any("an inverted bit is not read here" in note and "left out" in note for note in draft.notes)
