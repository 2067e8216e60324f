"""Test plans: mistakes are named by line, and limits are related to signals, units and times."""

from __future__ import annotations

import pytest

from hil.testing import TestPlanError, bind, read_plan
from hil.testing.limits import Amount
from tests.hil.command_line import typed
from tests.hil.ended_run import ended_run
from tests.hil.made_plan import bound, known, plan_text


def refused(tmp_path, text: str, duration_s: float = 400.0, hold_s: float | None = None) -> str:
    path = tmp_path / "plan.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(TestPlanError) as error:
        bind(read_plan(path), known(duration_s, hold_s))
    return str(error.value).replace(str(path), "plan")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('limit = "', 'limt = "', "plan, line 5: limt of limit L1: is not a key of this section; did you mean limit?"),
        ('requirement = "REQ-1"', "", "plan, line 3: requirement of limit L1: is missing"),
        ('requirement = "REQ-1"', 'requirement = "R"\nseverity = "bad"', "plan, line 7: severity of limit L1: 'bad'"),
        ('id = "L1"', "id = 5", "plan, line 4: id of limit 1: must be text"),
        ('id = "L1"', 'id = "a b"', "plan, line 4: id of limit a b: 'a b' must be"),
        ("T_tank_C < 60", "T_tank_C is warm", "plan, line 5: limit L1: 'T_tank_C is warm' has 'is' after 'T_tank_C'"),
        ('requirement = "REQ-1"', 'requirement = "R"\nstep = "no"', "plan, line 5: limit L1: there is no step 'no'"),
        ('requirement = "REQ-1"', 'requirement = "R"\ngap_at_most = "5"', "limit L1: gap_at_most has its end"),
        ('id = "small"', 'id = "small"\nprofile = "none.csv"', "plan, line 2: profile: there is no file"),
        ('id = "small"', 'id = "small"\ntrip_on = "all"', "plan, line 2: trip_on: 'all'"),
        ('id = "small"', "id = ", "plan is not valid TOML"),
        ("T_tank_C < 60", "T_bank_C < 60", "names T_bank_C, which is no signal of rig small; did you mean T_tank_C?"),
        ("T_tank_C < 60", "T_tank < 60", "has 60 without a unit; write 60 degC"),
        ("T_tank_C < 60", "T_tank_C < 60 K", "K is the unit of a difference"),
        ("T_tank_C < 60", "T_tank_C < 60 W", "is in W, and the signal is in degC"),
        ("T_tank_C < 60", "T_tank_C < 60 furlong", "has the unit 'furlong', which is not known"),
        ("T_tank_C < 60", "T_tank_C < 60 after 500 s", "is for 500 s, and the profile ends at 400 s"),
        ("T_tank_C < 60", "T_tank_C < 60 after 400 s", "is for 400 s, and the profile ends at 400 s"),
        ("T_tank_C < 60", "T_tank_C settles within 400 s to 1 K", "nothing is left to stay settled"),
        ("T_tank_C < 60", "T_tank_C settles within 4 s to 1 %", "in % of a temperature"),
        ("T_tank_C < 60", "ramp of T_tank_C < 2 K", "needs the unit of a rate; write 2 K/min"),
        ("T_tank_C < 60", "ramp of T_tank_C < 2 K/h", "takes 3600 s, and it is judged over 400 s"),
        ("T_tank_C < 60", "ramp of T_tank_C over 0.1 s < 2 K/min", "less than a tick of 1 s"),
        ("T_tank_C < 60", "time of T_tank_C above 50 < 900 s", "takes 900 s, and it is judged over 400 s"),
        ("T_tank_C < 60", "flow measured within 5 % of set-point", "which has no set-point; there are heater_power"),
        ("T_tank_C < 60", "heater_power measured within 5 of set-point", "has 5 without a unit; write 5 W"),
        ("T_tank_C < 60", "rmse of hiera at T_tank_C < 1 K", "names the twin hiera; there are static, pso"),
        ("T_tank_C < 60", "rmse of twin at T_pump_C < 1 K", "no sensor of the twin; there are T_modules_C, T_tank_C"),
        ("T_tank_C < 60", "rmse of twin at T_tank_C < 1", "has 1 without a unit; write 1 K"),
        ("T_tank_C < 60", "no effect found after 10 s", "judges the whole run"),
        ("T_tank_C < 60", "T_tank_C < 60 while T_modules_C > 20", "several sensors"),
        ("T_tank_C < 60", "heater_power < 1e308 kW", "has 1e+308 kW, which is too large in W"),
        ("T_tank_C < 60", "heater_power between 900 W and 0.5 kW", "is between 900 W and 0.5 kW, which holds nothing"),
        ("T_tank_C < 60", "ramp of T_tank_C between 3 K/min and 2 K/min", "which holds nothing"),
        ("T_tank_C < 60", "T_tank_C < 60 while heater_power between 1 kW and 1 W", "which holds nothing"),
        ('requirement = "REQ-1"', 'requirement = "R"\ngap_at_most = "1e999 s"', "gap_at_most has the number 1e999"),
    ],
)
def test_a_mistake_is_named_with_its_line(tmp_path, old, new, said):
    text = plan_text("T_tank_C < 60")
    assert old in text
    found = refused(tmp_path, text.replace(old, new, 1))
    assert said in found
    assert len(found.splitlines()) == 1 + ("is not a key" in said)  # the key that was meant is missing


def test_every_mistake_is_named(tmp_path):
    found = refused(tmp_path, plan_text("T_a < 1", "T_tank_C < 5 V", "T_tank_C < 5")).splitlines()
    assert [line.partition(": '")[0] for line in found] == ["plan, line 5: limit L1", "plan, line 11: limit L2"]


def test_a_malformed_limit_hides_no_mistake_of_another(tmp_path):
    text = plan_text("T_tank_C < 60", "T_tank_C is warm", "no trip").replace(
        'requirement = "REQ-1"', 'severity = "bad"'
    )
    text = text.replace('id = "L3"', 'id = "L3"\nstep = "no"').replace('id = "small"', "id = 5")
    found = refused(tmp_path, text)
    for said in ("requirement of limit L1: is missing", "severity of limit L1: 'bad'", "id: must be text"):
        assert said in found
    for said in ("limit L2: 'T_tank_C is warm' has 'is'", "limit L3: there is no step 'no'"):
        assert said in found
    assert len(found.splitlines()) == 5


def test_a_step_beyond_the_profile_is_named(tmp_path):
    step = '[[step]]\nname = "late"\nfrom = "1 min"\nto = "1 h"'
    assert "plan, line 2: step late ends at 3600 s" in refused(tmp_path, plan_text("T_tank_C < 60", head=step))
    wrong = step.replace('"1 h"', '"59 s"')
    assert "not after its beginning" in refused(tmp_path, plan_text("T_tank_C < 60", head=wrong))


def test_settling_must_fit_into_the_holds_of_the_profile(tmp_path):
    text = plan_text("T_tank_C settles within 120 s to 1 K")
    assert "holds its set-points for 90 s at most" in refused(tmp_path, text, hold_s=90.0)


def test_ids_are_given_once(tmp_path):
    text = plan_text("T_tank_C < 60", "T_tank_C < 50").replace('"L2"', '"L1"')
    assert "limit L1 is there twice" in refused(tmp_path, text)


def test_amounts_get_the_unit_of_their_signal(tmp_path):
    assert bound(tmp_path, "heater_power < 0.5 kW").statement.bound.amount == Amount(500.0, "W")
    assert bound(tmp_path, "flow_L_per_min > 0.3 m3/h").statement.bound.amount.number == pytest.approx(5.0)
    assert bound(tmp_path, "deviation of T_tank < 0.2 degC").statement.bound.amount == Amount(0.2, "K")
    assert bound(tmp_path, "rise of T_tank_C < 60 K/h over 30 s".replace(" < 60 K/h over 30 s", " over 30 s < 60 K/h"))
    ramp = bound(tmp_path, "rise of heater_power over 10 s < 1 W/s")
    assert (ramp.unit, ramp.statement.bound.amount.number) == ("W/s", 1.0)
    assert bound(tmp_path, "cycles > 5").unit == "1"
    group = bound(tmp_path, "T_modules_C < 75")
    assert (group.columns, group.unit) == (("T_pm1_C", "T_pm2_C"), "degC")


def test_a_run_without_journal_and_one_of_another_profile_are_refused_in_a_sentence(tmp_path):
    folder, manifest = ended_run(tmp_path / "run")
    (tmp_path / "load.csv").write_text("time_s,heater_power_W\n0,1\n9,1\n", encoding="utf-8")
    manifest["files"] = {"profile": {"path": "/other.csv", "sha256": "0" * 64}}
    folder.write_manifest(manifest)
    plan = tmp_path / "plan.toml"
    plan.write_text(plan_text("T_tank_C < 90", head='profile = "load.csv"'), encoding="utf-8")
    done = typed("test", plan, "--on", folder.path)
    assert done.returncode == 2 and f"{plan}, line 2: profile: the run" in done.stderr
    plan.write_text(plan_text("T_tank_C < 90"), encoding="utf-8")
    folder.journal.unlink()
    done = typed("test", plan, "--on", folder.path)
    assert done.returncode == 1 and "journal.sqlite does not exist" in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('id = "p"\nrig = "r.toml"\ntitle = "x"\n', "line 2: limit: is missing"),
        ('id = "p"\n[[limits]]\nid = "a"\n', "did you mean limit?"),
        ('trip_on = "major"\n', "id: is missing"),
        ('[[step]]\nname = "x"\nfrom = "1 s"\nto = "2 s"\n', "limit: is missing"),
        ('id = "p"\n[limit]\nid = "a"\n', "line 2: limit: is one table; begin each with [[limit]]"),
    ],
)
def test_a_plan_without_limits_is_checked_as_a_plan(tmp_path, text, said):
    path = tmp_path / "plan.toml"
    path.write_text(text, encoding="utf-8")
    done = typed("check", path)
    assert done.returncode == 2 and said in done.stderr and "rig file" not in done.stderr


def test_a_check_shows_no_codes_that_a_terminal_obeys(tmp_path):
    path = tmp_path / "plan.toml"
    text = plan_text("T_tank_C < 60").replace('"REQ-1"', '"R \\u001b[2J\\u001b[31mred\\u202e"')
    path.write_text(text, encoding="utf-8")
    done = typed("check", path)
    assert done.returncode == 0 and "\x1b" not in done.stdout and "\u202e" not in done.stdout
    assert r"R \x1b[2J\x1b[31mred\u202e" in done.stdout
