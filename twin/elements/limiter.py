"""Limit of an actuator: it delivers less than its command, or no more, above a level.

    delivered = output - max(share output - offset, 0)

Above offset / share, `share` of the rest is missing: all of it with share 1, where `offset` is the most that the
actuator delivers. There is no limit with share and offset 0. The column needs an element of kind `actuator`.

Source: saturation of an actuator (Astrom & Hagglund, Advanced PID Control, 2006, sec. 3.5): a supply at its current
limit, a fan or pump at the top of its converter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from twin.elements.base import STAMP, Element, Names, ParameterSpec, place
from twin.elements.candidates import Candidate, Sites, input_target
from twin.elements.fragments import Fragment

APART = (0.12, 0.06, 0.03, 0.015, 0.0075, 0.004, 0.002)
"""Distances of levels that are tried about one that scores, as shares of it: down to less than a law's form error."""


@dataclass(frozen=True)
class Limiter(Element):
    """A level of a command above which some of it, or all, is not delivered."""

    kind: ClassVar[str] = "limiter"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("share", "1", 0.0, 0.0, 1.0, "fixed", "share that is missing of what is above the level"),
    )

    column: str = place("input", "input column with the command; it needs an element of kind actuator")

    def parameter_specs(self) -> tuple[ParameterSpec, ...]:
        suffix = self.column.rsplit("_", 1)[-1]
        unit = {"pct": "%", "C": "degC"}.get(suffix, suffix)
        return (*self.parameters, ParameterSpec("offset", unit, 0.0, 0.0, 1.0e6, "fixed", "the level times the share"))

    @classmethod
    def missing_candidates(cls, sites: Sites) -> tuple[Candidate, ...]:
        having = {e.column for e in sites.having(cls.kind)}
        driven = {e.column for e in sites.having("actuator")}
        found: list[Candidate] = []
        for column in sites.inputs:
            name, full = f"limit_of_{column}", sites.scales.get(column, 0.0)
            if column in having or column in (sites.clock, STAMP) or column.endswith("_C") or not full > 0.0:
                continue
            adds = {name: {"kind": cls.kind, "column": column}}
            if column not in driven:
                adds[f"actuator_of_{column}"] = {"kind": "actuator", "column": column}
            found.append(_limit(column, name, adds, 0.5 * full))
        return tuple(found)

    def changed_candidates(self, sites: Sites) -> tuple[Candidate, ...]:
        share, offset = (sites.values[f"{self.name}.{key}"] for key in ("share", "offset"))
        if not share > 0.0:
            return ()
        limit = _limit(self.column, self.name, {}, offset / share)
        says = limit.says.replace("{share}", "{share} more") + " than when commissioned"
        changed = replace(limit, change="existing", says=says, near=None, at_level=None)
        return (replace(changed, lower=-share, upper=1.0 - share),)

    def changes(self) -> str:
        return input_target(self.column)

    def change(self, n: Names) -> str:
        if n.constant("share") == 0.0:
            return ""
        return f"{{output}} - max({n.par('share')} * {{output}} - {n.par('offset')}, 0.0)"

    def emit(self, n: Names) -> Fragment:
        return Fragment()


def _limit(column: str, name: str, adds: dict[str, dict[str, str]], level: float) -> Candidate:
    """Return the limit of a command at a level; the one of the catalogue stands for all levels."""
    what, unit = column.rsplit("_", 1)
    shown = f"{level:.0f}" if level >= 100.0 else f"{level:.3g}"
    return Candidate(
        "actuator",
        what,
        what,
        "new",
        {f"{name}.share": 1.0, f"{name}.offset": level},
        "1",
        0.2,
        0.0,
        1.0,
        f"misses {{share}} of its command above {shown} {'%' if unit == 'pct' else unit}",
        adds=adds,
        shapes=("step",),
        near=lambda: tuple(_limit(column, name, adds, level * (1.0 + side * d)) for d in APART for side in (-1.0, 1.0)),
        at_level=lambda other: _limit(column, name, adds, other),
        level=level,
    )
