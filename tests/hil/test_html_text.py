"""Text becomes HTML in one place, and no string of a forged file reaches a page as markup."""

from __future__ import annotations

import html.parser
import json
import re
import sqlite3
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.diagnosis.page import page
from hil.diagnosis.store import Findings, curves_of
from hil.files.html import Html, document, element, image, table
from hil.journal.writer import JournalReader
from hil.report.page import write_report
from hil.report.plot_script import SCRIPT
from hil.run_folder.folder import RunFolder, new_manifest
from tests.hil.made_diagnosis import SENSORS, made
from tests.hil.synthetic_journal import make, write

MARK = "$\\frac{<script>x</script>\"'&<img src=x onerror=alert(1)>"
SHORT = "<u>\"'&$"
"""Where a picture draws it: a longer one leaves no room for the picture."""
ALLOWED = {
    "html",
    "head",
    "meta",
    "title",
    "style",
    "body",
    "h1",
    "h2",
    "h3",
    "p",
    "b",
    "i",
    "div",
    "span",
    "table",
    "tr",
    "th",
    "td",
    "ul",
    "li",
    "img",
}


class Reader(html.parser.HTMLParser):
    """Tags, attributes and text of a page, as a browser would take it apart."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.attributes: set[tuple[str, str]] = set()
        self.texts: list[str] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.attributes |= {(tag, name) for name, _ in attrs}

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


def safe(page: str) -> Reader:
    """The page, which must hold none but known tags and attributes, and a policy."""
    others = re.sub(r'<script type="application/json" class="plot">[^<]*</script>', "", page)  # data, which nobody runs
    others = others.replace(f"<script>{SCRIPT}</script>", "")
    read = Reader(others)
    assert read.tags <= ALLOWED
    assert not {name for _, name in read.attributes if name.startswith("on") or name in ("href", "style", "srcset")}
    assert "<script" not in others and "onerror=alert(1)>" not in others
    assert "default-src 'none'" in page.split("<body>")[0]
    return read


@given(st.text(), st.text())
def test_any_text_and_any_attribute_come_back_as_they_were(text: str, value: str) -> None:
    made_page = document(text, "", [element("p", text, title=value or "x")])
    read = safe(made_page) if "onerror=alert(1)>" not in text else Reader(made_page)
    assert read.tags <= ALLOWED
    made_page.encode("utf-8")


@pytest.mark.parametrize("text", [MARK, "</title>", "</style><b>", "\0", "\ud800", "--><b>", "&lt;"])
def test_what_closes_something_closes_nothing(text: str) -> None:
    read = safe(document(text, "p { color: red }", [element("p", text, class_=text), table([text], [[text]])]))
    assert {"b", "script"} & read.tags == set()


def test_ready_markup_cannot_be_handed_in() -> None:
    with pytest.raises(TypeError, match="plain text"):
        Html("<b>")
    with pytest.raises(TypeError, match="no text"):
        f"{element('p', 'x')}"
    for name in ("script", "iframe", "p onclick", "P", "p>"):
        with pytest.raises(ValueError, match="element"):
            element(name)
    for name in ("onclick", "style", "href", "src"):
        with pytest.raises(ValueError, match="attribute"):
            element("p", **{name: "x"})
    with pytest.raises(ValueError, match="picture"):
        image('svg+xml" onload="x', b"")
    with pytest.raises(ValueError, match="style"):
        document("t", "</style>", [])


def marked(value: Any, keys: bool = True) -> Any:
    """Plain data with MARK in every string, and in every key of an open table."""
    if isinstance(value, str):
        return f"{value}{MARK}"
    if isinstance(value, dict):
        return {f"{k}{MARK}" if keys else k: marked(v) for k, v in value.items()}
    return [marked(v) for v in value] if isinstance(value, list | tuple) else value


def a_run(folder: Path) -> RunFolder:
    """A finished run of synthetic data with everything that a report shows."""
    run = RunFolder(folder)
    write(run.journal, make(400))
    manifest = new_manifest({"rig": Path(__file__)}, mode="real") | {
        "exit_status": "done",
        "reason": "over",
        "safe": True,
        "problems": ["one"],
        "segments": [
            {
                "number": 2,
                "from_s": 1.0,
                "gap_s": 2.0,
                "profile_s": 3.0,
                "why": "cut",
                "exit_status": "done",
                "reason": "r",
            }
        ],
        "errors_K": {"columns": ["static"], "rows": {"T_tank_C": [0.1]}, "noise_K": {"T_tank_C": 0.05}},
        "bands": {"static": {"T_tank_C": [0.1, 0.9]}},
        "parameters": {"pso": {"tank.hA": [1.0, None, True]}},
        "adoption": {"sentence": "adopted"},
    }
    run.write_manifest(manifest)
    return run


OPEN = {"files", "versions", "settings", "bands", "parameters"}
"""Tables of `run.json` whose keys are names."""


def test_no_string_of_a_forged_run_reaches_its_report_as_markup(tmp_path: Path) -> None:
    run = a_run(tmp_path)
    manifest = {key: marked(value, key in OPEN) for key, value in run.read_manifest().items()}
    manifest["files"] = {f"rig{MARK}": {"path": MARK, "sha256": MARK}}
    manifest["segments"] = [marked(item, keys=False) for item in run.read_manifest()["segments"]]
    manifest["bands"] = {MARK: {MARK: [0.1, 0.9]}}
    manifest["parameters"] = {MARK: {MARK: [1.0, None, True]}}
    manifest["errors_K"] = {"columns": [MARK], "rows": {MARK: [0.1]}, "noise_K": {MARK: 0.05}}
    run.write_manifest(manifest)
    database = sqlite3.connect(run.journal)
    header = json.loads(database.execute("SELECT value FROM meta WHERE key = 'header'").fetchone()[0])
    header["twin_sensors"] = {f"{k}{MARK}": v for k, v in header["twin_sensors"].items()}
    header["profile"] = MARK
    database.execute("UPDATE meta SET value = ? WHERE key = 'header'", (json.dumps(header),))
    database.execute("UPDATE events SET level = level || ?, text = text || ?", (MARK, MARK))
    database.execute("UPDATE calibrations SET calibrator = ?", (MARK,))
    database.execute("UPDATE proposals SET calibrator = ?", (MARK,))
    database.commit()
    database.close()
    write_report(run)
    read = safe(run.report.read_text(encoding="utf-8"))
    shown = "\n".join(read.texts)
    assert all(part in shown for part in ("done", "over", "one", "cut", "adopted", "ERROR", "run finished"))
    assert shown.count(MARK) >= 20


def test_no_name_of_a_forged_signal_reaches_the_tables_and_pictures_of_a_report(tmp_path: Path) -> None:
    run = a_run(tmp_path)
    database = sqlite3.connect(run.journal)
    header = json.loads(database.execute("SELECT value FROM meta WHERE key = 'header'").fetchone()[0])
    predicted = {column for columns in header["twin_sensors"].values() for column in columns}
    reader = JournalReader(run.journal)
    free = [place for place, signal in enumerate(reader.header.signals) if signal.column not in predicted]
    reader.close()
    assert free
    for place in free:
        header["signals"][place]["name"] += SHORT
    database.execute("UPDATE meta SET value = ? WHERE key = 'header'", (json.dumps(header),))
    database.commit()
    database.close()
    write_report(run)
    read = safe(run.report.read_text(encoding="utf-8"))
    assert "u" not in read.tags
    assert "".join(read.texts).count(SHORT) >= len(free)


def test_no_string_of_a_forged_diagnosis_reaches_its_page_as_markup() -> None:
    diagnosis = made("ambiguous")
    plain = diagnosis.document() | {"record": "a/r.csv"}
    plain["provenance"] = {
        "files": {SHORT: {"path": SHORT, "sha256": SHORT}},
        "versions": {SHORT: SHORT},
        "host": SHORT,
    }
    plain["next_experiment"] = {"why": SHORT, "hold": {SHORT: SHORT}, "steps": [{"time_s": 0.0, SHORT: SHORT}] * 2}
    curves = curves_of(diagnosis, SENSORS)

    def strings(value: Any, key: str = "") -> Any:
        if isinstance(value, str):
            return value if key in ("verdict", "method") else f"{value}{SHORT}"
        if isinstance(value, dict):
            return {k: strings(v, k) for k, v in value.items()}
        return [strings(v) for v in value] if isinstance(value, list | tuple) else value

    read = safe(page(Findings(strings(plain), curves)))
    assert "\n".join(read.texts).count(SHORT) >= 20
