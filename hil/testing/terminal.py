"""Output of a test in the terminal: a line for each limit, and the verdict."""

from __future__ import annotations

from hil.testing.judge import Judgement
from hil.testing.results import TestResult

_WORDS = {"pass": "pass", "fail": "FAIL", "inconclusive": "inconclusive"}


def judgement_line(judgement: Judgement) -> str:
    """Return the line of one limit: verdict, id, sentence, and the value that decided."""
    limit = judgement.limit
    step = f" ({limit.step})" if limit.step else ""
    return f"{_WORDS[judgement.verdict]:<12}  {limit.id}  {limit.text}{step}: {judgement.text}"


def result_lines(result: TestResult) -> list[str]:
    """Return the lines of a result: each limit, then the verdict with the counts."""
    counts = [
        f"{sum(judgement.verdict == verdict for judgement in result.judgements)} {word}"
        for verdict, word in (("pass", "passed"), ("fail", "failed"), ("inconclusive", "inconclusive"))
    ]
    lines = [judgement_line(judgement) for judgement in result.judgements]
    return [*lines, f"{_WORDS[result.verdict]}: {result.plan.title}: {', '.join(counts)}"]
