"""Language rules: each rule on small texts, then the repository itself."""

from __future__ import annotations

import pytest

from tests.language.check import findings, module_findings, page_findings
from tests.language.markdown import sentences
from tests.language.rules import LONGEST, has_weak_opening, words_to_replace
from tests.language.source import texts


@pytest.mark.parametrize(
    "text",
    [
        "the twin foretold the tank",
        "a spell of two hours",
        "the two causes cannot be told apart",
        "a thermometer that lies",
        "the run is soaking",
        "a stretch without samples",
        "What is the matter with it",
    ],
)
def test_private_expressions_are_found(text: str) -> None:
    assert words_to_replace(text)


@pytest.mark.parametrize("text", ["the twin predicts", "spelling", "misspelled", "it tells the time", "a late reply"])
def test_everyday_words_are_left_alone(text: str) -> None:
    assert not words_to_replace(text)


@pytest.mark.parametrize(
    ("text", "weak"),
    [
        ("What the record holds.", True),
        ("**Where** it stands.", True),
        ("Whether it moves.", True),
        ("How-to guides solve one task.", False),
        ("Whatever comes.", False),
        ("Return what it holds.", False),
    ],
)
def test_weak_openings(text: str, weak: bool) -> None:
    assert has_weak_opening(text) is weak


def test_sentences_of_a_page_leave_out_code_tables_and_headings() -> None:
    code = "```sh\nhil run\n```\n\n| a | b |\n|---|---|\n\n"
    page = f"# Title\n\nOne two. Three four\nfive, e.g. six.\n\n{code}- seven eight\n- nine\n"
    assert [s.text for s in sentences(page)] == ["One two.", "Three four five, e_g_ six.", "seven eight", "nine"]


def test_a_formula_between_two_paragraphs_ends_the_first() -> None:
    page = "The sum is\n```{math}\na + b\n```\nof both\n$$\nc\n$$\nand more.\n"
    assert [s.text for s in sentences(page)] == ["The sum is", "of both", "and more."]


def test_a_file_name_in_code_is_one_word_and_ends_no_sentence() -> None:
    (found,) = sentences("See `a b.c Which` and [the page](x.md#Why.) here.")
    assert found.length == 6


def test_long_sentences_and_pages_of_long_sentences_are_findings() -> None:
    problems = [f.problem for f in page_findings("x.md", "word " * (LONGEST + 1) + ".\n")]
    assert any(f"at most {LONGEST}" in problem for problem in problems)
    assert any("median" in problem for problem in problems)


SOURCE = '''
"""How it works."""

class Public:
    """Of a kind."""

    value = 1
    """Where it is."""

    def _private(self):
        """What it does."""

def function():
    """Return a spell."""
    raise ValueError("the record cannot tell this")

def _hidden():
    """Whether."""
'''


def test_docstrings_of_private_objects_are_left_alone() -> None:
    openings = [f.line for f in module_findings("x.py", SOURCE) if "begin with" in f.problem]
    assert openings == [2, 5, 8]


def test_messages_are_read_as_docstrings_are() -> None:
    assert [f.line for f in module_findings("x.py", SOURCE) if "use " in f.problem] == [14, 15]
    assert any(not text.is_docstring and "record" in text.text for text in texts(SOURCE))


def test_the_repository_has_no_findings() -> None:
    assert [str(finding) for finding in findings()] == []
