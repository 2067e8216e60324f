"""Keys that a person adds to an import: roles, limits, read-backs and the heartbeat, as POINT.KEY=VALUE."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Sequence
from typing import Any

from drivers.importers.described import DescriptionError
from drivers.importers.draft import Draft, DraftPoint, toml_text

_SETTING = re.compile(r"(?P<place>[A-Za-z]\w*)\.(?P<key>[a-z_]+)=(?P<value>.+)", re.ASCII)


def apply_settings(draft: Draft, settings: Sequence[str]) -> None:
    """Set keys of a draft's points, of its rig and of its heartbeat.

    Parameters
    ----------
    draft
        Import, which is changed.
    settings
        `POINT.KEY=VALUE`, `heartbeat.KEY=POINT` or `rig.KEY=VALUE`, with values as in TOML; a word needs no quotation
        marks. POINT is a name of the draft. A new `name` counts from the end of the list on.

    Raises
    ------
    DescriptionError
        A setting is not of that form, or names a point that the draft has not.
    """
    points = {point.name: point for bus in draft.buses for point in bus.points}
    beat: dict[str, Any] = {}
    names: list[tuple[DraftPoint, str]] = []
    for text in settings:
        found = _SETTING.fullmatch(text)
        if found is None:
            raise DescriptionError(f"{text!r} is no POINT.KEY=VALUE; write it like pump_set.limits=[0,100]")
        place, key, value = found["place"], found["key"], _value(found["value"])
        if place == "heartbeat":
            beat[key] = value
        elif place == "rig":
            draft.rig[key] = (value, "")
        elif place not in points:
            near = difflib.get_close_matches(place, points, n=1)
            meant = f"; did you mean {near[0]}?" if near else f"; there are {', '.join(points)}"
            raise DescriptionError(f"{text!r}: there is no point {place}{meant}")
        elif key == "name":
            names.append((points[place], str(value)))
        else:
            points[place].keys[key] = value
            points[place].remarks.pop(key, None)
    for point, name in names:
        point.name = name
    if beat:
        lines = [f"{key} = {toml_text(value)}" for key, value in beat.items()]
        draft.sections.append("\n".join(["[heartbeat]              # mutual supervision of rig and harness", *lines]))


def _value(text: str) -> Any:
    """Return a value of TOML; any other text as it is."""
    try:
        return tomllib.loads(f"value = {text}")["value"] if "\n" not in text else text
    except tomllib.TOMLDecodeError:
        return text
