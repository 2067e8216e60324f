"""Decision records: their form, their index, and references to them in the code."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.docs.fences import PROJECT

FOLDER = PROJECT / "docs" / "decisions"
RECORDS = sorted(FOLDER.glob("[0-9]*.md"))
MOST_WORDS = 260
"""Half a page of about 500 words, and its headings."""
_ROW = re.compile(r"^\| \[(\d{4})\]\(([^)]+)\) \| (.+?) \| (.+?) \|$", re.MULTILINE)
_REFERENCE = re.compile(r"decisions?[ /](\d{4})")


@pytest.mark.parametrize("record", RECORDS, ids=lambda path: path.stem)
def test_a_record_has_status_context_decision_and_consequences_on_half_a_page(record: Path) -> None:
    text = record.read_text(encoding="utf-8")
    assert re.match(rf"# {record.name[:4]}: \S", text)
    assert re.findall(r"^## (.+)$", text, re.MULTILINE) == ["Context", "Decision", "Consequences"]
    assert re.search(r"^\*\*Status\*\*: (accepted|superseded|rejected)\b", text, re.MULTILINE)
    assert len(text.split()) <= MOST_WORDS


def test_the_index_lists_every_record_with_its_title_and_status() -> None:
    listed = {name: (title, status) for _, name, title, status in _ROW.findall((FOLDER / "index.md").read_text())}
    written = {}
    for record in RECORDS:
        text = record.read_text(encoding="utf-8")
        status = re.search(r"^\*\*Status\*\*: (.+?)\.$", text, re.MULTILINE)
        title = re.match(r"# \d{4}: (.+)", text)
        assert status and title, record.name
        written[record.name] = (title[1], status[1])
    assert listed == written


def test_a_record_that_another_one_amends_or_supersedes_names_it() -> None:
    texts = {record.name: record.read_text(encoding="utf-8") for record in RECORDS}
    for name, text in texts.items():
        status = text.split("**Status**", 1)[1].split("\n", 1)[0]
        assert name not in status
        for other in re.findall(r"\((\d{4}-[^)]+\.md)\)", status):
            assert other in texts, f"{name}: {other}"


def test_a_record_that_is_superseded_says_by_which() -> None:
    texts = {record.name: record.read_text(encoding="utf-8") for record in RECORDS}
    for name, text in texts.items():
        status = text.split("**Status**", 1)[1].split("\n", 1)[0]
        for other in re.findall(r"supersedes [^\[]*\[\d{4}\]\((\d{4}-[^)]+\.md)\)", status):
            assert re.search(rf"superseded by \[\d{{4}}\]\({name}\)", texts[other]), f"{other} does not name {name}"


def test_numbers_of_records_in_the_code_exist() -> None:
    numbers = {record.name[:4] for record in RECORDS}
    for folder in ("hil", "drivers", "twin", "tests", "profiles"):
        for path in (PROJECT / folder).rglob("*"):
            if path.suffix in {".py", ".md", ".toml"}:
                for number in _REFERENCE.findall(path.read_text(encoding="utf-8")):
                    assert number in numbers, f"{path.relative_to(PROJECT)}: decision {number}"
