"""The page of test plans: its example is read, and it names the keys and sentences that the reader takes."""

from __future__ import annotations

import re

import pytest
from pydantic_core import PydanticUndefined

from drivers.rig_file import load_rig
from hil.testing import bind, read_plan
from hil.testing.judgement.verdicts import ORDER
from hil.testing.limits import parse
from hil.testing.plan import SEVERITIES, LimitSection, PlanSection, StepSection
from tests.hil.made_plan import known
from tests.hil.reference_pages import page

PAGE = page("test-plan-file")


@pytest.mark.parametrize(
    ("section", "model"), [("Plan", PlanSection), ("[[step]]", StepSection), ("[[limit]]", LimitSection)]
)
def test_every_key_is_named_with_its_default_and_no_other(section, model):
    rows = PAGE.keys(section)
    fields = {field.alias or name: field for name, field in model.model_fields.items()}
    assert set(rows) == set(fields)
    texts = {(): "`[]`", None: "none", PydanticUndefined: "must be given"}
    for key, field in fields.items():
        shown = f'`"{field.default}"`' if isinstance(field.default, str) else texts[field.default]
        assert rows[key]["Default"] == shown, key


def test_severities_and_verdicts_are_those_of_the_program():
    for row in (PAGE.keys("Plan")["trip_on"], PAGE.keys("[[limit]]")["severity"]):
        assert tuple(re.findall(r"`(\w+)`", row["Allowed"])) == SEVERITIES
    assert {row["Verdict"].strip("`") for row in PAGE.rows["Verdicts"]} == set(ORDER)


def test_every_sentence_and_condition_of_the_page_is_read():
    sentences = [row["Sentence"].strip("`") for row in PAGE.rows["Sentences"]]
    conditions = [row["At the end of a sentence"].strip("`") for row in PAGE.rows["Conditions"]]
    assert len(sentences) > 8 and len(conditions) == 4
    for sentence in sentences:
        parse(sentence)
    for condition in conditions:
        assert parse(f"T_tank_C < 60 {condition}").window != parse("T_tank_C < 60").window


def test_the_example_is_a_plan_for_the_example_of_the_rig_file(tmp_path):
    (tmp_path / "plan.toml").write_text(PAGE.code["toml"][0], encoding="utf-8")
    (tmp_path / "load.csv").write_text("time_s,heater_power_W\n0,200\n3600,200\n", encoding="utf-8")
    (tmp_path / "rig.toml").write_text(page("rig-file").code["toml"][0], encoding="utf-8")
    plan = read_plan(tmp_path / "plan.toml")
    rig = load_rig(tmp_path / "rig.toml")
    assert plan.trips(plan.limits[0]) and not plan.trips(plan.limits[1])
    assert (plan.limits[1].sentence.window.from_s, plan.limits[1].sentence.window.to_s) == (600.0, 2400.0)
    assert len(bind(plan, known(3600.0))) == 3
    assert rig.setpoints
