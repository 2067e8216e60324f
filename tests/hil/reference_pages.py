"""The tables of `docs/reference/*.md`, and the examples beside them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "reference"
_NAMES = re.compile(r"`([^`]+)`")


@dataclass(frozen=True)
class Page:
    """A page: by heading, rows of tables as column heading -> cell, in the order of the file; code by language."""

    name: str
    rows: dict[str, list[dict[str, str]]]
    code: dict[str, list[str]]

    def keys(self, *sections: str) -> dict[str, dict[str, str]]:
        """Key -> its row in the tables of some sections; a later section's stands for an earlier one's."""
        return {name: row for section in sections for row in self.rows[section] for name in _NAMES.findall(row["Key"])}


def page(name: str) -> Page:
    """The page called `name`, without `.md`."""
    rows: dict[str, list[dict[str, str]]] = {}
    code: dict[str, list[str]] = {}
    section, columns, language = "", [], ""
    for line in (FOLDER / f"{name}.md").read_text(encoding="utf-8").splitlines():
        if line.startswith("```"):
            language = "" if language else line[3:] or "text"
            if language:
                code.setdefault(language, []).append("")
        elif language:
            code[language][-1] += line + "\n"
        elif line.startswith("#"):
            section, columns = line.lstrip("#").strip().replace("`", ""), []
            assert section not in rows, f"{name}: {section} is there twice"
            rows[section] = []
        elif line.startswith("|"):
            cells = [cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
            if not columns:
                columns = cells
            elif not set(cells[0]) <= set("-:"):
                assert len(cells) == len(columns) and all(cells), f"{name}, {section}: {line}"
                rows[section].append(dict(zip(columns, cells, strict=True)))
        else:
            columns = []
    return Page(name, rows, code)
