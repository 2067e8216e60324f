"""Text exports of LabVIEW and SignalExpress that are no measurement files, brought into the form of a plain table.

A graph writes `Time - Tank` and `Amplitude - Tank` for each plot. "Export Waveforms to Spreadsheet File" writes the
lines `waveform`, `t0` and `delta t` with a cell for each channel, and below them rows with or without times.
SignalExpress calls them `Channel name`, `Start time` and `Time increment`, and has a line of units.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence

from hil.record.times import is_time_name
from hil.record.units import meaning_of

_OF_PLOT = re.compile(r"(.+?) - (.+)")
_AMPLITUDE = "amplitude"
"""Label of an axis that nobody has named."""
_UNNAMED = re.compile(r"plot ?\d+", re.IGNORECASE)
_BRACKETED = re.compile(r"\(([^()]+)\)|\[([^\[\]]+)\]")
_TIMES, _VALUES = re.compile(r"time(\[\d+\])?", re.IGNORECASE), re.compile(r"Y(\[\d+\])?", re.IGNORECASE)
_UNNAMED_WAVE = re.compile(r"\[\d+\]")
_TAGS = (_WAVEFORM, _BEGIN, _STEP) = ("waveform", "t0", "delta t")
"""First cells of the lines above exported waveforms."""
_ALSO = {"channel name": _WAVEFORM, "start time": _BEGIN, "time increment": _STEP}
_UNITS = ("unit", "units")


def plain_heading(row: Sequence[str]) -> list[str]:
    """Return the cells of the heading of an exported graph as names of columns, and any other line unchanged.

    A label of the axis that is a unit, or holds one, goes into the name of the channel.
    """
    cells = [_OF_PLOT.fullmatch(cell) for cell in row if cell]
    if len(cells) < 2 or any(cell is None for cell in cells):
        return list(row)
    if not any(cell is not None and is_time_name(cell[1]) for cell in cells):
        return list(row)
    return [_name(found[1], found[2]) if (found := _OF_PLOT.fullmatch(cell)) else cell for cell in row]


def _name(label: str, plot: str) -> str:
    """Return the name of a column from the label of its axis and the name of its plot."""
    if is_time_name(label):
        return label
    if label.lower() == _AMPLITUDE:
        return plot
    if _UNNAMED.fullmatch(plot):
        return f"{plot} ({label})" if meaning_of(label) is not None else label
    bracketed = _BRACKETED.search(label)
    unit = (bracketed[1] or bracketed[2]) if bracketed else label
    return f"{plot} ({unit})" if meaning_of(unit) is not None else f"{label} - {plot}"


def is_waveforms(text: str) -> bool:
    """Return True for the beginning of waveforms that LabVIEW exported to a spreadsheet file."""
    lines = text.lstrip("\ufeff\r\n\t ").split("\n", len(_TAGS))[: len(_TAGS)]
    return tuple(_cells(lines)) == _TAGS


def _cells(lines: Sequence[str]) -> dict[str, list[str]]:
    """Return the cells of lines by the first cell of each, lower case and by LabVIEW's name."""
    rows = [[cell.strip() for cell in line.split("\t")] for line in lines]
    tags = [row[0].lower().removesuffix(":") for row in rows]
    return {_ALSO.get(tag, tag): row[1:] for tag, row in zip(tags, rows, strict=True)}


def without_waveform_lines(text: str) -> tuple[str, tuple[str, ...]]:
    """Return exported waveforms as a table with their channels' names, line by line, and messages; else `text`.

    Rows without times get those of the step that the export states.

    Raises
    ------
    ValueError
        The channels have different steps or beginnings, and no times stand in the rows; without the file's name.
    """
    if not is_waveforms(text):
        return text, ()
    lines = text.split("\n")
    top = next(number for number, line in enumerate(lines) if line.strip())
    about = _cells(lines[top : top + len(_TAGS)])
    written = dict(zip(about, (line.split("\t")[0].strip() for line in lines[top:]), strict=False))
    names = [f"Y{name}" if _UNNAMED_WAVE.fullmatch(name) else name for name in about[_WAVEFORM] if name]
    below = top + len(_TAGS)
    for tag, units in _cells(lines[below : below + 1]).items():
        if tag in _UNITS:
            names = [
                f"{name} ({unit})" if meaning_of(unit) is not None else name
                for name, unit in itertools.zip_longest(names, units[: len(names)], fillvalue="")
            ]
            below += 1
    first = next((n for n in range(below, len(lines)) if lines[n].strip()), len(lines))
    preamble = ["#"] * first
    if first == len(lines):
        return text, ()
    heading = [cell.strip() for cell in lines[first].split("\t")]
    if any(_TIMES.fullmatch(cell) for cell in heading):
        channels = iter(names)
        named = [
            "time" if _TIMES.fullmatch(cell) else next(channels, cell) if _VALUES.fullmatch(cell) else cell
            for cell in heading
        ]
        return "\n".join([*preamble, "\t".join(named), *lines[first + 1 :]]), ()
    if all(_VALUES.fullmatch(cell) for cell in heading if cell):
        first, preamble = first + 1, ["#"] * (first + 1)
    for tag in (_BEGIN, _STEP):
        if len(set(filter(None, about[tag]))) > 1:
            raise ValueError(
                f" line {top + 1 + _TAGS.index(tag)} gives channels of different '{written[tag]}', and the rows have "
                "no times; export the waveforms with a column of times, or each to a file of its own"
            )
    try:
        step = float(about[_STEP][0].replace(",", "."))
    except (IndexError, ValueError):
        raise ValueError(
            f" line {top + len(_TAGS)} gives no number for '{written[_STEP]}', and the rows have no times; "
            "export the waveforms with a column of times"
        ) from None
    preamble[-1] = "\t".join(["time_s", *names])
    rows = [f"{step * row:.9g}\t{line}" if line.strip() else line for row, line in enumerate(lines[first:])]
    begin = next(iter(about[_BEGIN]), "")
    said = f"the rows have no times: counted by the step of {step:g} s from '{begin}', which is taken for 0 s"
    return "\n".join([*preamble, *rows]), (said,)
