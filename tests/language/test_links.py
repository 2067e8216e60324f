"""Links of pages: broken files and anchors are found, and anchors are those that the documentation site makes."""

from __future__ import annotations

from pathlib import Path

import pytest
from markdown_it import MarkdownIt
from myst_parser.slugs import github_slugify, unique_slug

from tests.language.check import PROJECT, Finding, findings
from tests.language.links import SITE_LEVELS, anchors, broken_links, links, pages


def problems(root: Path, text: str) -> list[tuple[int, str]]:
    page = root / "docs" / "page.md"
    page.parent.mkdir(exist_ok=True)
    page.write_text(text, encoding="utf-8")
    return list(broken_links(root, page))


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "other.md").write_text("# Other page\n\n## Heat `Q` & loss\n\n#### Deep\n", encoding="utf-8")
    (tmp_path / "README.md").write_text("# Project\n\n#### Deep\n", encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize(
    "link",
    [
        "[a](other.md)",
        "[a](other.md#heat-q--loss)",
        "[a](#own-part)",
        "[a](../README.md#deep)",
        "[a](..)",
        "[a](https://example.org/page#part)",
        "[a](mailto:someone@example.org)",
        "`[a](gone.md)` and ``b ` [a](gone.md)``",
        '![picture](other.md "title")',
        "[a]: other.md",
    ],
)
def test_links_that_lead_somewhere_pass(root: Path, link: str) -> None:
    assert problems(root, f"# Page\n\n## Own part\n\n{link}\n") == []


@pytest.mark.parametrize(
    ("link", "words"),
    [
        ("[a](gone.md)", "'gone.md' leads to no file"),
        ("![a](gone.png)", "leads to no file"),
        ("[a]: gone.md", "leads to no file"),
        ("[a](other.md#heat)", "'other.md#heat' leads to no heading of other.md"),
        ("[a](#gone)", "leads to no heading of page.md"),
        ("[a](other.md#deep)", "leads to no heading"),
        ("[a](/etc/hosts)", "leads out of the repository"),
        ("[first](other.md) and [second](gone.md)", "'gone.md'"),
    ],
)
def test_broken_links_are_found_with_their_line(root: Path, link: str, words: str) -> None:
    ((line, problem),) = problems(root, f"# Page\n\n{link}\n")
    assert line == 3 and words in problem


def test_links_in_code_are_no_links_and_those_in_a_note_are() -> None:
    page = "```text\n[a](b.md)\n```\n\n:::{note}\n[c](d.md)\n:::\n\n```{figure} e.svg\n:alt: f\n```\n"
    assert list(links(page)) == [(6, "d.md"), (9, "e.svg")]


def test_repeated_headings_get_numbers_and_labels_are_anchors() -> None:
    assert anchors("# A\n\n## B\n\n(mark)=\n## B\n") == {"a", "b", "mark", "b-1"}


def test_the_check_reports_broken_links_of_all_pages(root: Path) -> None:
    package = root / "hil" / "part"
    package.mkdir(parents=True)
    (package / "README.md").write_text("# hil.part\n\nSee [there](../gone.md).\n", encoding="utf-8")
    assert findings(root) == [Finding("hil/part/README.md", 3, "the link '../gone.md' leads to no file")]


def test_the_site_makes_anchors_of_as_many_levels() -> None:
    text = (PROJECT / "docs" / "conf.py").read_text(encoding="utf-8")
    assert f"myst_heading_anchors = {SITE_LEVELS}\n" in text


def test_anchors_are_those_of_the_site() -> None:
    parser = MarkdownIt()
    for page in pages(PROJECT):
        text, expected = page.read_text(encoding="utf-8"), set()
        tokens = parser.parse(text)
        for opening, inline in zip(tokens, tokens[1:], strict=False):
            if opening.type == "heading_open" and int(opening.tag[1]) <= SITE_LEVELS:
                parts = [part.content for part in inline.children or () if part.type in ("text", "code_inline")]
                expected.add(unique_slug(github_slugify("".join(parts)), expected))
        assert anchors(text) == expected, page
