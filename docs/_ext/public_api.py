"""Directive ``public-api``: one section for each package that declares a public interface (``__all__``).

The packages are found in the source tree, so a package that is added, moved or split shows up by itself.
"""

from __future__ import annotations

import ast
import importlib
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

log = logging.getLogger(__name__)
LEFT_OUT = ("hil.bench", "hil.cli")
"""Packages that are no library: benchmarks and commands have pages of their own."""


def public_packages(root: Path, top: str) -> list[str]:
    """Return the dotted names of the packages below `top` whose ``__init__`` assigns ``__all__``, sorted."""
    found = []
    for file in sorted((root / top).rglob("__init__.py")):
        names = [
            target.id
            for statement in ast.parse(file.read_text()).body
            if isinstance(statement, ast.Assign | ast.AnnAssign)
            for target in (statement.targets if isinstance(statement, ast.Assign) else [statement.target])
            if isinstance(target, ast.Name)
        ]
        package = ".".join(file.parent.relative_to(root).parts)
        if "__all__" in names and not f"{package}.".startswith(tuple(f"{name}." for name in LEFT_OUT)):
            found.append(package)
    return found


def exported_above(package: str) -> set[str]:
    """Return the public names that a package around this one exports as well: they are documented there alone."""
    names = set(importlib.import_module(package).__all__)
    around = package.split(".")[:-1]
    above = (importlib.import_module(".".join(around[:size])) for size in range(1, len(around) + 1))
    return names & {name for each in above for name in getattr(each, "__all__", ())}


class PublicApi(SphinxDirective):
    """Directive that takes the name of a top-level package and documents every public package in it."""

    required_arguments = 1
    has_content = False

    def run(self) -> list[nodes.Node]:
        root = Path(self.env.app.confdir).parent
        lines = []
        for name in public_packages(root, self.arguments[0]):
            try:
                package = importlib.import_module(name)
            except ImportError as error:  # an extra that is not installed, as torch
                log.info("%s is left out of the API pages: %s", name, error)
                continue
            known = exported_above(name)
            if known and known == set(package.__all__):
                continue
            if name != self.arguments[0]:  # whose heading is the page's
                lines += [name, "-" * len(name), ""]
            lines += [f".. automodule:: {name}", "   :members:", "   :imported-members:"]
            lines += [f"   :exclude-members: {', '.join(sorted(known))}", ""] if known else [""]
        if not lines:
            lines = [f"No package of ``{self.arguments[0]}`` declares ``__all__`` yet."]
        section = nodes.section()
        section.document = self.state.document
        self.state.nested_parse(StringList(lines, source="public-api"), self.content_offset, section, match_titles=1)
        return section.children


def load_public_names(app: Sphinx) -> None:
    """Load every public name of every package before one of them is documented.

    autodoc writes the annotations that it finds in sources into the classes, pydantic's `BaseModel` among them. Models
    that are defined after that fail.
    """
    root = Path(app.confdir).parent
    for top in sorted(file.parent.name for file in root.glob("*/__init__.py")):
        for name in public_packages(root, top):
            try:
                package = importlib.import_module(name)
                for public in package.__all__:
                    getattr(package, public)
            except ImportError as error:  # an extra that is not installed, as torch
                log.info("%s is not loaded: %s", name, error)


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_directive("public-api", PublicApi)
    app.connect("builder-inited", load_public_names)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
