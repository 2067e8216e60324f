"""The page of the twin file names the keys that the reader takes, with the defaults and bounds that it has."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.rig_file.reader import load_rig
from hil.rig.element_kinds import parameters_of
from hil.run.session.request import RunRequest, prepare
from tests.hil.reference_pages import page
from twin.elements import KINDS
from twin.network import TwinFileError, WindowRules
from twin.twinfile import from_tables, load, parse
from twin.twinfile.reader import FORMAT

PAGE = page("twin-file")
EXAMPLE = PAGE.code["toml"][0]
ROLES = {
    "node": ("node", "declared"),
    "nodes": ("list of nodes", "declared"),
    "input": ("input column", "declared"),
    "columns": ("list of columns", "of the record"),
    "choice": ("text", ""),
    "element": ("element", "declared"),
}
MARKED = "qqqqqqqq"
ASKED = {
    "Top of the file": (f"{MARKED} = 1\n", 0),
    "[inputs]": (f"{MARKED} = 1, ", "T_ambient_C = { "),
    "Parameters": (f"{MARKED} = 1, ", "capacitance = { "),
    "[windows]": (f"{MARKED} = 1\n", "[windows]\n"),
    "[sets.NAME]": (f"{MARKED} = 1\n", "[sets.commission]\n"),
    "Members": (f"{MARKED} = 1, ", '{ parameter = "tank.capacitance"'),
    "[revision]": (f"{MARKED} = 1\n", "[revision]\n"),
}


def accepted(section: str) -> list[str]:
    """Keys that the reader says it knows when it meets one that it does not."""
    what, after = ASKED[section]
    at = after if isinstance(after, int) else EXAMPLE.index(after) + len(after.partition("parameter")[0])
    with pytest.raises(TwinFileError, match="unknown key; known keys: ") as caught:
        parse(EXAMPLE[:at] + what + EXAMPLE[at:])
    return str(caught.value).partition("known keys: ")[2].split(", ")


@pytest.mark.parametrize("section", ASKED)
def test_every_key_is_named_and_no_other(section):
    named = set(PAGE.keys(section)) - ({"same_as"} if section == "Parameters" else set())
    assert named == set(accepted(section))


def test_a_parameter_that_is_another_has_no_value_of_its_own():
    assert "same_as" in PAGE.keys("Parameters")
    shared = EXAMPLE + '\n[elements.more]\nkind = "node"\ncapacitance = { same_as = "tank.capacitance", %s }\n'
    shared += '\n[elements.between]\nkind = "conduction"\nfrom = "more"\nto = "tank"\nresistance = 1.0\n'
    parse(shared % 'unit = "J/K"')
    with pytest.raises(TwinFileError, match="unknown key; known keys: same_as, unit"):
        parse(shared % f"{MARKED} = 1")


def test_there_is_a_table_for_every_kind_and_no_other():
    kinds = set(PAGE.rows) - set(ASKED)
    assert {section for section in kinds if PAGE.rows[section]} == set(KINDS)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_keys_of_a_kind_with_defaults_and_bounds(kind):
    columns = ("Key", "Type, unit", "Default", "Allowed", "Status")
    assert [tuple(row[column] for column in columns) for row in PAGE.rows[kind]] == rows_of(kind)


def rows_of(kind: str) -> list[tuple[str, str, str, str, str]]:
    """What the page has to say of a kind: its places, then its parameters."""
    found = []
    for key, field in KINDS[kind].places().items():
        what, allowed = ROLES[field.metadata["role"]]
        allowed = allowed or ", ".join(f"`{choice}`" for choice in field.metadata["choices"])
        found.append((f"`{key}`", what, default_of(field), allowed, "place"))
    for spec, _ in parameters_of(KINDS[kind]):
        unit = "number" if spec.unit == "1" else f"number, {spec.unit}"
        default = "must be given" if spec.default is None else f"`{spec.default:g}`"
        bounds = f"{spec.lower:g} to {spec.upper:g}"
        found.append((f"`{spec.name}`", unit.replace("<", "\\<"), default, bounds, spec.status))
    return found


def default_of(field: dataclasses.Field[Any]) -> str:
    if field.default is dataclasses.MISSING:
        return "must be given"
    return f'`"{field.default}"`' if field.default else "none"


def test_defaults_of_windows_and_of_the_format():
    rows = PAGE.keys("[windows]")
    assert {key: row["Default"] for key, row in rows.items()} == {
        key: f"`{value:g}`" for key, value in dataclasses.asdict(WindowRules()).items()
    }
    assert PAGE.keys("Top of the file")["format"]["Allowed"] == f"`{FORMAT}`"


TABLES: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "Top of the file": lambda twin: twin,
    "[inputs]": lambda twin: twin["inputs"]["heater_power_W"],
    "[windows]": lambda twin: twin["windows"],
    "[sets.NAME]": lambda twin: twin["sets"]["commission"],
    "Members": lambda twin: twin["sets"]["commission"]["members"][0],
    "[revision]": lambda twin: twin["revision"],
}


@pytest.mark.parametrize("section", TABLES)
def test_what_must_be_given_is_missed_and_nothing_else(section):
    """The example without a key is refused where the page says so, and read where it does not."""
    for key, row in PAGE.keys(section).items():
        tables = tomllib.loads(EXAMPLE)
        there = TABLES[section](tables).pop(key, None) is not None
        if row["Default"] != "must be given":
            from_tables(tables, "the example")
            continue
        assert there, f"{key} of {section} is not in the example"
        with pytest.raises(TwinFileError):
            from_tables(tables, "the example")


def test_the_example_runs_on_the_example_of_the_rig_file(tmp_path: Path):
    rig, twin, load_csv = tmp_path / "rig.toml", tmp_path / "twin.toml", tmp_path / "load.csv"
    rig.write_text(page("rig-file").code["toml"][0], encoding="utf-8")
    twin.write_text(EXAMPLE, encoding="utf-8")
    load_csv.write_text(page("profile-file").code["csv"][0], encoding="utf-8")
    network = load(twin)
    assert network.nodes == ("tank",) and network.tunables("commission")
    ready = prepare(RunRequest(load_csv, rig, twin, tmp_path))
    assert ready.rig == load_rig(rig) and ready.network is not None and ready.profile.duration_s > 600.0
    assert all("steps are ramps at 50 W/s" in note or "no [heartbeat]" in note for note in ready.notes)
