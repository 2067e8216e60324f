"""Ranges of a vendor's register table: a raw range with its engineering range, and the range of plausible values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

from drivers.importers.draft import Collector, DraftPoint, ImportFileError
from drivers.importers.vendor_table.cells import number_of
from drivers.importers.vendor_table.columns import ambiguous_thousand
from drivers.importers.vendor_table.range_cells import ends_in, pair_in
from drivers.signals import RegisterType, canonical_unit, plausible_range, raw_bounds

_DIGITS = 12
"""Significant digits of a scale that is computed: no table gives its ranges more exactly."""
_EMPTY = ("", "-")


@dataclass(frozen=True, slots=True)
class RangeScale:
    """Scale and offset by which the ends of a raw range are those of the engineering range."""

    raw: tuple[float, float]
    engineering: tuple[float, float]
    scale: float
    offset: float

    def agrees(self, scale: float, offset: float) -> bool:
        """Return True where another scale and offset meet both ends within one count."""
        ends = zip(self.raw, self.engineering, strict=True)
        return all(abs(raw * scale + offset - value) <= abs(scale) for raw, value in ends)


def ends_of(
    path: Path, line: int, cells: Mapping[str, str], side: str, decimal_comma: set[str]
) -> tuple[float, float] | None:
    """Return the two ends of a range by the columns of a `side`: `raw_`, `eng_` or none; None where they are empty.

    Raises ImportFileError where one end is missing or is no number.
    """
    named = {"raw_": "raw ", "eng_": "engineering "}.get(side, "")
    texts = {key: cells.get(f"{side}{key}", "") for key in ("min", "max")}
    texts = {key: "" if text in _EMPTY else text for key, text in texts.items()}
    text = cells.get(f"{side}range", "")
    if text not in _EMPTY and not any(texts.values()):
        found = ends_in(text)
        if found is None:
            raise ImportFileError(path, line, f"{named}range {text!r} is not understood; write it as 0..1000")
        texts = {"min": found[0], "max": found[1]}
    if not any(texts.values()):
        return None
    for key, end in texts.items():
        if not end:
            raise ImportFileError(path, line, f"its {named}range has no {key}; give both ends, or none")
        if ambiguous_thousand(end, decimal_comma=f"{side}{key}" in decimal_comma):
            said = f"{named}{key} {end!r} may be a thousand or a fraction beside decimal commas; write 1 or 1000"
            raise ImportFileError(path, line, said)
    low, high = (number_of(path, line, f"{named}{key}", end) for key, end in texts.items())
    return low, high


def scale_of_range(
    path: Path, line: int, cells: Mapping[str, str], kind: str, decimal_comma: set[str], *, has_factor: bool
) -> RangeScale | None:
    """Return the scale of a raw range and its engineering range; None where the line has no raw range.

    The columns min, max and range are the engineering range where the line has no other. `has_factor` is True where the
    line has another scale, with which one of the two ranges may be missing. Raises ImportFileError.
    """
    if not any(key.startswith("raw_") for key in cells) and (pair := pair_in(cells.get("range", ""))) is not None:
        (raw_min, raw_max), (low, high) = pair
        cells = {**cells, "raw_min": raw_min, "raw_max": raw_max, "eng_min": low, "eng_max": high}
    raw = ends_of(path, line, cells, "raw_", decimal_comma)
    value = ends_of(path, line, cells, "eng_", decimal_comma)
    if raw is None:
        if value is None or has_factor or kind.startswith("float"):
            return None
        said = "has an engineering range and no raw range; add raw min and raw max, or a scale (1/1 for one a count)"
        raise ImportFileError(path, line, said)
    value = value or ends_of(path, line, cells, "", decimal_comma)
    if value is None:
        if has_factor:
            return None
        raise ImportFileError(
            path, line, "has a raw range and no engineering range; add eng min and eng max, or a scale"
        )
    if raw[0] == raw[1] or value[0] == value[1]:
        raise ImportFileError(path, line, "both ends of its raw or engineering range are the same; correct one")
    lowest, highest = raw_bounds(kind)
    beyond = next((end for end in raw if not lowest <= end <= highest), None)
    if beyond is not None:
        said = f"raw {beyond:g} is beyond {kind} ({lowest:g} to {highest:g}); correct the type or the raw range"
        raise ImportFileError(path, line, said)
    scale = (value[1] - value[0]) / (raw[1] - raw[0])
    offset = value[0] - scale * raw[0]
    if abs(offset) < abs(scale) * 10.0**-_DIGITS * max(map(abs, raw)):
        offset = 0.0
    return RangeScale(raw, value, float(f"{scale:.{_DIGITS}g}"), float(f"{offset:.{_DIGITS}g}"))


def require_values(path: Path, line: int, cells: Mapping[str, str], kind: str, scale: float, offset: float) -> None:
    """Raise ImportFileError where the only range of a line can be no values in its unit: it is then a raw range.

    `scale` and `offset` are those of the line. The whole range of its type says nothing, and neither does a range that
    is one of values once it is scaled.
    """
    found = ends_in(cells.get("range", ""))
    if found is None or "int" not in kind or any(key.startswith("raw_") for key in cells):
        return
    ends = [number_of(path, line, "range", end) for end in found]
    low, high = plausible_range(_symbol(cells.get("unit", "")))
    scaled = [end * scale + offset for end in ends]
    if tuple(ends) == raw_bounds(kind) or any(all(low <= x <= high for x in one) for one in (ends, scaled)):
        return
    raise ImportFileError(
        path,
        line,
        f"range {cells['range']!r} is beyond {low:g} to {high:g} {cells['unit']}, and may be a raw range; add eng min "
        "and eng max and call it raw range, or correct its scale",
    )


def raw_ends(ends: Sequence[float], scale: float, offset: float, unit: str, kind: RegisterType) -> str:
    """Return the meaning of a range's ends: `raw` counts, in `unit` (degC, ...), `either`, `neither` or the `same`.

    They are the same where the type has no scale. They are raw where no reading in the unit is as large (`PLAUSIBLE`)
    or no register of type `kind` holds it, and are so once they are scaled. They are in the unit where they are no
    whole numbers.
    """
    if (scale in (0.0, 1.0) and offset == 0.0) or kind.startswith("float"):
        return "same"
    if any(end != int(end) for end in ends):
        return "unit"
    low, high = plausible_range(_symbol(unit))
    lowest, highest = raw_bounds(kind)
    as_unit = all(low <= end <= high and lowest <= (end - offset) / scale <= highest for end in ends)
    as_raw = all(low <= end * scale + offset <= high and lowest <= end <= highest for end in ends)
    if as_raw:
        return "either" if as_unit else "raw"
    return "unit" if as_unit else "neither"


def _symbol(unit: str) -> str:
    try:
        return canonical_unit(unit.strip())
    except ValueError:
        return "1"


@dataclass(slots=True)
class PlausibleRanges:
    """Plausible ranges of a table's points, each with its possible meanings until the whole table is known."""

    path: Path
    collector: Collector
    decimal_comma: set[str] = field(default_factory=set)
    _ranges: list[tuple[DraftPoint, str, tuple[str, str]]] = field(default_factory=list)

    def ends(self, line: int, cells: dict[str, str], kind: str, ranged: RangeScale | None) -> list[float] | None:
        """Return the ends of a line's range as its columns have them, None where it has none.

        The engineering range of a raw range is a calibration: values just beyond it are good, and it is not taken.
        """
        if kind in ("bool", "string") or (ranged is not None and "eng_min" not in cells and "eng_range" not in cells):
            return None
        if any(cells.get(key, "") in _EMPTY for key in ("min", "max")):
            value = None if ranged is not None else ends_of(self.path, line, cells, "eng_", self.decimal_comma)
            return list(value) if value is not None else None
        try:
            found = ends_of(self.path, line, {k: cells[k] for k in ("min", "max")}, "", self.decimal_comma)
        except ImportFileError as error:
            self.collector.note(line, f"{cells['name']}: {error.what}; no plausible range was taken")
            return None
        return list(found) if found is not None else None

    def add(self, point: DraftPoint, cells: dict[str, str]) -> None:
        """Keep the possible meanings of a point's range until the whole table is known."""
        ends, keys = point.keys.get("plausible"), point.keys
        if ends is None or any(cells.get(key, "") in _EMPTY for key in ("min", "max")):
            return
        scale, offset = keys.get("scale", 1.0), keys.get("offset", 0.0)
        meant = raw_ends(ends, scale, offset, cells.get("unit", ""), cast(RegisterType, keys.get("type", "int16")))
        self._ranges.append((point, meant, (cells["min"], cells["max"])))

    def settle(self) -> None:
        """Settle the ranges that may be raw counts: a table writes all of them in one way, which some lines show.

        If no line shows it, a point that is only read gets the range that holds both meanings. A point that can be
        written gets a range only if its own line shows that the range is in its unit.
        """
        shown = {meant for _, meant, _ in self._ranges} & {"raw", "unit"}
        for point, meant, texts in self._ranges:
            written = point.keys.get("access") in ("w", "rw")
            if meant in ("unit", "same") or (meant == "either" and shown == {"unit"} and not written):
                continue
            low, high = point.keys.pop("plausible")
            said = "no range was taken, give it in the point's unit"
            if meant == "neither":
                what = "fit neither as values nor as raw counts"
            elif meant == "raw" or shown == {"raw"}:
                what = "are raw counts"
            elif written:
                what = "may be raw counts or values, and the point can be written"
            else:
                what = "may be raw counts or values"
                scale, offset = point.keys.get("scale", 1.0), point.keys.get("offset", 0.0)
                ends = (low, high, low * scale + offset, high * scale + offset)
                point.keys["plausible"] = [min(ends), max(ends)]
                said = "the range that holds both was taken, give the right one in the point's unit"
            self.collector.note(point.line, f"{point.name}: min {texts[0]} and max {texts[1]} {what}; {said}")
