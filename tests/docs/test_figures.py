"""Figures of the explanation: each is drawn by the program as it is now."""

from __future__ import annotations

import importlib.util
from types import ModuleType

import matplotlib as mpl
import pytest

from tests.docs.fences import PROJECT

FIGURES = PROJECT / "docs" / "explanation" / "figures"


def _make() -> ModuleType:
    spec = importlib.util.spec_from_file_location("figures_of_the_explanation", FIGURES / "make.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


MAKE = _make()


@pytest.mark.parametrize("name", MAKE.FIGURES)
def test_a_figure_is_drawn(name: str) -> None:
    with mpl.rc_context():
        figure = MAKE.FIGURES[name]()
        drawn = [axis for axis in figure.axes if axis.has_data() or axis.texts or axis.patches]
        assert drawn == figure.axes
        MAKE.plt.close(figure)


def test_each_figure_of_the_site_has_a_function() -> None:
    assert {path.stem for path in FIGURES.glob("*.svg")} == set(MAKE.FIGURES)
