"""Configuration of the documentation site. Build it with `make docs`."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE / "_ext")]

from pygments.lexers.special import TextLexer  # noqa: E402
from sphinx.application import Sphinx  # noqa: E402

import hil  # noqa: E402  (the checkout, not an installed copy)

project = "hil"
author = "the hil developers"
project_copyright = "the hil developers"
version = release = hil.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.intersphinx",
    "sphinx_copybutton",
    "mathml",
    "public_api",
    "command_pages",
]
intersphinx_mapping = {}  # the build needs no network
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build", "_ext"]

myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence", "deflist", "fieldlist"]
myst_heading_anchors = 3
myst_links_external_new_tab = False
math_numfig = False
html_math_renderer = "mathml"

autodoc_typehints = "description"
autodoc_member_order = "bysource"
autodoc_typehints_description_target = "documented"
nitpicky = False
suppress_warnings = ["autodoc.mocked_object"]

html_theme = "furo"
html_title = f"hil {version}"
html_static_path = ["_static"]
html_css_files = ["hil.css"]
html_show_copyright = False
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {"navigation_with_keys": True}
pygments_style = "friendly"
copybutton_prompt_text = "$ "


def setup(app: Sphinx) -> None:
    """Show CSV examples as plain text: Pygments has no lexer for them."""
    app.add_lexer("csv", TextLexer)
