"""Results of tests: `verdict.json`, JUnit XML as others read it, the report's first section, requirements by run."""

from __future__ import annotations

import errno
import json
import re
import xml.etree.ElementTree as ET

import pytest

from hil.files import replacing
from hil.run.session.regenerate import judge_recorded, regenerate_files
from hil.run_folder import Labels, RunFolderError, add_note, read_verdict
from hil.testing import judge_run, junit, read_plan, requirement_matrix
from hil.testing.matrix import references
from tests.hil.command_line import typed
from tests.hil.ended_run import ended_run
from tests.hil.made_plan import plan_text

FORGED = json.dumps(
    {
        "verdict": "pass",
        "tests": [
            {
                "id": "p",
                "title": "",
                "sha256": "",
                "verdict": "pass",
                "judged": "",
                "limits": [{"id": "L", "limit": "", "requirement": "", "severity": "", "verdict": "pass", "text": ""}],
            }
        ],
    }
)
"""A limit without its value."""
SENTENCES = ("T_heater_C < 300", "T_heater_C < 1", "T_pm3_C < 300", "T_modules_C < 1")


@pytest.fixture
def judged(tmp_path):
    """A run with a fault of T_pm3, judged by a plan with a passed, two failed and an inconclusive limit."""
    folder, manifest = ended_run(tmp_path / "a <b> run")
    folder.write_manifest(manifest)
    plan = tmp_path / "plan.toml"
    text = plan_text(*SENTENCES, head='title = "Heat & <cold>"').replace('"REQ-4"', '"REQ-2"')
    plan.write_text(text.replace("T_heater_C < 300", "T_heater_C < 300 before 200 s"), encoding="utf-8")
    return folder, plan


def test_every_limit_is_in_the_files_and_first_in_the_report(judged):
    folder, plan = judged
    done = typed("test", plan, "--on", folder.path)
    assert done.returncode == 1
    words = [line.split()[0] for line in done.stdout.splitlines()[:5]]
    assert words == ["pass", "FAIL", "inconclusive", "FAIL", "FAIL:"]
    document = json.loads(folder.verdict.read_text(encoding="utf-8"))
    assert document["verdict"] == folder.read_manifest()["verdict"] == "fail"
    (test,) = document["tests"]
    assert [limit["verdict"] for limit in test["limits"]] == ["pass", "fail", "inconclusive", "fail"]
    assert test["limits"][1]["value"] > 1.0 and test["limits"][1]["unit"] == "degC"
    page = folder.report.read_text(encoding="utf-8")
    headings = re.findall(r"<h2>(.*?)</h2>", page)
    assert headings[0].startswith("Test: Heat &amp; &lt;cold&gt;") and "FAILED" in headings[0]
    assert "INCONCLUSIVE" in page and "T_heater_C &lt; 1" in page


def test_junit_is_read_by_a_program_of_others(judged):
    reader = pytest.importorskip("junitparser")
    folder, plan = judged
    add_note(folder, "", "Ada", Labels(serial_number="<42>", tags=("night", "endurance")))
    judge_run(read_plan(plan), folder)
    (suite,) = reader.JUnitXml.fromfile(str(folder.junit))
    assert (suite.name, suite.tests, suite.failures, suite.errors, suite.skipped) == ("small", 4, 2, 1, 0)
    cases = list(suite)
    assert [case.is_passed for case in cases] == [True, False, False, False]
    assert "the limit is < 1 °C" in cases[1].result[0].message
    assert isinstance(cases[2].result[0], reader.Error)
    properties = {p.name: p.value for p in suite.properties()}
    assert properties["requirement.L4"] == "REQ-2"
    assert properties["serial_number"] == "<42>" and properties["tags"] == "night, endurance"
    assert properties["value.L2"].endswith(" degC") and "value.L3" not in properties


def test_junit_keeps_to_the_schema_of_ant(judged):
    """Rules of JUnit.xsd: attributes that must be there, and the order of elements."""
    folder, plan = judged
    judge_run(read_plan(plan), folder)
    root = ET.fromstring(folder.junit.read_bytes())
    assert root.tag == "testsuites"
    for suite in root:
        assert {"name", "timestamp", "hostname", "tests", "failures", "errors", "time", "id", "package"} == set(
            suite.attrib
        )
        assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d", suite.attrib["timestamp"])
        tags = [child.tag for child in suite]
        assert tags == ["properties", *["testcase"] * len(suite.findall("testcase")), "system-out", "system-err"]
        for case in suite.findall("testcase"):
            assert set(case.attrib) == {"name", "classname", "time"}
            assert [child.tag for child in case] in ([], ["failure"], ["error"])
            assert all("type" in child.attrib for child in case)


def test_text_that_xml_cannot_hold_is_replaced():
    limit = {"id": "L", "limit": "x\x00\x1b < \ud800\ufffe", "requirement": "\x07", "severity": "major", "step": None}
    limit |= {"verdict": "fail", "text": "\x0b"}
    test = {"id": "p", "title": "\x01", "sha256": "", "verdict": "fail", "limits": [limit]}
    assert ET.fromstring(junit({"tests": [test]}, {})) is not None


def test_plans_are_kept_side_by_side_and_replaced_by_id(judged):
    folder, plan = judged
    judge_run(read_plan(plan), folder)
    good = plan.with_name("good.toml")
    good.write_text(plan_text("T_heater_C < 300 before 200 s").replace('"small"', '"good"'), encoding="utf-8")
    done = typed("test", good, "--on", folder.path, "--json")
    assert done.returncode == 0  # of this plan alone
    assert [test["id"] for test in json.loads(done.stdout)["tests"]] == ["small", "good"]
    judge_run(read_plan(plan), folder)
    document = read_verdict(folder)
    assert [test["id"] for test in document["tests"]] == ["good", "small"] and document["verdict"] == "fail"


def test_requirements_have_the_worst_verdict_of_their_limits_in_each_run(judged, tmp_path):
    folder, plan = judged
    judge_run(read_plan(plan), folder)
    other, manifest = ended_run(tmp_path / "other")
    other.write_manifest(manifest)
    with pytest.raises(RunFolderError, match="was not judged"):
        requirement_matrix([folder, other])
    good = plan.with_name("good.toml")
    good.write_text(plan_text("T_heater_C < 300 before 200 s"), encoding="utf-8")
    judge_run(read_plan(good), other)
    made = requirement_matrix([folder, other])
    assert made.runs == ("a <b> run", "other")
    assert made.rows == {"REQ-1": ("pass", "pass"), "REQ-2": ("fail", None), "REQ-3": ("inconclusive", None)}
    assert made.limits["REQ-2"] == ("small/L2", "small/L4")
    done = typed("test", "--matrix", folder.path, other.path)
    assert done.returncode == 1 and "REQ-2" in done.stdout
    assert typed("test", "--matrix", other.path, "--json").returncode == 0
    text = plan.read_text(encoding="utf-8").replace('"REQ-1"', '"REQ-10: keeps cool"')
    plan.write_text(text.replace('"REQ-3"', '"REQ-2; REQ-10"'), encoding="utf-8")
    judge_run(read_plan(plan), folder)
    made = requirement_matrix([folder])
    assert list(made.rows.items()) == [("REQ-2", ("fail",)), ("REQ-10", ("inconclusive",))]
    assert made.heading("REQ-10") == "REQ-10: keeps cool" and made.limits["REQ-10"] == ("small/L1", "small/L3")


@pytest.mark.parametrize(
    ("requirement", "found"),
    [
        ("REQ-7", (("REQ-7",), "")),
        ("REQ-7:  the tank  stays cool", (("REQ-7",), "the tank stays cool")),
        ("SYS/4.2.1, SYS/4.2.3;REQ_9: cool", (("SYS/4.2.1", "SYS/4.2.3", "REQ_9"), "cool")),
        ("REQ-7,REQ-7", (("REQ-7",), "")),
        ("https://doors:80/r7", (("https://doors:80/r7",), "")),
        ("the tank stays below 60 °C", (("the tank stays below 60 °C",), "")),
        ("cooling: 3 of 4 fans", (("cooling: 3 of 4 fans",), "")),
        (" ", ((" ",), "")),
    ],
)
def test_references_of_a_requirement(requirement, found):
    assert references(requirement) == found


@pytest.mark.parametrize(
    "content",
    ["{", "[]", '{"verdict": "good", "tests": []}', '{"verdict": "pass", "tests": [{"id": "<"}]}', FORGED],
)
def test_a_forged_verdict_is_refused_in_a_sentence(judged, content):
    folder, _ = judged
    folder.verdict.write_text(content, encoding="utf-8")
    done = typed("test", "--matrix", folder.path)
    assert done.returncode == 2 and "verdict.json" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_a_run_whose_files_are_being_made_is_not_judged(judged):
    folder, plan = judged
    with folder.owned():
        done = typed("test", plan, "--on", folder.path)
    assert done.returncode == 2 and "another process makes the files of this run" in done.stderr


def test_a_verdict_of_another_plan_of_the_same_id_leaves_a_trace(judged):
    folder, plan = judged
    strict = plan.read_text(encoding="utf-8")
    typed("test", plan, "--on", folder.path)
    typed("test", plan, "--on", folder.path)
    plan.write_text(plan_text("T_heater_C < 300 before 200 s"), encoding="utf-8")
    done = typed("test", plan, "--on", folder.path)
    assert done.returncode == 0 and done.stdout.startswith("pass")
    assert "judged before, at " in done.stdout and "by a plan of the same id and other content" in done.stdout
    assert "FAILED; failed: L2, L4" in done.stdout
    assert "FAILED; failed: L2, L4" in folder.report.read_text(encoding="utf-8")
    assert "fail at " in folder.junit.read_text(encoding="utf-8")
    (test,) = read_verdict(folder)["tests"]
    (before,) = test["history"]  # the same verdict again is one entry
    assert before["verdict"] == "fail" and before["sha256"] != test["sha256"] and before["failed"] == ["L2", "L4"]
    plan.write_text(strict, encoding="utf-8")
    assert "by a plan of the same id" in typed("test", plan, "--on", folder.path).stdout
    assert [one["verdict"] for one in read_verdict(folder)["tests"][0]["history"]] == ["fail", "pass"]


@pytest.mark.parametrize("place", ["run", "test"])
def test_a_verdict_that_its_limits_do_not_give_is_refused(judged, place):
    folder, plan = judged
    judge_run(read_plan(plan), folder)
    document = json.loads(folder.verdict.read_text(encoding="utf-8"))
    (document if place == "run" else document["tests"][0])["verdict"] = "pass"
    folder.verdict.write_text(json.dumps(document), encoding="utf-8")
    listed = typed("ls", folder.path.parent)
    assert "damaged" in listed.stdout and "changed by hand" in listed.stderr
    assert typed("ls", folder.path.parent, "--verdict", "pass", "--json").stdout.strip() == "[]"


def test_a_run_in_a_folder_that_cannot_be_written_is_refused_in_a_sentence(judged, monkeypatch):
    folder, plan = judged

    def refused(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr("hil.files.atomic.tempfile.TemporaryFile", refused)
    before = sorted(path.name for path in folder.path.parent.iterdir())
    for call in (lambda: judge_recorded(read_plan(plan), folder), lambda: regenerate_files(folder, False, print)):
        with pytest.raises(RunFolderError, match=r"Read-only file system\); make it writable, or copy the run"):
            call()
    assert sorted(path.name for path in folder.path.parent.iterdir()) == before


def test_an_error_of_writing_names_the_file_that_was_asked_for(tmp_path):
    with pytest.raises(OSError) as caught, replacing(tmp_path / "no" / "page.html") as unfinished:
        unfinished.write_text("")
    assert caught.value.filename == str(tmp_path / "no" / "page.html")
