"""READMEs of packages: each lists the modules that are there, and no others."""

from __future__ import annotations

import re

import pytest

from tests.docs.fences import PROJECT

PACKAGES = sorted(
    str(path.parent.relative_to(PROJECT))
    for top in ("hil", "drivers", "twin")
    for path in (PROJECT / top).rglob("__init__.py")
)
MOST_MODULES = 12
ONE_FILE_A_KIND = {"twin/elements": 34}
"""Packages with more modules: one a kind of element."""


def _modules(package: str) -> list[str]:
    return sorted(path.stem for path in (PROJECT / package).glob("*.py") if not path.stem.startswith("__"))


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_has_a_readme_that_names_each_of_its_modules(package: str) -> None:
    text = (PROJECT / package / "README.md").read_text(encoding="utf-8")
    folders = [path.parent.name for path in (PROJECT / package).glob("*/__init__.py")]
    named = set(re.findall(r"`(?:[\w/]*/)?(\w+)(?:\.py|/)?`", text))
    assert [name for name in [*_modules(package), *folders] if name not in named] == []


@pytest.mark.parametrize("package", PACKAGES)
def test_a_readme_names_no_module_that_is_gone(package: str) -> None:
    readme = PROJECT / package / "README.md"
    for name in re.findall(r"`([\w/]+\.py)`", readme.read_text(encoding="utf-8")) if readme.exists() else ():
        assert any((folder / name).exists() for folder in (readme.parent, PROJECT)), name


def test_packages_have_few_modules() -> None:
    many = {name: len(_modules(name)) for name in PACKAGES if len(_modules(name)) > MOST_MODULES}
    assert set(many) == set(ONE_FILE_A_KIND)
    assert all(count <= ONE_FILE_A_KIND[name] for name, count in many.items())
