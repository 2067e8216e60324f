"""Revisions: a network with something added, the chain of files it is saved in, and what differs between two."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.network import Network, Revision, TwinFileError
from twin.revisions import chain, diff, next_path, parent_of, revert, save_revision, with_elements
from twin.twinfile import dump, from_tables, is_edited, load, parse, read_text, save, to_tables

HEAT = {
    "kind": "heat_source",
    "node": "modules",
    "power": {"value": np.float64(181.0), "lower": 0.0, "upper": 400, "status": "tunable", "source": "diagnosis"},
}
EVIDENCE = Revision(
    made_by="a test",
    window_s=(0.0, 100.0),
    error_before_K={"T_tank_C": 0.91},
    error_after_K={"T_tank_C": 0.05},
    held_out_s=(100.0, 120.0),
    effects=("heat_source at modules, constant: 181 W",),
    evidence="The residual jumps at 40 s and stays.",
)


@pytest.fixture
def first(loop: Network, tmp_path: Path) -> Path:
    return save(loop.with_values({"fins.UA_100": 71.0}, Revision(1, made_by="a test")), tmp_path / "my_twin.toml")


def heated(path: Path, power: float = 181.0) -> Network:
    table: dict[str, Any] = HEAT | {"power": HEAT["power"] | {"value": power}}  # type: ignore[operator]
    return with_elements(load(path), {"extra": table}, revision=EVIDENCE)


def names(path: Path) -> list[str]:
    return [entry.path.name for entry in chain(path)]


# --- a network with something added ----------------------------------------------------------------------------


def test_an_element_is_added_and_the_old_network_stays(loop: Network) -> None:
    new = with_elements(loop, {"extra": HEAT}, {"tank_loss.hA": np.float64(1.5)}, EVIDENCE)
    assert "extra.power" not in loop.parameters
    assert new.parameters["extra.power"].value == 181.0
    assert new.parameters["extra.power"].status == "tunable"
    assert new.parameters["tank_loss.hA"].value == 1.5
    assert new.parameters["tank_loss.hA"].upper == loop.parameters["tank_loss.hA"].upper
    assert new.revision == EVIDENCE
    assert (new.digest, new.sets, new.rules) == ("", loop.sets, loop.rules)
    assert parse(dump(new)).parameters == new.parameters


def test_without_anything_to_do_nothing_changes(loop: Network) -> None:
    new = with_elements(loop, {})
    assert diff(loop, new).empty
    assert new.revision == loop.revision


def test_a_term_in_an_element_that_is_there(loop: Network) -> None:
    new = with_elements(
        loop,
        {},
        replace={
            "T_tank_C": {"other": "heater", "cross_talk": {"value": 0.02, "status": "tunable"}},
            "fins": {"fan_exponent": {"status": "tunable"}, "UA_100": 66},
        },
    )
    assert new.parameters["T_tank_C.cross_talk"].value == 0.02
    assert new.parameters["fins.fan_exponent"].status == "tunable"
    assert new.parameters["fins.fan_exponent"].value == loop.parameters["fins.fan_exponent"].value
    assert new.parameters["fins.UA_100"].value == 66.0
    again = with_elements(new, {}, replace={"T_tank_C": {"other": None, "cross_talk": None}})
    assert "T_tank_C.cross_talk" not in again.parameters


def test_a_new_input_column(loop: Network) -> None:
    humid = {"nominal": 10, "lower": -20.0, "upper": 40.0, "unit": "degC"}
    damp = {
        "kind": "heat_source",
        "node": "tank",
        "driver": "pump_power_W",
        "factor": {"value": 0.3, "lower": 0.0, "upper": 1.0},
    }
    power = {"nominal": 60.0, "lower": 0.0, "upper": 200.0, "unit": "W"}
    new = with_elements(loop, {"pump_heat": damp}, inputs={"pump_power_W": power, "T_dew_C": humid})
    assert new.inputs["T_dew_C"].nominal == 10.0
    assert new.input_columns[: len(loop.input_columns)] == loop.input_columns
    assert with_elements(new, {}, inputs={"T_dew_C": humid}).inputs == new.inputs
    with pytest.raises(TwinFileError, match="another input 'T_dew_C' already"):
        with_elements(new, {}, inputs={"T_dew_C": humid | {"upper": 50.0}})
    with pytest.raises(TwinFileError, match="no such input 'pump_power_W'"):
        with_elements(loop, {"pump_heat": damp})


def test_a_shared_value_is_changed_where_it_is(loop: Network) -> None:
    lid = to_tables(loop)["elements"]["modules_loss"] | {"hA": {"same_as": "tank_loss.hA"}}
    net = with_elements(loop, {"lid": lid})
    assert with_elements(net, {}, {"tank_loss.hA": 1.25}).parameters["lid.hA"].value == 1.25
    with pytest.raises(TwinFileError, match=r"lid\.hA of twin 'loop' is the same as tank_loss\.hA; change that one"):
        with_elements(net, {}, {"lid.hA": 1.25})
    with pytest.raises(TwinFileError, match=r"lid\.hA is the same as tank_loss\.hA; change that one"):
        with_elements(net, {}, replace={"lid": {"hA": {"status": "tunable"}}})
    own = with_elements(net, {}, replace={"lid": {"hA": {"value": 1.0, "status": "tunable"}}})
    assert own.parameters["lid.hA"].same_as == ""
    with pytest.raises(TwinFileError, match=r"modules_loss\.hA is the same as tank_loss\.hA; list that one"):
        with_elements(loop, {}, replace={"modules_loss": {"hA": {"same_as": "tank_loss.hA"}}})


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"tables": {"tank": HEAT}}, "has an element 'tank' already; name the new one otherwise"),
        ({"tables": {"extra": HEAT | {"node": "tnak"}}}, "no such node 'tnak'; did you mean 'tank'"),
        ({"tables": {"extra": HEAT | {"kind": "heat_sauce"}}}, "did you mean 'heat_source'"),
        ({"tables": {"extra": HEAT | {"kind": ["heat_source"]}}}, "unknown kind ['heat_source']"),
        ({"tables": {"extra": HEAT | {"power": 1.0e9}}}, "outside its bounds"),
        ({"tables": {"extra": HEAT | {"power": float("nan")}}}, "must be a finite number"),
        ({"tables": {"extra heat": HEAT}}, "letters A to Z without accents, digits and underscores"),
        ({"tables": {"extra": "heat"}}, "must be a table"),
        ({"tables": {}, "values": {"fins.UA_10": 1.0}}, "did you mean 'fins.UA_100'"),
        ({"tables": {}, "values": {"fins.UA_100": -1.0}}, "outside its bounds"),
        ({"tables": {}, "values": {"fins.UA_100": float("inf")}}, "must be a finite number"),
        ({"tables": {}, "replace": {"fin": {"UA_100": 1.0}}}, "no element 'fin'; did you mean 'fins'"),
        ({"tables": {}, "replace": {"fins": {"UA_10": 1.0}}}, "did you mean 'UA_100'"),
        ({"tables": {}, "revision": Revision(error_after_K={"T_tank_C": float("nan")})}, "must be a finite number"),
    ],
)
def test_what_cannot_be_is_one_sentence(loop: Network, arguments: Mapping[str, Any], words: str) -> None:
    with pytest.raises(TwinFileError) as caught:
        with_elements(loop, **arguments)
    assert words in str(caught.value)
    assert "twin 'loop'" in str(caught.value)
    assert "\n" not in str(caught.value)


# --- files -----------------------------------------------------------------------------------------------------

SENTENCES = st.lists(st.text(), max_size=3).map(tuple)
SPANS = st.none() | st.tuples(st.floats(-1e9, 1e9), st.floats(1.0, 1e9)).map(lambda s: (s[0], s[0] + s[1]))
ERRORS = st.dictionaries(st.text(), st.floats(allow_nan=False, allow_infinity=False), max_size=3)


@given(
    st.builds(
        Revision,
        number=st.integers(0, 10**6),
        parent=st.text(),
        made_by=st.text(),
        window_s=SPANS,
        error_before_K=ERRORS,
        error_after_K=ERRORS,
        notes=SENTENCES,
        held_out_s=SPANS,
        effects=SENTENCES,
        evidence=st.text(),
        parent_file=st.text(),
    )
)
def test_writing_and_reading_lose_nothing_of_a_revision(loop: Network, revision: Revision) -> None:
    text = dump(loop.with_values({}, revision))
    assert parse(text).revision == revision
    assert dump(parse(text)) == text


def test_names_that_need_quotes_are_refused_where_they_become_code(loop: Network) -> None:
    data = to_tables(loop)
    data["inputs"]["T dew_C"] = {"nominal": 10.0}
    with pytest.raises(TwinFileError, match="'T dew_C' cannot be a name"):
        from_tables(data, "a test")


def test_a_revision_of_older_files_is_read(loop_text: str) -> None:
    old = loop_text + '\n[revision]\nnumber = 1\nmade_by = "older"\nwindow_s = [0.0, 5.0]\nnotes = ["n"]\n'
    assert parse(old).revision == Revision(1, "", "older", (0.0, 5.0), notes=("n",))


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("number = -1", "must be a whole number"),
        ("number = true", "must be a whole number"),
        ("evidence = 3", "must be text in quotes"),
        ('effects = "one"', "must be a list of sentences"),
        ("held_out_s = [5.0, 1.0]", "must be below the second"),
        ("error_after_K = { T_tank_C = nan }", "must be a finite number"),
        ("evidense = 'x'", "did you mean 'evidence'"),
    ],
)
def test_a_revision_that_cannot_be(loop_text: str, line: str, words: str) -> None:
    with pytest.raises(TwinFileError) as caught:
        parse(f"{loop_text}\n[revision]\n{line}\n")
    assert words in str(caught.value)


def test_a_chain_of_three_with_a_revert(first: Path) -> None:
    second = save_revision(heated(first), first)
    third = revert(second, made_by="me")
    assert [second.name, third.name] == ["my_twin.r2.toml", "my_twin.r3.toml"]
    entries = chain(third)
    assert [e.path for e in entries] == [third, second, first]
    assert [e.network.revision.number for e in entries] == [3, 2, 1]
    assert not any(e.remarks or e.faults for e in entries)
    assert entries[0].network.revision.notes == (
        "undoes my_twin.r2.toml (revision 2): restores my_twin.toml (revision 1)",
    )
    assert entries[0].network.revision.made_by == "me"
    assert entries[0].network.revision.evidence == ""
    assert entries[1].network.revision.evidence == EVIDENCE.evidence
    assert entries[1].network.revision.parent_file == "my_twin.toml"
    assert diff(load(first), load(third)).empty
    assert next_path(third).name == next_path(first).name == "my_twin.r4.toml"
    again = revert(third)
    assert diff(load(second), load(again)).empty


def test_what_a_file_says_survives_saving(first: Path) -> None:
    network = heated(first)
    again = load(save_revision(network, first))
    assert (again.parameters, again.elements, again.inputs) == (network.parameters, network.elements, network.inputs)
    assert again.revision.effects == EVIDENCE.effects
    assert again.revision.parent == load(first).digest


def test_inherited_evidence_is_not_passed_on(first: Path) -> None:
    second = save_revision(heated(first), first)
    third = save_revision(load(second).with_values({"fins.UA_100": 60.0}), second)
    assert load(third).revision == Revision(3, load(second).digest, parent_file=second.name)


def test_the_first_revision_of_a_twin_without_number(loop: Network, tmp_path: Path) -> None:
    path = save(loop, tmp_path / "plain.toml")
    assert next_path(path).name == "plain.r1.toml"
    (only,) = chain(path)
    assert (only.remarks, only.faults) == ((), ())
    with pytest.raises(TwinFileError, match="was made of no other twin file"):
        revert(path)


def test_two_children_of_one_parent(first: Path) -> None:
    one = save_revision(heated(first), first)
    two = save_revision(heated(first, 90.0), first)
    assert [one.name, two.name] == ["my_twin.r2.toml", "my_twin.r3.toml"]
    assert names(two) == ["my_twin.r3.toml", "my_twin.toml"]
    assert chain(one)[0].remarks == ("my_twin.r3.toml was made of the same parent",)
    assert chain(first)[0].remarks == ("my_twin.r2.toml was made of it", "my_twin.r3.toml was made of it")


def test_undoing_what_something_was_made_of_says_so(first: Path) -> None:
    second = save_revision(heated(first), first)
    save_revision(load(second).with_values({"fins.UA_100": 60.0}), second)
    notes = load(revert(second)).revision.notes
    assert notes[1:] == ("my_twin.r3.toml was made of it too and stays as it is",)


def test_a_missing_parent_is_said(first: Path) -> None:
    second = save_revision(heated(first), first)
    sha = load(first).digest[:12]
    first.unlink()
    (only,) = chain(second)
    assert only.remarks == (
        f"its parent my_twin.toml (SHA-256 {sha}...) is not in this folder; put it beside my_twin.r2.toml",
    )
    assert not only.faults
    for attempt in (parent_of, revert):
        with pytest.raises(TwinFileError, match=r"r2\.toml: its parent my_twin\.toml .* is not in this folder"):
            attempt(second)


def test_a_parent_of_another_folder_is_said_without_its_name(loop: Network, tmp_path: Path) -> None:
    path = save(loop.with_values({}, Revision(1, loop.digest)), tmp_path / "my_twin.toml")
    assert "was edited or is not in this folder" in chain(path)[0].remarks[0]


def test_a_renamed_parent_is_found(first: Path) -> None:
    second = save_revision(heated(first), first)
    first.rename(first.with_name("healthy.toml"))
    assert names(second) == ["my_twin.r2.toml", "healthy.toml"]


def test_of_two_copies_the_one_with_the_right_name_is_the_parent(first: Path) -> None:
    second = save_revision(heated(first), first)
    first.with_name("a_copy.toml").write_text(read_text(first), encoding="utf-8")
    assert parent_of(second) == first


def test_a_parent_that_was_edited_is_a_fault(first: Path) -> None:
    second = save_revision(heated(first), first)
    first.write_text(read_text(first).replace("value = 71.0", "value = 72.0"), encoding="utf-8")
    (only,) = chain(second)
    assert only.remarks == ()
    assert only.faults[0].startswith("my_twin.toml was edited after my_twin.r2.toml was made of it")
    with pytest.raises(TwinFileError, match=r"my_twin\.toml was edited after .*; put the old text back"):
        revert(second)


def test_a_file_that_was_edited_after_it_was_saved_is_a_fault(first: Path) -> None:
    second = save_revision(heated(first), first)
    assert not is_edited(read_text(second), load(second).revision.checksum)
    second.write_text(read_text(second).replace("value = 181.0", "value = 182.0"), encoding="utf-8")
    entries = chain(second)
    assert len(entries) == 2
    assert entries[0].faults[0].startswith("my_twin.r2.toml was edited after it was saved")
    assert not entries[1].faults


def test_a_parent_that_cannot_be_used_ends_the_chain(first: Path, loop_text: str) -> None:
    old = first.with_name("old.toml")
    old.write_text(loop_text.replace("format = 1", "format = 7"), encoding="utf-8")
    import hashlib

    sha = hashlib.sha256(old.read_bytes()).hexdigest()
    text = read_text(first).replace("number = 1\n", f'number = 1\nparent = "{sha}"\n').split("checksum")[0]
    child = first.with_name("child.toml")
    child.write_text(text, encoding="utf-8")
    (only,) = chain(child)
    assert only.remarks[0].startswith("its parent cannot be used: ")
    assert "must be 1" in only.remarks[0]


def test_other_files_of_the_folder_are_passed_over(first: Path) -> None:
    first.with_name("broken.toml").write_text("[", encoding="utf-8")
    first.with_name("binary.toml").write_bytes(b"\xff\xfe")
    first.with_name("rig.toml").write_text("revision = 3\n", encoding="utf-8")
    second = save_revision(heated(first), first)
    assert names(second) == ["my_twin.r2.toml", "my_twin.toml"]


def test_a_network_that_does_not_hold_together_is_not_saved(first: Path, loop: Network) -> None:
    bad = loop.with_values({}, Revision(error_after_K={"T_tank_C": float("nan")}))
    with pytest.raises(TwinFileError, match="must be a finite number"):
        save_revision(bad, first)
    assert [f.name for f in first.parent.iterdir()] == [first.name]


def test_a_revert_of_nothing_is_refused(first: Path) -> None:
    second = save_revision(load(first), first)
    with pytest.raises(TwinFileError, match="nothing to undo"):
        revert(second)


@pytest.mark.parametrize("call", [chain, next_path, parent_of, revert])
def test_files_that_cannot_be_used(tmp_path: Path, call: Any) -> None:
    with pytest.raises(TwinFileError, match="cannot be read"):
        call(tmp_path / "absent.toml")
    (tmp_path / "bad.toml").write_text("format = 1\n", encoding="utf-8")
    with pytest.raises(TwinFileError, match=r"bad\.toml"):
        call(tmp_path / "bad.toml")


# --- differences -----------------------------------------------------------------------------------------------


def test_differences_both_ways(loop: Network) -> None:
    new = with_elements(
        loop,
        {"extra": HEAT},
        {"tank_loss.hA": 1.25, "modules_power.power": 10.0, "heater.capacitance": 3100.0},
        replace={"fins": {"fan_exponent": {"status": "tunable"}}, "T_tank_C": {"other": "heater"}},
    )
    there, back = diff(loop, new), diff(new, loop)
    (piece,) = there.added
    assert (piece.name, piece.kind, piece.places["node"]) == ("extra", "heat_source", "modules")
    assert [p.value for p in piece.parameters if p.name == "power"] == [181.0]
    assert there.removed == ()
    assert (back.added, back.removed) == ((), there.added)
    moved = {m.parameter: m for m in there.moved}
    assert list(moved) == [i for i in new.ids if i in moved]
    assert set(moved) == {"tank_loss.hA", "modules_power.power", "heater.capacitance"}
    assert (moved["tank_loss.hA"].before, moved["tank_loss.hA"].after) == (2.5, 1.25)
    assert moved["tank_loss.hA"].unit == "W/K"
    assert moved["tank_loss.hA"].relative == pytest.approx(-0.5)
    assert moved["modules_power.power"].relative is None
    changed = {c.key: (c.before, c.after) for c in there.changed}
    assert changed["elements.fins.fan_exponent.status"] == ("fixed", "tunable")
    assert changed["elements.T_tank_C.other"] == ("absent", "heater")
    assert changed["elements.T_tank_C.cross_talk"][0] == "absent"
    assert set(changed) == {
        "elements.fins.fan_exponent.status",
        "elements.T_tank_C.other",
        "elements.T_tank_C.cross_talk",
    }


def test_a_member_of_a_set_is_one_change(loop: Network) -> None:
    data = to_tables(loop)
    gone = data["sets"]["nine"]["members"].pop()["parameter"]
    data["windows"]["large_K"] = 0.75
    changed = diff(loop, from_tables(data, "a test")).changed
    assert [c.key for c in changed] == ["windows.large_K", f"sets.nine.members.{gone}"]
    assert changed[1].after == "absent"


def test_where_a_twin_comes_from_is_no_difference(loop: Network) -> None:
    assert diff(loop, loop.with_values({}, EVIDENCE)).empty


def test_an_element_of_another_kind_is_removed_and_added(loop: Network) -> None:
    data = to_tables(loop)
    data["elements"]["extra"] = dict(HEAT, power=5.0)
    a = from_tables(data, "a test")
    data["elements"]["extra"] = {"kind": "conduction", "from": "tank", "to": "heater", "resistance": 1.0}
    found = diff(a, from_tables(data, "a test"))
    assert [p.kind for p in found.removed] == ["heat_source"]
    assert [p.kind for p in found.added] == ["conduction"]
