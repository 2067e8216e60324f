"""Twin files: what is refused, in which words, and that writing loses nothing."""

import errno
import resource
from pathlib import Path

import numpy as np
import pytest

from twin.network import Network, Revision, TwinFileError
from twin.twinfile import dump, load, parse, save

BAD = {
    "kind": ('kind = "flow"', 'kind = "flwo"', "unknown kind 'flwo'; did you mean 'flow'"),
    "key": ("capacitance = { value = 3000.0", "capacitanse = { value = 3000.0", "did you mean 'capacitance'"),
    "node": ('to = "tank"', 'to = "tnak"', "no such node 'tnak'; did you mean 'tank'"),
    "negative": ("{ value = 3000.0, lower", "{ value = -3000.0, lower", "outside its bounds"),
    "unphysical bounds": ("value = 3000.0, lower = 300.0", "value = 3000.0, lower = -5.0", "must lie in order inside"),
    "unit": ("value = 3000.0,", 'value = 3000.0, unit = "kJ/K",', "unit 'kJ/K' is not 'J/K'"),
    "input in other degrees": (
        '22.0, lower = -40.0, upper = 60.0, unit = "degC"',
        '72.0, unit = "°F"',
        "means degC; convert",
    ),
    "input in other watts": (
        'upper = 5000.0, unit = "W"',
        'upper = 5000.0, unit = "kW"',
        "means W; convert",
    ),
    "status": ("value = 3000.0,", 'value = 3000.0, status = "free",', "status 'free' is not one of"),
    "not a number": ("{ value = 3000.0,", '{ value = "big",', "must be a finite number"),
    "missing": ("nominal = { value = 3.785", "factor_ = { value = 3.785", "unknown key"),
    "input": ('fan = "fan_speed_pct"', 'fan = "fan_sped_pct"', "no such input 'fan_sped_pct'; did you mean"),
    "input in W": (
        'pump = "pump_speed_pct"',
        'pump = "heater_power_W"',
        "elements.circuit.pump: 'heater_power_W' is in W, and pump is read in %; convert the column to %, and end its "
        "name in _pct",
    ),
    "sensor on nothing": ('node = "tank"\ncolumns', 'node = "lake"\ncolumns', "no such node 'lake'"),
    "no columns": ('columns = ["T_tank_C"]', "columns = []", "must be a list of names"),
    "column twice": ('columns = ["T_tank_C"]', 'columns = ["T_heater_C"]', "already read by sensor"),
    "column unit": ('columns = ["T_tank_C"]', 'columns = ["T_tank_F"]', "does not end in _C"),
    "path": ('"radiator", "tank"]', '"radiator", "tank", "heater"]', "each once"),
    "driver": ('driver = "heater_power_W"', 'driver = "fan_speed_pct"', "is not a power"),
    "same node": ('from = "radiator"', 'from = "tank"', "both ends are the same node"),
    "set": ('"heater.capacitance", "mod', '"heater.capacitanc", "mod', "did you mean 'heater.capacitance'"),
    "initial": ("initial = [0.0, 3.0]", "initial = [3.0, 0.0]", "must be below the second"),
    "window": ("window_s = 600.0", "window_s = -1.0", "must be positive"),
    "format": ("format = 1", "format = 2", "must be 1"),
    "top": ("[windows]", "[window]", "did you mean 'windows'"),
    "nominal": ("nominal = 700.0, ", "", "nominal is missing"),
    "toml": ("[inputs]", "[inputs", "is not valid TOML"),
    "name": ("[elements.tank_loss]", '[elements."tank loss"]', "digits and underscores"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_files_get_one_sentence(case: str, loop_text: str) -> None:
    old, new, words = BAD[case]
    assert old in loop_text
    with pytest.raises(TwinFileError) as caught:
        parse(loop_text.replace(old, new, 1), "rig.toml")
    message = str(caught.value)
    assert message.startswith("rig.toml")
    assert words in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("column", "declared", "unit"),
    [("pump_rpm", "", "rpm"), ("pump_speed", "rpm", "rpm"), ("pump_Hz", "Hz", "Hz"), ("pump_speed", "", None)],
)
def test_an_input_in_another_unit_than_it_is_read_in_is_refused(
    loop_text: str, column: str, declared: str, unit: str | None
) -> None:
    text = loop_text.replace("pump_speed_pct", column).replace(
        'upper = 100.0, unit = "%"', f'upper = 100.0, unit = "{declared}"', 1
    )
    if unit is None:
        assert column in parse(text).inputs
        return
    with pytest.raises(TwinFileError, match=rf"'{column}' is in {unit}, and pump is read in %"):
        parse(text)


@pytest.mark.parametrize("column", ["T_room_K", "T_room_F", "room_bar"])
def test_an_ambient_that_is_not_in_degrees_celsius_is_refused(column: str) -> None:
    text = SEPARATE.replace("T_ambient_C", column).replace(', unit = "degC"', "")
    text = text.replace("hA = 0.01", f'ambient = "{column}", hA = 0.01')
    with pytest.raises(TwinFileError, match=rf"'{column}' is in .*, and ambient is read in degC; .* name in _C"):
        parse(text)


def test_the_line_is_named(loop_text: str) -> None:
    bad = loop_text.replace("{ value = 1.5, lower = 0.01", "{ value = 99.0, lower = 0.01", 1)
    line = bad[: bad.index("value = 99.0")].count("\n") + 1
    with pytest.raises(TwinFileError, match=rf"rig.toml, line {line}: elements.heater_loss.hA"):
        parse(bad, "rig.toml")


def test_an_unreachable_node_and_a_second_feed_are_found(loop_text: str) -> None:
    island = loop_text + '\n[elements.island]\nkind = "node"\ncapacitance = 100.0\n'
    with pytest.raises(TwinFileError, match="no heat can reach this node"):
        parse(island)
    second = '\n[elements.spur]\nkind = "flow"\npath = ["tank", "heater"]\npump = "pump_speed_pct"\nnominal = 1.0\n'
    with pytest.raises(TwinFileError, match="two flows need a mixer"):
        parse(loop_text + second)


SEPARATE = """
format = 1
name = "two heaters"
[inputs]
heater_1_pct = { nominal = 0.0, lower = 0.0, upper = 100.0, unit = "%" }
T_ambient_C = { nominal = 24.0, lower = 0.0, upper = 50.0, unit = "degC" }
[elements]
one = { kind = "node", capacitance = 2.0 }
two = { kind = "node", capacitance = 2.0 }
power = { kind = "heat_source", node = "one", driver = "heater_1_pct", law = "linear", gain = 0.01 }
loss_1 = { kind = "ambient_loss", node = "one", hA = 0.01 }
loss_2 = { kind = "ambient_loss", node = "two", hA = 0.01 }
T1_C = { kind = "sensor", node = "one", columns = ["T1_C"], sigma = 0.2 }
T2_C = { kind = "sensor", node = "two", columns = ["T2_C"], sigma = 0.2 }
"""


def test_volumes_that_exchange_no_heat_may_each_have_their_own_way_to_the_room() -> None:
    assert parse(SEPARATE).nodes == ("one", "two")
    cut_off = SEPARATE.replace('loss_2 = { kind = "ambient_loss", node = "two", hA = 0.01 }\n', "")
    with pytest.raises(TwinFileError, match=r"elements\.two: no heat can reach this node"):
        parse(cut_off)


def test_a_network_needs_nodes_and_sensors() -> None:
    with pytest.raises(TwinFileError, match="there is no node"):
        parse('format = 1\nname = "x"\n[inputs]\n[elements]\n')
    with pytest.raises(TwinFileError, match="elements: there is no sensor"):
        parse('format = 1\nname = "x"\n[inputs]\n[elements.a]\nkind = "node"\ncapacitance = 100.0\n')


def test_writing_and_reading_give_the_same_network(loop: Network) -> None:
    revision = Revision(
        3, "ab" * 32, 'a "quoted" maker', (0.0, 100.0), {"T_tank_C": 1.5}, {"T_tank_C": 0.1}, notes=("n",)
    )
    changed = loop.with_values({"fins.UA_100": 71.25}, revision)
    again = parse(dump(changed))
    assert again.parameters == changed.parameters
    assert again.elements == changed.elements
    assert (again.inputs, again.sets, again.rules) == (changed.inputs, changed.sets, changed.rules)
    assert again.revision == revision
    assert dump(again) == dump(changed)


def test_a_file_is_never_overwritten(loop: Network, tmp_path: Path) -> None:
    path = save(loop, tmp_path / "twin.toml")
    text = path.read_text()
    with pytest.raises(TwinFileError, match="never overwritten"):
        save(loop.with_values({"fins.UA_100": 71.0}), path)
    assert path.read_text() == text
    assert load(path).digest != ""


def test_a_full_disk_leaves_no_part_of_a_twin_and_the_next_attempt_writes_it(loop: Network, tmp_path: Path) -> None:
    path, (soft, hard) = tmp_path / "twin.toml", resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (600, hard))
    try:
        with pytest.raises(TwinFileError, match="cannot be written"):
            save(loop, path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert list(tmp_path.iterdir()) == []
    assert load(save(loop, path)).name == loop.name and list(tmp_path.iterdir()) == [path]


def test_a_file_system_without_links_takes_a_twin_too(
    loop: Network, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr("os.link", refused)
    path = save(loop, tmp_path / "twin.toml")
    assert load(path).name == loop.name and list(tmp_path.iterdir()) == [path]
    with pytest.raises(TwinFileError, match="exists already"):
        save(loop, path)


def test_absent_and_binary_files(tmp_path: Path) -> None:
    with pytest.raises(TwinFileError, match="cannot be read"):
        load(tmp_path / "absent.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(TwinFileError, match="not UTF-8"):
        load(tmp_path / "binary.toml")


def test_values_out_of_bounds_and_unknown_names(loop: Network) -> None:
    with pytest.raises(TwinFileError, match="outside"):
        loop.with_values({"fins.UA_100": -1.0})
    with pytest.raises(TwinFileError, match=r"did you mean 'fins\.UA_100'"):
        loop.with_values({"fins.UA_10": 1.0})
    with pytest.raises(TwinFileError, match="no set of tunables 'ten'"):
        loop.tunables("ten")


def test_the_papers_sets(loop: Network) -> None:
    assert [len(loop.sets[name].members) for name in ("paper4", "nine", "twelve")] == [4, 9, 12]
    four = loop.sets["paper4"]
    assert four.bounds == (0.0, 8.0)
    assert four.initial == ((0.0, 3.0), (0.0, 1.0), (0.0, 2.0), (0.0, 1.0))


def test_selecting_columns(loop: Network) -> None:
    n = 5
    columns = {c: np.full(n, 20.0) for c in loop.input_columns}
    columns |= {c: np.full(n, 30.0) for s in loop.sensors for c in s.measured}
    columns["T_pm1_C"] = np.array([36.0, np.nan, np.inf, 30.0, 30.0])
    columns["T_tank_C"] = np.array([np.nan, 1.0, 1.0, 1.0, 1.0])
    del columns["T_pm6_C"]
    inputs, measured = loop.select(columns)
    assert inputs.shape == (n, 4)
    assert measured[:3, 1] == pytest.approx([31.2, 30.0, 30.0])
    assert np.isnan(measured[0, 3])
    with pytest.raises(TwinFileError, match="the record lacks fan_speed_pct, which twin 'loop' needs"):
        loop.select({c: v for c, v in columns.items() if c != "fan_speed_pct"})
    with pytest.raises(TwinFileError, match="differ in length"):
        loop.select(columns | {"T_heater_C": np.zeros(3)})
    # A sensor that is missing is one that says nothing; a record that lacks most of them is another rig's.
    fewer = {c: v for c, v in columns.items() if c not in ("T_tank_C", "T_heater_C")}
    assert loop.unread(fewer) == ("T_heater_C", "T_tank_C")
    assert np.isnan(loop.select(fewer)[1][:, [0, 3]]).all()
    with pytest.raises(TwinFileError, match="the record lacks T_heater_C, T_radiator_C, T_tank_C"):
        loop.select({c: v for c, v in fewer.items() if c != "T_radiator_C"})


def test_initial_state_fills_what_is_not_measured(loop: Network) -> None:
    assert loop.initial_state([30.0, np.nan, 20.0, 10.0]) == pytest.approx([30.0, 20.0, 20.0, 10.0])
    assert loop.initial_state(np.full(4, np.nan)) == pytest.approx(np.full(4, 22.0))


def test_a_shared_parameter_must_name_one_with_a_value(loop_text: str) -> None:
    text = loop_text.split("# --- windows")[0].replace(
        "hA = { value = 1.0, lower = 0.01", 'hA = { same_as = "tank_loss.hA" }\n#'
    )
    net = parse(text)
    assert net.parameters["modules_loss.hA"].value == net.parameters["tank_loss.hA"].value
    with pytest.raises(TwinFileError, match="is the same as"):
        net.with_values({"modules_loss.hA": 3.0})
    for wrong, words in (("tank_los.hA", "did you mean"), ("tank.capacitance", "value of its own, in W/K")):
        with pytest.raises(TwinFileError, match=words):
            parse(text.replace('same_as = "tank_loss.hA"', f'same_as = "{wrong}"'))


PIPE = '\n[elements.{name}]\nkind = "pipe"\nto = "{to}"\nvolume = 0.3\n'
RELAY = '\n[elements.{name}]\nkind = "actuator"\ncolumn = "fan_speed_pct"\n'


@pytest.mark.parametrize(
    ("extra", "words"),
    [
        (PIPE.format(name="a", to="lake"), "no such node 'lake'"),
        (
            '\n[elements.shelf]\nkind = "node"\ncapacitance = 50.0\n[elements.x]\nkind = "conduction"\n'
            'from = "shelf"\nto = "tank"\nresistance = 1.0\n' + PIPE.format(name="a", to="shelf"),
            "no flow path names 'shelf'",
        ),
        (PIPE.format(name="a", to="tank") + PIPE.format(name="b", to="tank"), "already has the pipe 'a'"),
        (RELAY.format(name="a") + RELAY.format(name="b"), "already has the actuator 'a'"),
        (PIPE.format(name="a", to="tank").replace("0.3", "-0.3"), "outside its bounds"),
        (
            '\n[elements.other]\nkind = "flow"\npath = ["tank", "heater"]\npump = "pump_speed_pct"\nnominal = 1.0\n',
            "already fed by 'circuit'; two flows need a mixer",
        ),
        ('\n[elements.lonely]\nkind = "flow"\npath = ["tank"]\npump = "pump_speed_pct"\nnominal = 1.0\n', "inlet"),
        (
            '\n[elements.cold]\nkind = "conduction"\nfrom = "tank"\nto = "heater"\nresistance = 0.0\n',
            "outside its bounds",
        ),
    ],
)
def test_networks_that_cannot_be(loop_text: str, extra: str, words: str) -> None:
    head, tail = loop_text.split("# --- windows")
    with pytest.raises(TwinFileError) as caught:
        parse(head + extra + "\n# --- windows" + tail)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
