"""Files that the pages name in code marks: each path of the repository exists. `tests.language` checks links."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.docs.fences import PROJECT

PAGES = [
    *(PROJECT / name for name in ("README.md", "CONTRIBUTING.md")),
    *sorted(path for path in (PROJECT / "docs").rglob("*.md") if "_build" not in path.parts),
]
EXAMPLES = {"make_up_water", "NAME"}
"""Parts of names that stand for a file of the reader's own."""
_NAMED = re.compile(r"`((?:hil|drivers|twin|tests|profiles|docs)/[\w./-]*)`")


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(PROJECT)))
def test_files_that_a_page_names_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    named = {PROJECT / path for path in _NAMED.findall(text) if not any(example in path for example in EXAMPLES)}
    ignored = {PROJECT / "docs" / "_build"}
    assert sorted(str(path) for path in named - ignored if not path.exists()) == []
