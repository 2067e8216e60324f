"""Parts of the documentation site: maths without a script, and the pages that are made from the code."""

from __future__ import annotations

import sys
from pathlib import Path

import click
import pytest
from sphinx.application import Sphinx

from hil.cli import group
from tests.docs.fences import PROJECT

EXTENSIONS = str(PROJECT / "docs" / "_ext")


@pytest.fixture
def extensions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(EXTENSIONS)


def _built(folder: Path, text: str) -> tuple[str, str]:
    """Return the page that Sphinx makes of `text` with our maths renderer, and its warnings."""
    source, out = folder / "source", folder / "out"
    source.mkdir()
    (source / "index.md").write_text(text, encoding="utf-8")
    with (folder / "warnings").open("w+", encoding="utf-8") as warnings:
        app = Sphinx(
            source,
            None,
            out,
            folder / "trees",
            "html",
            status=None,
            warning=warnings,
            freshenv=True,
            confoverrides={
                "extensions": ["myst_parser", "mathml"],
                "html_math_renderer": "mathml",
                "myst_enable_extensions": ["dollarmath"],
            },
        )
        app.build()
        warnings.seek(0)
        return (out / "index.html").read_text(encoding="utf-8"), warnings.read()


@pytest.mark.filterwarnings("default")
def test_formulas_become_mathml_and_no_script_is_loaded_for_them(extensions: None, tmp_path: Path) -> None:
    page, warnings = _built(tmp_path, "# T\n\nHeat $\\dot Q$.\n\n$$ Q = \\frac{a}{b} \\dots $$\n\n$$ \\hat y_m $$\n")
    assert "<msub><mover" in page  # the subscript is not under the accent
    assert page.count("<math") == 3 and "<mfrac>" in page
    assert "mathjax.js" not in page.lower() and 'src="http' not in page
    assert "MathML" not in warnings


@pytest.mark.filterwarnings("default")
def test_a_formula_that_cannot_be_shown_is_a_warning_with_its_page(extensions: None, tmp_path: Path) -> None:
    _, warnings = _built(tmp_path, "# T\n\n$\\notacommand{x}$\n")
    assert "index.md" in warnings and "cannot be shown as MathML" in warnings


def _leaves(command: click.Command, name: str) -> list[str]:
    if not isinstance(command, click.Group):
        return [name]
    context = click.Context(command)
    found = [name]
    for verb in command.list_commands(context):
        part = command.get_command(context, verb)
        assert part is not None
        found += _leaves(part, f"{name} {verb}")
    return found


def test_the_command_page_has_a_section_for_every_command(extensions: None) -> None:
    from command_pages import markdown_of  # type: ignore[import-not-found]

    lines = list(markdown_of(group, "hil"))
    headings = {line.lstrip("# ") for line in lines if line.startswith("#")}
    assert headings == set(_leaves(group, "hil")) - {"hil"}
    assert any("`--lockstep`" in line for line in lines)
    assert not any("\b" in line for line in lines)
    sys.modules.pop("command_pages", None)


def test_packages_with_a_public_interface_are_found(extensions: None, tmp_path: Path) -> None:
    from public_api import public_packages  # type: ignore[import-not-found]

    packages = {"top": '__all__ = ["a"]\n', "top/private": "a = 1\n", "top/inner": "__all__: list = []\n"}
    for name, text in packages.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(text, encoding="utf-8")
    assert public_packages(tmp_path, "top") == ["top", "top.inner"]
    sys.modules.pop("public_api", None)
