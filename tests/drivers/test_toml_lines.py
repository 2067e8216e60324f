"""Lines of keys in TOML text: sections, lists of tables, tables within a line, and keys that are not there."""

from __future__ import annotations

import time

import pytest

from drivers.rig_file.text.toml_lines import key_lines, line_of, tables_of

TEXT = """\
title = "a [point] # = no section"

[rig]
name = 'x'
about = \"\"\"
[[point]]
name = "in a text"
\"\"\"
deep.er = 1

[[point]]
name = "first" # [[point]]

[[point]]
"address" = 4
limits = [
  0.0,
  9.0, # the most
]
fields = [ { a = 1, b = { c = 2 } },
  { a = 3 } ]

  [[point.hole]]
  last = 7

[bus.plc]
host = "h"
"""


@pytest.mark.parametrize(
    ("place", "line"),
    [
        (("title",), 1),
        (("rig", "name"), 4),
        (("name",), 4),
        (("rig", "deep", "er"), 9),
        (("point", 0, "name"), 12),
        (("point", 0, "unit"), 11),
        (("point", 1, "address"), 15),
        (("point", 1, "limits", 1), 18),
        (("point", 1, "fields", 0, "b", "c"), 20),
        (("point", 1, "fields", 1, "a"), 21),
        (("point", 1, "hole", 0, "last"), 24),
        (("point", 1, "hole", 0, "first"), 23),
        (("bus", "plc", "host"), 27),
        (("bus", "plc", "port"), 26),
        (("heartbeat", "point"), 3),
    ],
)
def test_a_place_has_the_line_of_its_key_or_of_the_table_that_lacks_it(place, line):
    assert line_of(TEXT, place) == line


def test_text_without_sections_has_line_one_for_what_is_not_there():
    assert line_of("a = 1\nb = 2\n", ("c",)) == 1
    assert line_of("", ("c",)) == 1


def test_text_that_is_no_toml_gives_the_lines_found_so_far():
    assert key_lines('a = 1\nb = "unfinished\nc = 3\n')[("a",)] == 1


@pytest.mark.parametrize("raw", [b"a = " + b"9" * 5000, b"a = " + b"[" * 3000 + b"]" * 3000, b"a = 1\na = 2", b"\xff"])
def test_text_that_cannot_be_read_is_a_value_error_with_a_remedy(raw):
    with pytest.raises(ValueError, match=r"is not (valid TOML|UTF-8 text).*(correct it|save it|take one of them out)"):
        tables_of(raw)


@pytest.mark.parametrize("text", ["[{}]", "a = 1\n{} = 1", "a = {{ {} = 1 }}", "['x'.{}]"])
@pytest.mark.parametrize("dot", [".", " . "])
def test_a_key_of_very_many_parts_is_refused_before_it_is_parsed(text, dot):
    key = dot.join(["ab"] * 200_000)
    began = time.monotonic()
    with pytest.raises(ValueError, match=r"is not valid TOML: the key in line \d has more than 50 parts"):
        tables_of(text.format(key).encode())
    assert time.monotonic() - began < 5.0  # tomllib takes minutes


def test_long_names_numbers_and_texts_are_no_long_keys():
    text = f"{'a' * 100_000} = [{'1.5, ' * 10_000}]\nb.c.d.'e.f' = 'so. it. goes.'\n"
    assert tables_of(text.encode())[1]["b"] == {"c": {"d": {"e.f": "so. it. goes."}}}


@pytest.mark.parametrize(
    ("text", "remedy"),
    [
        ("name = \u201crig\u201d", 'write straight quotes, as in name = "rig"'),
        ("[point]\na = 1\n[point]", "write [[point]] with two brackets where there are several"),
        ("a = True", "write true in lower case"),
        ("a = off  # for now", "write false in lower case"),
        ("a = 0,5", "write a decimal point, as in 1.5"),
        (r'dbc = "C:\data\bus.dbc"', "write / in paths, or put the text in single quotes"),
        (r'ca = "C:\users\ca.pem"', "write / in paths, or put the text in single quotes"),
        ("name = rig_2", 'put text in quotes, as in name = "rig"'),
        ("a = ]", "correct it there"),
    ],
)
def test_a_usual_mistake_in_toml_comes_with_its_own_remedy(text, remedy):
    with pytest.raises(ValueError, match="is not valid TOML") as caught:
        tables_of(text.encode())
    assert str(caught.value).endswith(f"; {remedy}")
