"""Names that a twin file may give to elements, inputs, columns and sets: plain identifiers in ASCII letters.

Other scripts are left out on purpose. Two of their letters can look alike and differ, and a record from another program
may write the same name in another normal form. Words of Python and names in double underscores are left out. A name may
become an identifier of generated code in a later version of any tool that reads the file.
"""

from __future__ import annotations

import keyword
import re

LONGEST_SHOWN = 40
"""Characters of a refused name that a message repeats: the start is enough to find it."""
_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


def name_problem(name: str) -> str:
    """Return why a name cannot be used and what to write instead, or "" for a valid name."""
    if _IDENTIFIER.fullmatch(name):
        if keyword.iskeyword(name):
            return f"{name!r} is a word of Python, which no name may be; rename it, for example to {name}_1"
        if name.startswith("__"):
            return f"{name!r} begins with two underscores, which no name may; rename it"
        return ""
    shown = name if len(name) <= LONGEST_SHOWN else f"{name[:LONGEST_SHOWN]}..."
    return (
        f"{shown!r} cannot be a name: a name is letters A to Z without accents, digits and underscores, and does not "
        f"start with a digit; rename it (a column in the record too), for example to {_proposal(name)}"
    )


def _proposal(name: str) -> str:
    words = re.findall(r"[A-Za-z0-9]+", name)
    text = "_".join(words)[:LONGEST_SHOWN].strip("_")
    return text if _IDENTIFIER.fullmatch(text) and not keyword.iskeyword(text) else f"x_{text}".rstrip("_")
