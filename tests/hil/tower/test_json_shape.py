"""Shapes of JSON documents, and the files of a tower that are checked by them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from hil.record import RecordError
from hil.tower.station import misfit, read_datasheet, read_notes

SHAPE = {
    "n": float,
    "k?": int,
    "s?": str,
    "b?": bool,
    "in?": {"x": float},
    "list?": [{"y": int}],
    "share?": (0.0, 1.0),
    "way?": frozenset(("a", "b")),
}


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({}, ""),
        ({"n": 3, "k": 3, "s": "x", "b": True, "in": {"x": 1, "more": []}, "list": [{"y": 1}], "share": 1}, ""),
        ({"n": "x"}, "n is 'x', which is not a number"),
        ({"n": True}, "n is True, which is not a number"),
        ({"n": float("nan")}, "n is nan, which is not a number"),
        ({"n": 10**400}, "which is not a number"),
        ({"k": 1.5}, "k is 1.5, which is not a whole number"),
        ({"s": 1}, "s is 1, which is not a text"),
        ({"s": "\ud800"}, "s is '\\ud800', which is not a text"),
        ({"b": 1}, "b is 1, which is not true or false"),
        ({"in": []}, "in is [], which is not an object"),
        ({"in": {}}, "in.x is missing"),
        ({"list": {"y": 1}}, "list is {'y': 1}, which is not a list"),
        ({"list": [{"y": 1}, {"y": "z"}]}, "list[1].y is 'z', which is not a whole number"),
        ({"share": 1.5}, "share is 1.5, outside 0 to 1"),
        ({"way": "c"}, "way is 'c', which is not one of a, b"),
    ],
)
def test_the_first_misfit_is_named_with_its_place(changed: dict[str, Any], says: str) -> None:
    found = misfit({"n": 1.0} | changed, SHAPE)
    assert says in found and bool(found) == bool(says)
    assert misfit([], SHAPE) == "it is [], which is not an object"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('{"design": "big"}', "design is 'big', which is not an object"),
        ('{"design": []}', "design is [], which is not an object"),
        ('{"design": {"pressure_kPa": "abc"}}', "design.pressure_kPa is 'abc', which is not a number"),
        ('{"design": {"water_flow_kg_s": "2853 gpm"}}', "design.water_flow_kg_s is '2853 gpm', which is not a number"),
        ('{"fan": 60}', "fan is 60, which is not an object"),
        ('{"timezone": []}', "timezone is [], which is not a text"),
        ('{"basin": {"compartments": 1.5}}', "basin.compartments is 1.5, which is not a whole number"),
        ("[" * 100_000, "is not valid JSON: it is nested too deeply"),
    ],
)
def test_a_datasheet_of_another_shape_is_one_sentence(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "sheet.json"
    path.write_text(text)
    with pytest.raises(RecordError) as refused:
        read_datasheet(path)
    assert str(refused.value).startswith(f"{path}: ") and says in str(refused.value)
    assert str(refused.value).endswith("; correct the datasheet") and "\n" not in str(refused.value)


def test_what_a_datasheet_gives_as_null_is_not_given(tmp_path: Path) -> None:
    path = tmp_path / "sheet.json"
    path.write_text('{"design": null, "fan": {"speed_100pct": null, "x": 1}}')
    assert read_datasheet(path) == {"fan": {"x": 1}}


EVENT = {
    "time": "2022-05-01T00:00:00Z",
    "by_day": False,
    "cell": 1,
    "kind": "cleaning",
    "source": "DCS",
    "text": "",
    "from": "2022-05-01T00:00:00Z",
    "to": "2022-05-02T00:00:00Z",
    "parameters": ["fill"],
}


@pytest.mark.parametrize(
    ("document", "says"),
    [
        ({"datasheet": [], "events": []}, "datasheet is [], which is not an object"),
        ({"datasheet": {}, "events": {}}, "events is {}, which is not a list"),
        ({"events": []}, "datasheet is missing"),
        ({"datasheet": {"design": {"water_inlet_C": "x"}}, "events": []}, "design.water_inlet_C is 'x'"),
        ({"datasheet": {}, "events": [EVENT | {"cell": "1"}]}, "events[0].cell is '1'"),
        ({"datasheet": {}, "events": [EVENT, EVENT | {"time": "soon"}]}, "events[1].time is 'soon', which is no time"),
        ({"datasheet": {}, "events": [EVENT | {"parameters": ["scale"]}]}, "events[0].parameters[0] is 'scale'"),
    ],
)
def test_notes_of_another_shape_are_refused(tmp_path: Path, document: Any, says: str) -> None:
    (tmp_path / "station.json").write_text(json.dumps(document))
    with pytest.raises(RecordError) as refused:
        read_notes(tmp_path)
    assert says in str(refused.value) and str(refused.value).endswith("; align the store again")


def test_a_record_without_notes_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"station.json: is missing; align the store again"):
        read_notes(tmp_path)
    (tmp_path / "station.json").write_text(json.dumps({"datasheet": {}, "events": [EVENT]}))
    assert read_notes(tmp_path).events == (EVENT,)


@pytest.mark.parametrize("text", ['{"station": null, "design": null}', '{"design": {"pressure_kPa": null}}'])
def test_a_datasheet_of_nulls_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "datasheet.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(RecordError, match="none of its keys has a value; correct the datasheet"):
        read_datasheet(path)
    path.write_text('{"station": "A", "design": null}', encoding="utf-8")
    assert read_datasheet(path) == {"station": "A"}
