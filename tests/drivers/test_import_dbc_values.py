"""Value tables and multiplexed signals of DBC files: special codes are no readings."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from drivers.bus.contract import judge
from drivers.can.dbc import bind
from drivers.importers.dbc import import_dbc
from drivers.importers.dbc_values import means_no_value
from drivers.importers.draft import Draft, ImportFileError
from drivers.rig_file.model import Rig
from drivers.signals.points import ConfigurationError, Quality
from tests.drivers.import_files import table, written

HEAD = 'VERSION ""\n\nBS_:\n\nBU_: PLC PC\n\n'
CAN = {"transport": "socketcan", "channel": "vcan0"}


def imported(tmp_path: Path, text: str) -> tuple[Draft, Rig]:
    draft = import_dbc(table(tmp_path, HEAD + text, "bus.dbc"), tmp_path / "rig.toml", dict(CAN))
    return draft, written(tmp_path, draft)


def message(*signals: str, after: str = "") -> str:
    return "BO_ 300 Tank: 8 PLC\n" + "".join(f" SG_ {signal} PC\n" for signal in signals) + f"\n{after}\n"


def test_a_code_for_no_value_of_a_scaled_signal_is_invalid_and_the_rest_is_measured(tmp_path):
    text = message(
        'T_in : 0|16@1+ (0.02,-100) [-50|180] "degC"',
        after='VAL_ 300 T_in 65535 "Signal_Not_Available" 65533 "Fehler" ;',
    )
    draft, rig = imported(tmp_path, text)
    point = rig.get("T_in")
    assert (point.kind, point.labels, point.plausible) == ("measured", None, (-50.0, 180.0))
    assert point.invalid == (1210.66, 1210.7)
    assert judge(point, 65535 * 0.02 - 100)[1] == Quality.SENSOR_FAULT
    assert judge(point, 41.5) == (41.5, Quality.GOOD)
    assert draft.notes == []


def test_a_signed_code_is_the_number_that_comes_out_of_the_signal(tmp_path):
    text = message('P : 0|16@1- (10,0) [0|0] "W"', after='VAL_ 300 P 32768 "Sensor defect" ;')
    assert imported(tmp_path, text)[1].get("P").invalid == (-327680.0,)


def test_names_of_states_make_an_enumeration_and_names_of_some_readings_a_note(tmp_path):
    text = message(
        'Mode : 0|8@1+ (1,0) [0|0] ""',
        'Valve : 8|8@1+ (1,0) [0|100] "%"',
        'Ready : 16|2@1+ (1,0) [0|3] ""',
        after=(
            'VAL_ 300 Mode 0 "Off" 1 "Heat" 2 "Cool" 255 "SNA" ;\nVAL_ 300 Valve 0 "Closed" 100 "Open" 255 "Error" ;\n'
            'VAL_ 300 Ready 0 "no" 1 "yes" 3 "not available" ;'
        ),
    )
    draft, rig = imported(tmp_path, text)
    assert rig.get("Mode").labels == {"0": "Off", "1": "Heat", "2": "Cool", "255": "SNA"}
    assert rig.get("Ready").kind == "status"
    valve = rig.get("Valve")
    assert (valve.kind, valve.invalid) == ("measured", (255.0,))
    assert judge(valve, 100.0) == (100.0, Quality.GOOD)
    assert ["0 is 'Closed', 100 is 'Open'" in note for note in draft.notes] == [True]


@pytest.mark.parametrize(
    ("name", "is_none"),
    [
        ("SensorFault", True),
        ("Kurzschluss", True),
        ("Drahtbruch", True),
        ("non disponible", True),
        ("open circuit", True),
        ("no signal", True),
        ("no error", False),
        ("kein Fehler", False),
        ("Full", False),
    ],
)
def test_names_that_say_that_there_is_no_value(name, is_none):
    assert means_no_value(name) is is_none


@pytest.mark.parametrize("selector", [(), ('Page M : 0|8@1+ (1,0) [0|9] ""', 'Sub M : 8|8@1+ (1,0) [0|9] ""')])
def test_a_multiplexed_signal_without_one_selector_is_read_neither_at_import_nor_later(tmp_path, selector):
    text = message(*selector, 'T_w m4 : 16|16@1- (0.1,0) [0|0] "degC"', 'T_x : 32|16@1- (0.1,0) [0|0] "degC"')
    draft, rig = imported(tmp_path, text)
    line = 8 + len(selector)
    assert "T_w" not in [point.name for point in rig.point]
    assert any(note.startswith(f"line {line}: T_w: is multiplexed (m4)") for note in draft.notes)
    by_hand = rig.get("T_x").model_copy(update={"name": "w", "signal": "T_w"})
    with pytest.raises(ConfigurationError, match=rf"bus\.dbc, line {line}: signal T_w of point w is multiplexed"):
        bind("can", rig.bus["can"], [by_hand])


def test_what_hangs_on_a_selector_that_is_lost_is_left_out_too(tmp_path):
    text = message(
        'Page M : 0|8@1+ (1,0) [0|9] ""',
        'Sub m1M : 8|8@1+ (1,0) [0|9] ""',
        'T_w m2 : 16|16@1- (0.1,0) [0|0] "degC"',
        after="SG_MUL_VAL_ 300 T_w Sub 2-2;",
    )
    draft, rig = imported(tmp_path, text)
    assert [point.name for point in rig.point] == ["Page"]
    assert [note[:13] for note in draft.notes] == ["line 9: Sub: ", "line 10: T_w:"]


def test_a_plain_signal_over_multiplexed_ones_costs_none_of_them(tmp_path):
    text = message(
        'Page M : 0|8@1+ (1,0) [0|9] ""',
        'T_w m1 : 8|16@1- (0.1,0) [0|0] "degC"',
        'T_x m2 : 8|16@1- (0.1,0) [0|0] "degC"',
        'Low : 16|16@1+ (1,0) [0|0] "W"',
    )
    _, rig = imported(tmp_path, text)
    (bound,) = bind("can", rig.bus["can"], rig.point)
    assert bound.decode(bytes([2, 0x64, 0, 5, 0, 0, 0, 0])) == {"Page": 2.0, "T_x": 10.0, "Low": 1280.0}
    assert bound.decode(bytes([7, 0x64, 0, 5, 0, 0, 0, 0])) == {"Page": 7.0, "Low": 1280.0}


def test_a_file_of_lost_multiplexed_signals_alone_is_refused_with_the_line(tmp_path):
    with pytest.raises(ImportFileError, match=r"line 8: T_w: is multiplexed \(m4\)"):
        imported(tmp_path, message('T_w m4 : 16|16@1- (0.1,0) [0|0] "degC"'))


@pytest.mark.parametrize("unit", ["U/min", "1/min", "RPM"])
def test_a_unit_of_one_meaning_is_taken_in_any_spelling_and_binds(tmp_path, unit):
    _, rig = imported(tmp_path, message(f'n : 0|16@1+ (1,0) [0|0] "{unit}"'))
    assert rig.get("n").unit == "rpm"
    assert bind("can", rig.bus["can"], rig.point)[0].decode(bytes([5, 0, 0, 0, 0, 0, 0, 0])) == {"n": 5.0}


def test_a_named_value_beyond_the_bits_of_its_signal_is_no_code(tmp_path):
    text = message('T_w : 0|16@1+ (0.1,0) [0|0] "degC"', after=f'VAL_ 300 T_w {"9" * 400} "error" 65535 "invalid" ;')
    _, rig = imported(tmp_path, text)
    assert rig.get("T_w").invalid == (6553.5,)


def test_a_number_of_thousands_of_digits_costs_no_time(tmp_path):
    begun = time.process_time()
    with pytest.raises(ImportFileError, match="line 8: T_w"):
        imported(tmp_path, message(f'T_w : 0|16@1+ (1,{"9" * 20_000} [0|0] "degC"'))
    assert time.process_time() - begun < 2.0
