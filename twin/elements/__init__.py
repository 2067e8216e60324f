"""Element kinds, one file each. A new file in this folder is a new kind: it is found without registration."""

from __future__ import annotations

import importlib
import inspect
import pkgutil

from twin.elements.base import Element, Names, Parameter, ParameterSpec
from twin.elements.candidates import Candidate, Sites
from twin.elements.fragments import Fragment

__all__ = ["KINDS", "Candidate", "Element", "Fragment", "Names", "Parameter", "ParameterSpec", "Sites"]


def _discover() -> dict[str, type[Element]]:
    kinds: dict[str, type[Element]] = {}
    for info in pkgutil.iter_modules(__path__):
        if info.name in ("base", "symbols"):
            continue
        module = importlib.import_module(f"{__name__}.{info.name}")
        for _, cls in inspect.getmembers(module, inspect.isclass):
            if issubclass(cls, Element) and cls.__module__ == module.__name__ and not inspect.isabstract(cls):
                kinds[cls.kind] = cls
    return kinds


KINDS: dict[str, type[Element]] = _discover()
"""Kind as written in a twin file -> its class."""
