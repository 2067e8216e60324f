"""Room for legends and titles in the panels of a tab.

A legend covers the lower left corner of its plot, so the run begins to the right of it. A title that is wider than its
panel would be cut at its end, where the unit stands, so the name at its beginning is shortened.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace

from hil.review.plan.styles import Panel, Stack

WINDOW_PX = 1400.0
"""Width of the window in pixels for these margins; in a wider window a legend takes a smaller part."""
_AXIS_PX = 40.0
_FRAME_PX = 50.0
"""Width of a legend without its longest label: dot, padding and border, measured in screenshots of the viewer (0.41).
"""
_LETTER_PX = 6.8
"""Mean width of a letter in a legend, px."""
_TITLE_FRAME_PX = 100.0
"""Width of a panel's title bar without the title: icon and buttons."""
_TITLE_LETTER_PX = 6.1
"""Mean width of a letter in a title, px, measured as above."""
_LEAST_NAME = 8
"""Letters of a name that are always shown."""
_MOST = 1.2
"""Largest part of a plot for a margin: a larger legend would leave no room for the run."""


def with_room_for_legends(tab: Stack, labels: Mapping[str, tuple[str, ...]]) -> Stack:
    """Return `tab` with margins before the run for its legends, and with titles that its panels have room for.

    Parameters
    ----------
    tab
        A tab of a review.
    labels
        Of each entity's curves; an entity that is not there goes by its own name.
    """
    return _stack(tab, labels, WINDOW_PX)


def _stack(stack: Stack, labels: Mapping[str, tuple[str, ...]], width_px: float) -> Stack:
    shares = [part.share for part in stack.parts]
    if stack.arrange == "columns":
        widths = [width_px * share / sum(shares) for share in shares]
    else:
        beside = math.ceil(math.sqrt(len(stack.parts))) if stack.arrange == "grid" else 1
        widths = [width_px / max(beside, 1)] * len(stack.parts)
    # Stacked plots keep a common axis.
    needs = [
        _needed(part, labels, width) if isinstance(part, Panel) else 0.0
        for part, width in zip(stack.parts, widths, strict=True)
    ]
    common = max(needs, default=0.0) if stack.arrange == "rows" else None
    parts: list[Panel | Stack] = []
    for part, need, width in zip(stack.parts, needs, widths, strict=True):
        if isinstance(part, Stack):
            parts.append(_stack(part, labels, width))
        else:
            title = fitted_title(part.title, width)
            parts.append(replace(part, title=title, margin=need if common is None else common))
    return replace(stack, parts=tuple(parts), margin=0.0)


def fitted_title(title: str, width_px: float) -> str:
    """Return a title that fits in a panel of `width_px` pixels: the name before `:`, ` (` or ` [` loses its middle."""
    most = int((width_px - _TITLE_FRAME_PX) / _TITLE_LETTER_PX)
    if len(title) <= most:
        return title
    name = re.split(r":| \(| \[", title, maxsplit=1)[0]
    rest = title[len(name) :]
    room = max(most - len(rest), _LEAST_NAME)
    if len(name) <= room:
        return title
    head = room // 2
    return f"{name[:head]}…{name[len(name) - (room - 1 - head) :]}{rest}"


def _needed(panel: Panel, labels: Mapping[str, tuple[str, ...]], width_px: float) -> float:
    """Return the part of the time axis that the panel's legend covers."""
    if panel.kind != "lines" or not panel.legend:
        return 0.0
    longest = max((len(label) for content in panel.contents for label in _labels(content, labels)), default=0)
    legend_px = _FRAME_PX + _LETTER_PX * longest
    left_px = width_px - _AXIS_PX - legend_px
    need = legend_px / left_px if left_px > 0.0 else _MOST
    return min(need, _MOST)


def _labels(content: str, labels: Mapping[str, tuple[str, ...]]) -> list[str]:
    """Return the labels of all entities that match a query expression."""
    root = content.removesuffix("/**")
    found = [
        name for entity, names in labels.items() if entity == root or entity.startswith(root + "/") for name in names
    ]
    return found or [re.sub(r"\\(.)", r"\1", root.rpartition("/")[2])]
