"""Changelog: one line for each change, under its version."""

from __future__ import annotations

import re

from tests.docs.fences import PROJECT

LINES = (PROJECT / "CHANGELOG.md").read_text(encoding="utf-8").splitlines()


def test_each_entry_is_one_line() -> None:
    entries = LINES[LINES.index("## 0.2.0") :]
    assert [line for line in entries if line and not re.match(r"- \S|##", line)] == []


def test_the_newest_version_is_that_of_the_package() -> None:
    from hil import __version__

    newest = next(line for line in LINES if line.startswith("## "))
    assert newest == f"## {__version__}"
