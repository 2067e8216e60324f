"""Results of a test in a run folder: `verdict.json` with every limit, and `junit.xml` for other programs."""

from __future__ import annotations

import datetime
import json
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hil.files import plain, replacing
from hil.run_folder import RunFolder, label_texts, read_verdict
from hil.testing.judgement import Judgement, Verdict, overall
from hil.testing.limits import Trips, parse
from hil.testing.plan import Plan


@dataclass(frozen=True, slots=True)
class TestResult:
    """Judgements of a plan on one run."""

    __test__ = False  # no class of tests

    plan: Plan
    judgements: tuple[Judgement, ...]

    @property
    def verdict(self) -> Verdict:
        """The worst verdict of all limits."""
        return overall(judgement.verdict for judgement in self.judgements)

    def document(self) -> dict[str, Any]:
        """Return the result as plain data."""
        return {
            "id": self.plan.id,
            "title": self.plan.title,
            "plan": str(self.plan.path.absolute()),
            "sha256": self.plan.sha256,
            "judged": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            "verdict": self.verdict,
            "limits": [
                {
                    "id": judgement.limit.id,
                    "limit": judgement.limit.text,
                    "requirement": judgement.limit.requirement,
                    "severity": judgement.limit.severity,
                    "step": judgement.limit.step,
                    "verdict": judgement.verdict,
                    "value": judgement.value,
                    "unit": judgement.unit,
                    "at_s": judgement.at_s,
                    "column": judgement.column,
                    "text": judgement.text,
                    "line": judgement.line,
                    "failed_s": [{"from_s": begin, "to_s": end} for begin, end in judgement.failed_s],
                }
                for judgement in self.judgements
            ],
        }


def write_results(folder: RunFolder, result: TestResult) -> dict[str, Any]:
    """Write `verdict.json` and `junit.xml` of a run, and return the document of the former.

    Results of other plans on the same run stay. One of the same id is replaced, and its verdict is kept in `history`,
    with the content of its plan: a looser plan must not hide a failure. The run's verdict is the worst of all.

    Raises
    ------
    RunFolderError
        `verdict.json` is damaged.
    OSError
        A file cannot be written.
    """
    before = read_verdict(folder)["tests"]
    tests = [test for test in before if test["id"] != result.plan.id]
    same = next((test for test in before if test["id"] == result.plan.id), None)
    tests.append(result.document() | {"history": [] if same is None else _history(same)})
    document = {"verdict": overall(test["verdict"] for test in tests), "tests": tests}
    with replacing(folder.verdict) as unfinished:
        unfinished.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    with replacing(folder.junit) as unfinished:
        manifest = folder.read_manifest()
        unfinished.write_bytes(junit(document, manifest, label_texts(folder, manifest)))
    return document


def is_wanted_trip(document: dict[str, Any]) -> bool:
    """Return True for a passed `verdict.json` with a trip that a limit asked for: its run need not go to the end."""
    limits = (limit for test in document["tests"] for limit in test["limits"])
    asked = (limit for limit in limits if limit["limit"].lower().startswith("trip"))
    return document["verdict"] == "pass" and any(isinstance(parse(limit["limit"]).statement, Trips) for limit in asked)


def _history(test: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the earlier verdicts of a test with this one, oldest first; the same one again is one entry."""
    failed = [limit["id"] for limit in test["limits"] if limit["verdict"] == "fail"]
    entry = {key: test[key] for key in ("sha256", "judged", "verdict")} | {"failed": failed}
    before = [*test.get("history", [])]
    if before and all(before[-1][key] == entry[key] for key in ("sha256", "verdict", "failed")):
        return before
    return [*before, entry]


def junit(document: dict[str, Any], manifest: dict[str, Any], labels: Mapping[str, str] | None = None) -> bytes:
    """Return a verdict as JUnit XML: one suite for each plan, one case for each limit.

    A failed limit is a `failure`, an inconclusive one an `error`: no program counts it as passed. Elements and their
    order are those of the Ant task's schema, which all readers know. Requirements, measured values and the labels of
    the run are properties of the suite.
    """
    root = ET.Element("testsuites")
    started = str(manifest.get("started", ""))[:19] or "1970-01-01T00:00:00"
    wall_s = f"{float(manifest.get('wall_s', 0.0)):.3f}"
    for number, test in enumerate(document["tests"]):
        limits = test["limits"]
        counts = {verdict: sum(limit["verdict"] == verdict for limit in limits) for verdict in ("fail", "inconclusive")}
        suite = ET.SubElement(
            root,
            "testsuite",
            name=_text(test["id"]),
            package="hil",
            id=str(number),
            tests=str(len(limits)),
            failures=str(counts["fail"]),
            errors=str(counts["inconclusive"]),
            time=wall_s,
            timestamp=started,
            hostname=_text(manifest.get("host") or "unknown"),
        )
        properties = ET.SubElement(suite, "properties")
        about = {"run": manifest.get("uid", ""), "plan.sha256": test["sha256"], "verdict": test["verdict"]}
        about |= labels or {}
        about |= {
            f"verdict.before.{number}": f"{one['verdict']} at {one['judged']}, plan.sha256 {one['sha256']}"
            for number, one in enumerate(test.get("history", []), 1)
        }
        about |= {f"requirement.{limit['id']}": limit["requirement"] for limit in limits}
        about |= {f"severity.{limit['id']}": limit["severity"] for limit in limits}
        judged = (limit for limit in limits if limit["verdict"] != "inconclusive")
        known = (limit for limit in judged if limit.get("value") is not None)
        about |= {f"value.{limit['id']}": f"{limit['value']:.6g} {limit['unit']}".rstrip() for limit in known}
        for name, value in about.items():
            ET.SubElement(properties, "property", name=_text(name), value=_text(value))
        for limit in limits:
            _case(suite, test["id"], limit)
        ET.SubElement(suite, "system-out").text = _text(test["title"])
        ET.SubElement(suite, "system-err")
    ET.indent(root, " ")
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="utf-8") + b"\n"


def _case(suite: ET.Element, plan_id: str, limit: dict[str, Any]) -> None:
    name = f"{limit['id']}: {limit['limit']}" + (f" ({limit['step']})" if limit["step"] else "")
    case = ET.SubElement(suite, "testcase", name=_text(name), classname=_text(plan_id), time="0")
    kind = {"fail": "failure", "inconclusive": "error"}.get(limit["verdict"])
    if kind is not None:
        found = ET.SubElement(case, kind, message=_text(limit["text"]), type=_text(limit["severity"]))
        found.text = _text(f"{limit['requirement']} ({limit['severity']}): {limit['text']}")


def _text(text: object) -> str:
    """Return text that XML 1.0 can hold."""
    shown = plain(str(text), 4000)
    return "".join(mark for mark in shown if mark not in "\ufffe\uffff" and not 0xD800 <= ord(mark) <= 0xDFFF)
