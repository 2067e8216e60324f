"""`hil twin`: log, diff and revert as a user meets them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from rich.console import Console

from hil.cli import group
from hil.errors import exit_code
from hil.run.session import terminal
from twin.network import Revision
from twin.revisions import save_revision, with_elements
from twin.revisions.law_adoption import adopt_law
from twin.twinfile import load, save

PROJECT = Path(__file__).resolve().parents[2]
LOOP = PROJECT / "profiles" / "twins" / "loop.toml"
EVIDENCE = Revision(
    made_by="hil diagnose campaign.parquet",
    window_s=(0.0, 108000.0),
    error_before_K={"T_tank_C": 0.91, "T_heater_C": 0.2},
    error_after_K={"T_tank_C": 0.052, "T_heater_C": 0.2},
    held_out_s=(108000.0, 144000.0),
    effects=("heat_source at modules, constant: 181 W [bold]",),
    evidence="The residual jumps at 12600 s and stays.",
)


def hil(*arguments: object) -> tuple[int, str]:
    """Exit code and everything printed; an error that a user can mend as `main` shows it."""
    result = CliRunner().invoke(group, [str(item) for item in arguments])
    error = result.exception
    if error is not None and not isinstance(error, SystemExit):
        code = exit_code(error)
        assert code is not None, error
        return code, str(error)
    return result.exit_code, result.output


@pytest.fixture
def second(tmp_path: Path) -> Path:
    """`my_twin.r2.toml` with a heat source that its parent `my_twin.toml` lacks."""
    healthy = load(LOOP).with_values({"fins.UA_100": 71.0}, Revision(1, made_by="hil commission record.parquet"))
    first = save(healthy, tmp_path / "my_twin.toml")
    heat = {"kind": "heat_source", "node": "modules", "power": {"value": 181.0, "lower": 0.0, "upper": 400.0}}
    return save_revision(with_elements(load(first), {"extra": heat}, {"tank_loss.hA": 1.25}, EVIDENCE), first)


def test_log_shows_the_evidence_of_each_revision(second: Path) -> None:
    code, printed = hil("twin", "log", second)
    assert code == 0
    for words in (
        "my_twin.r2.toml",
        "my_twin.toml",
        "hil diagnose campaign.parquet",
        "T_tank_C",
        "0.910",
        "0.052",
        "effect: heat_source at modules, constant: 181 W [bold]",
        "evidence: The residual jumps",
        "fitted over 0.00 to 30.00 h",
        "errors over 30.00 to 40.00 h",
    ):
        assert words in printed
    assert printed.index("my_twin.r2.toml") < printed.index("my_twin.toml")


def test_log_for_scripts(second: Path) -> None:
    code, printed = hil("twin", "log", second, "--json")
    newest, first = json.loads(printed)
    assert code == 0
    assert newest["file"] == str(second)
    assert newest["parent"] == first["sha256"]
    assert newest["error_after_K"] == {"T_tank_C": 0.052, "T_heater_C": 0.2}
    assert newest["held_out_s"] == [108000.0, 144000.0]
    assert newest["effects"] == list(EVIDENCE.effects)
    assert (newest["remarks"], newest["faults"]) == ([], [])


def test_log_says_what_is_missing(second: Path) -> None:
    (second.parent / "my_twin.toml").unlink()
    code, printed = hil("twin", "log", second)
    assert code == 0
    assert "its parent my_twin.toml" in printed
    assert "put it beside my_twin.r2.toml" in printed


def test_log_finds_a_file_that_was_edited(second: Path) -> None:
    second.write_text(second.read_text().replace("value = 181.0", "value = 18.0"), encoding="utf-8")
    code, printed = hil("twin", "log", second)
    assert code == 1
    assert "my_twin.r2.toml was edited after it was saved" in printed
    assert hil("twin", "log", second, "--json")[0] == 1


def test_diff_against_the_parent(second: Path) -> None:
    code, printed = hil("twin", "diff", second)
    assert code == 0
    for words in ("Elements added", "extra", "node modules", "power 181 W", "tank_loss.hA", "-50.0 %", "W/K"):
        assert words in printed
    assert "removed" not in printed


def test_diff_of_two_for_scripts(second: Path) -> None:
    code, printed = hil("twin", "diff", second, second.parent / "my_twin.toml", "--json")
    found = json.loads(printed)
    assert code == 0
    assert not found["same"]
    assert [piece["name"] for piece in found["removed"]] == ["extra"]
    assert found["moved"] == [
        {"parameter": "tank_loss.hA", "before": 1.25, "after": 2.5, "unit": "W/K", "relative": 1.0}
    ]
    assert (found["added"], found["changed"]) == ([], [])


def test_diff_of_the_same(second: Path) -> None:
    code, printed = hil("twin", "diff", second, second)
    assert code == 0
    assert "describe the same twin" in printed
    assert json.loads(hil("twin", "diff", second, second, "--json")[1])["same"]


def test_diff_of_other_keys(second: Path) -> None:
    altered = with_elements(load(second), {}, replace={"fins": {"fan_exponent": {"status": "tunable"}}})
    code, printed = hil("twin", "diff", save_revision(altered, second))
    assert code == 0
    assert "fins.fan_exponent.status" in printed
    assert "tunable" in printed


def test_revert_writes_a_new_revision(second: Path) -> None:
    before = {file.name: file.read_bytes() for file in second.parent.iterdir()}
    code, printed = hil("twin", "revert", second)
    third = second.with_name("my_twin.r3.toml")
    assert code == 0
    assert "undoes my_twin.r2.toml (revision 2)" in printed
    assert f"written: {third}" in printed
    assert load(third).revision.made_by == "hil twin revert"
    assert {name: second.with_name(name).read_bytes() for name in before} == before
    assert json.loads(hil("twin", "diff", second.with_name("my_twin.toml"), third, "--json")[1])["same"]
    assert [e["number"] for e in json.loads(hil("twin", "log", third, "--json")[1])] == [3, 2, 1]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("log", "none.toml"), ["none.toml: there is no such file"]),
        (("log", "{here}/rig.toml"), ["rig.toml: the key 'name' is missing"]),
        (("diff", "{first}"), ["my_twin.toml: was made of no other twin file", "or give the second file"]),
        (("diff", "{second}", "{here}/rig.toml"), ["rig.toml"]),
        (("revert", "{first}"), ["my_twin.toml: was made of no other twin file"]),
        (("revert",), ["Missing argument 'TWIN'"]),
        (("lgo",), ["No such command 'lgo'"]),
    ],
)
def test_wrong_use_is_explained(second: Path, arguments: tuple[str, ...], words: list[str]) -> None:
    here = second.parent
    (here / "rig.toml").write_text("format = 1\n", encoding="utf-8")
    places = {"here": here, "second": second, "first": here / "my_twin.toml"}
    names = {file.name for file in here.iterdir()}
    code, printed = hil("twin", *(argument.format(**places) for argument in arguments))
    assert code == 2
    for word in words:
        assert word in printed
    assert "Traceback" not in printed
    assert {file.name for file in here.iterdir()} == names


@pytest.mark.parametrize("verb", ["log", "diff", "revert"])
def test_each_verb_has_help_with_an_example(verb: str) -> None:
    code, printed = hil("twin", verb, "--help")
    assert code == 0
    assert f"hil twin {verb} my_twin" in printed


def test_tables_fit_eighty_columns(second: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(terminal, "console", lambda: Console(width=80, highlight=False))
    for arguments in (("log", second), ("diff", second)):
        code, printed = hil("twin", *arguments)
        assert code == 0
        tables = [line for line in printed.splitlines() if line[:1] in "┏┃┡│└"]
        assert tables
        assert max(map(len, tables)) <= 80
        assert "…" not in printed


def test_log_and_diff_show_the_equation_of_a_law(tmp_path: Path) -> None:
    first = save(load(LOOP), tmp_path / "my_twin.toml")
    law = {"kind": "law_heat", "node": "tank", "driver": "fan_speed_pct", "form": "threshold"}
    parameters = {"size": -40.0, "on": 80.0, "off": 60.0}
    path = save_revision(adopt_law(load(first), law, parameters, revision=EVIDENCE), first)
    equation = "Q(tank) = -40 W from fan_speed_pct = 80 % until fan_speed_pct = 60 %, else 0"
    for verb in ("log", "diff"):
        code, printed = hil("twin", verb, path)
        assert code == 0 and equation in " ".join(printed.split()), printed
