"""Output of a test in the terminal: a line for each limit, and the verdict."""

from __future__ import annotations

from typing import Any

from hil.files import on_terminal
from hil.report import earlier_verdicts
from hil.testing.judgement import Judgement

_WORDS = {"pass": "pass", "fail": "FAIL", "inconclusive": "inconclusive"}
_COUNTS = (("pass", "passed"), ("fail", "failed"), ("inconclusive", "inconclusive"))


def judgement_line(judgement: Judgement) -> str:
    """Return the line of one limit: verdict, id, sentence, and the value that decided."""
    limit = judgement.limit
    return _line(judgement.verdict, limit.id, limit.text, limit.step, judgement.text)


def document_lines(document: dict[str, Any], plan_id: str | None = None) -> list[str]:
    """Return the lines of a `verdict.json`, or of one plan in it: each limit, the verdict with the counts, and earlier
    verdicts.
    """
    lines = []
    for test in document["tests"]:
        if plan_id is not None and test["id"] != plan_id:
            continue
        limits = test["limits"]
        lines += [_line(item["verdict"], item["id"], item["limit"], item["step"], item["text"]) for item in limits]
        counts = [f"{sum(item['verdict'] == word for item in limits)} {said}" for word, said in _COUNTS]
        lines.append(f"{_WORDS[test['verdict']]}: {test['title']}: {', '.join(counts)}")
        lines += earlier_verdicts(test)
    return [on_terminal(line) for line in lines]


def _line(verdict: str, limit_id: str, text: str, step: str | None, finding: str) -> str:
    return f"{_WORDS[verdict]:<12}  {limit_id}  {text}{f' ({step})' if step else ''}: {finding}"
