"""Source text of a kernel while it is generated: rows of its work array, loops over lanes and compiled functions."""

from __future__ import annotations

import re
from collections.abc import Mapping

NAME = re.compile(r"(?<![\w.])[A-Za-z_]\w*")  # not the e of 1.0e-5
OUTLINE_LINES = 60
"""Lines of a loop from which it becomes a function of its own."""
_WORDS = {"for", "in", "range", "int", "max", "min", "exp", "log", "abs", "if", "else", "or"}


class KernelText:
    """Lines of one kernel for blocks of `lanes` particles.

    Parameters
    ----------
    lanes
        Number of particles in a block.

    Attributes
    ----------
    rows
        Name of a quantity that differs between lanes -> its row in the work array ``W``.
    functions
        Source lines of the compiled functions that stand beside the kernel.

    """

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        self.rows: dict[str, int] = {}
        self.functions: list[str] = []
        self._loops = 0

    def row(self, name: str) -> int:
        """Return the row of a quantity that differs between lanes; a new name gets the next row."""
        return self.rows.setdefault(name, len(self.rows))

    def at(self, name: str) -> str:
        """Return the expression of a row's entry for lane ``l``."""
        return f"W[{self.row(name) * self.lanes} + l]"

    def loop(self, body: list[str], own: bool = True) -> list[str]:
        """Return a loop over lanes that first loads the rows which its body reads into scalars.

        Parameters
        ----------
        body
            Assignments of one lane.
        own
            Give the assigned names a suffix that no other loop has. Compile time grows with the number of names that
            are assigned in more than one place.

        """
        if not body:
            return []
        known: set[str] = set()
        loads: list[str] = []
        for line in body:
            target, _, value = line.partition(" = ")
            for name in NAME.findall(value if value else line):
                if name in self.rows and name not in known:
                    known.add(name)
                    loads.append(f"{name} = {self.at(name)}")
            if value:
                known.add(target.strip())
        lines = [*loads, *body]
        if own:
            self._loops += 1
            names = {name: f"{name}_{self._loops}l" for name in known if name.isidentifier()}
            lines = [renamed(line, names) for line in lines]
        return [f"for l in range({self.lanes}):", *indent(lines)]

    def outlined(self, name: str, body: list[str], always: bool = False) -> list[str]:
        """Return a loop over lanes, as a call of a function of its own if it is long.

        Compilers take more than twice as long for twice the text.
        """
        lines = self.loop(body, own=False)
        if len(lines) < OUTLINE_LINES and not always:
            return self.loop(body)
        return self.called(name, ["W"], ["f8[::1]"], lines)

    def called(self, name: str, arrays: list[str], types: list[str], lines: list[str]) -> list[str]:
        """Define a compiled function of arrays and of the scalars that its lines read; return the call."""
        assigned = {"l", "i", "n", "np", *arrays, *(line.strip().partition(" = ")[0] for line in lines)}
        scalars = sorted({n for line in lines for n in NAME.findall(line)} - assigned - _WORDS)
        arguments = ", ".join([*arrays, *scalars])
        self._define(name, ", ".join([*types, *("f8" for _ in scalars)]), arguments, lines)
        return [f"{name}({arguments})"]

    def _define(self, name: str, types: str, arguments: str, lines: list[str]) -> None:
        self.functions += [
            f"@typed('void({types})')",
            f"def {name}({arguments}):",
            *indent(lines),
            "",
            "",
        ]


def indent(lines: list[str]) -> list[str]:
    """Return the lines one level deeper."""
    return ["    " + line for line in lines]


def renamed(text: str, names: Mapping[str, str]) -> str:
    """Return an expression with whole names replaced."""
    return NAME.sub(lambda m: names.get(m.group(), m.group()), text)
