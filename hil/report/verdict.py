"""First section of a report: the verdict of each test plan, with its limits."""

from __future__ import annotations

from typing import Any

from hil.files import Html, element, joined
from hil.report.statistics import NONE, number, symbol

WORDS = {"pass": "passed", "fail": "FAILED", "inconclusive": "INCONCLUSIVE"}
"""Verdicts as a report shows them."""
_CLASSES = {"pass": "PASS", "fail": "ERROR", "inconclusive": "WARN"}
_HEAD = ("verdict", "limit", "", "measured", "requirement", "severity", "finding")


def verdict_section(document: dict[str, Any]) -> Html:
    """Return the section of a checked `verdict.json`; nothing for a run that was not judged."""
    return joined(_test(test) for test in document["tests"])


def _test(test: dict[str, Any]) -> Html:
    head = element("tr", *(element("th", cell) for cell in _HEAD))
    title = element("h2", "Test: ", test["title"] or test["id"], " ", _word(test["verdict"]))
    rows = (_row(limit) for limit in test["limits"])
    note = f"plan {test['id']}, sha256 {test['sha256'][:16]}, judged {test['judged']}"
    earlier = (element("p", line, class_="note") for line in earlier_verdicts(test))
    return joined([title, element("table", head, *rows, class_="verdict"), element("p", note, class_="note"), *earlier])


def earlier_verdicts(test: dict[str, Any]) -> list[str]:
    """Return a sentence for each earlier verdict of a test that differs from the present one, or is of another plan."""
    found = []
    for one in test.get("history", []):
        is_other = one["sha256"] != test["sha256"]
        if not is_other and one["verdict"] == test["verdict"]:
            continue
        plan = f"a plan of the same id and other content (sha256 {one['sha256'][:16]})" if is_other else "the same plan"
        failed = f"; failed: {', '.join(one['failed'])}" if one["failed"] else ""
        found.append(f"judged before, at {one['judged']}, by {plan}: {WORDS[one['verdict']]}{failed}")
    return found


def _row(limit: dict[str, Any]) -> Html:
    value = number(limit["value"])
    sentence = limit["limit"] + (f" ({limit['step']})" if limit.get("step") else "")
    return element(
        "tr",
        element("td", _word(limit["verdict"])),
        element("td", limit["id"]),
        element("td", sentence, class_="text"),
        element("td", f"{value} {symbol(limit['unit'])}".rstrip() if value != NONE else NONE),
        element("td", limit["requirement"], class_="text"),
        element("td", limit["severity"], class_="text"),
        element("td", limit["text"], class_="text"),
    )


def _word(verdict: str) -> Html:
    return element("b", WORDS[verdict], class_=_CLASSES[verdict])
