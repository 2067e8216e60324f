"""Tables and objects that describe a tower: anything but a readable regular file is refused in one sentence."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from hil.record.raw import RecordError
from hil.tower.station.input_files import read_object, read_rows

READERS = {"table": lambda path: read_rows(path, ("a",)), "object": lambda path: read_object(path, {}, "mend it")}


@pytest.mark.parametrize("reader", READERS.values(), ids=READERS)
@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda path: None, "No such file"),
        (lambda path: path.mkdir(), "it is a folder"),
        (os.mkfifo, "it is a pipe"),
        (lambda path: path.write_bytes(b"a\n\xff\xfe\n"), "no UTF-8 text"),
    ],
    ids=["missing", "folder", "pipe", "Latin-1"],
)
def test_what_is_no_text_file_is_refused_with_its_kind(
    reader: Callable[[Path], object], make: Callable[[Path], object], reason: str, tmp_path: Path
) -> None:
    path = tmp_path / "given"
    make(path)
    with pytest.raises(RecordError, match=reason) as caught:
        reader(path)
    assert len(str(caught.value).splitlines()) == 1


def test_rows_come_with_their_lines_and_without_blanks(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("\ufeffa,b\n 1 ,x\n2\n", encoding="utf-8")
    assert read_rows(path, ("a",)) == [(2, {"a": "1", "b": "x"}), (3, {"a": "2", "b": ""})]


def test_a_missing_column_is_named_beside_those_that_are_there(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("b,c\n1,2\n", encoding="utf-8")
    with pytest.raises(RecordError, match=r"lacks the column a; its first line has b, c"):
        read_rows(path, ("a",))


@pytest.mark.parametrize(("text", "reason"), [("{", "not valid JSON"), ("[1]", "not a JSON object")])
def test_what_is_no_object_is_refused(text: str, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "sheet.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(RecordError, match=reason):
        read_object(path, {}, "mend it")


def test_only_line_ends_of_a_table_end_its_lines(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_bytes("a,b\r\n1,x\u2028y\x0bz\r\n2,\x85\r\n".encode())
    assert read_rows(path, ("a",)) == [(2, {"a": "1", "b": "x\u2028y\x0bz"}), (3, {"a": "2", "b": ""})]
    path.write_text('a,b\n1,"two\nlines"\n2,x\n')
    assert [line for line, _ in read_rows(path, ("a",))] == [3, 4]


def test_a_cell_that_no_table_has_is_refused_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text(f'a,b\n1,2\n"{"x" * 200_000},2\n')
    with pytest.raises(RecordError, match=r"table.csv:3: is no line of a CSV table .*is a quotation mark missing"):
        read_rows(path, ("a",))
