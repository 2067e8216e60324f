"""Ratings of values: columns of a record whose words or codes state which values are good.

One reading of them serves records with a column for each signal and records with one reading in each row. The name of
such a column gives the sense of its marks: True is good under `valid`, and bad under `fault`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from drivers.signals import Quality, split_column
from hil.record.units import name_and_unit
from hil.record.values import MARKS

OPC_GOOD, OPC_UNCERTAIN = 192, 64
"""Least code of a good and of an uncertain value (OPC Data Access 3.0, 6.8); smaller ones are bad."""
_OPC = {*range(0, 32, 4), 64, 80, 84, 88, 192, 216}
"""Codes of OPC without the two bits of a limit."""
_UA_UNCERTAIN, _UA_BAD = 0x40000000, 0x80000000
"""Least code of an uncertain and of a bad value (OPC UA part 4, 7.39)."""

Verdict = Literal["good", "uncertain", "bad"]

_GOOD = """good ok okay valid normal gut gültig gueltig bon bonne valide correct bueno válido valido buono measured
i.o. io"""
_UNCERTAIN = """uncertain questionable suspect doubtful estimated interpolated substituted unsicher fraglich zweifelhaft
geschätzt ersatzwert incertain douteux incierto dudoso incerto"""
_BAD = """bad invalid fault faulty faulted error failure defect defective broken stale disconnected schlecht ungültig
ungueltig fehler fehlerhaft gestört gestoert störung stoerung defekt drahtbruch ausfall mauvais mauvaise invalide erreur
défaut defaut panne malo inválido invalido fallo averiado errore guasto cattivo"""
_RATING = """quality qualitycode status statuscode statut estado stato state zustand qualität qualitaet qualité qualite
calidad qualità qualita güte guete qc qflag flag"""
_GOOD_NAMES = "ok good gut valid validity isvalid isgood gültig gültigkeit gueltig gueltigkeit valide válido"
_BAD_NAMES = "invalid isbad bad fault faulty fehler error questionable suspect substituted ungültig ungueltig stale"

_GOOD_WORDS, _UNCERTAIN_WORDS, _BAD_WORDS = (frozenset(words.split()) for words in (_GOOD, _UNCERTAIN, _BAD))
_TRUE = frozenset(("true", "wahr", "vrai", "verdadero", "vero", "yes", "ja", "oui"))
_FALSE = frozenset(("false", "falsch", "faux", "falso", "no", "nein", "non"))

_RATES, _GOOD_IF, _BAD_IF = (frozenset(words.split()) for words in (_RATING, _GOOD_NAMES, _BAD_NAMES))
"""Words of a name: under the first, words and codes rate values and True is good; the others give True its sense."""
_DOUBTED_IF = frozenset(("questionable", "suspect", "substituted"))
"""Names whose True makes a value uncertain, not bad (flags of the PI system)."""
_REMARKS = frozenset(("annotated",))
"""Names of flags of a reading that say nothing about its value."""
_ALONE = (_RATES - {"state", "estado", "stato", "zustand"}) | {"valid", "validity", "isvalid", "isgood"}
_ALONE |= {"questionable", "substituted", "gültigkeit"}
"""Names without that of a signal which rate all values of a row, or those of the column before.

A `state` alone is that of a machine, or a value.
"""
_PHRASES: dict[str, Verdict] = {
    "no error": "good",
    "no fault": "good",
    "kein fehler": "good",
    "fehlerfrei": "good",
    "no data": "bad",
    "no value": "bad",
    "unavailable": "bad",
    "not good": "bad",
    "not ok": "bad",
    "nicht ok": "bad",
    "nok": "bad",
    "n.i.o.": "bad",
}


@dataclass(frozen=True, eq=False)
class Rating:
    """Ratings of the rows of a record.

    Attributes
    ----------
    bad, uncertain
        Rows (n,) whose value is bad or uncertain.
    kind
        Name of the codes, for messages.
    reasons
        `Quality` of each row (n,).
    unknown
        Row and text of the first mark that is not understood, or None.
    unknown_count
        Rows with such a mark.
    """

    bad: NDArray[np.bool_]
    uncertain: NDArray[np.bool_]
    kind: str
    reasons: NDArray[np.uint8]
    unknown: tuple[int, str] | None = None
    unknown_count: int = 0


def is_rating_name(name: str) -> bool:
    """Return True for a name that alone says that the column rates values."""
    return _bare(name) in _ALONE


def is_remark_name(name: str) -> bool:
    """Return True for the name of a flag that says nothing about the value."""
    return _bare(name) in _REMARKS


def may_rate(name: str) -> bool:
    """Return True for a name with a word of rating at its beginning or its end."""
    words = _words(_bare(name))
    return bool(words) and bool({words[0], words[-1]} & (_RATES | _GOOD_IF | _BAD_IF))


def rated_by(name: str, values: Sequence[str], names: Sequence[str]) -> list[str]:
    """Return the columns of `values` that the column `name` may rate; `names` are all columns in the file's order.

    These are the column of its own name, with or without its unit. A column called `status` alone rates the column
    before it where there are several such columns, else all of them.
    """
    there = [other for other in values if other != name]
    if is_rating_name(name):
        alike = [other for other in names if is_rating_name(other) and _bare(other) == _bare(name)]
        if len(alike) == 1:
            return there
        at = names.index(name)
        return [other for other in there if names.index(other) < at][-1:]
    for own in (_without_last(name), _without_first(name)):
        found = [other for other in there if own and own.lower() in (other.lower(), _signal(other).lower())]
        if found:
            return found[:1]
    return []


def _signal(column: str) -> str:
    parts = split_column(column) or name_and_unit(column)
    return column if parts is None else parts[0]


def rating(name: str, cells: Sequence[str | None], *, project: bool = False) -> Rating | None:
    """Return the ratings in `cells (n,)` of the column `name`, None where no kind of words or codes fits.

    Words are good, uncertain and bad in several languages, with more behind them (`Bad, comm failure`), and the marks
    of instruments. Numbers are OPC's (192 is good), OPC UA's (0 is good, its two highest bits say bad or uncertain),
    with `project` those of this project, or 0 and 1 under a name with a sense (`valid`, `fault`).
    """
    texts = [None if cell is None or cell.strip() in ("", "-") else cell.strip() for cell in cells]
    different = {text for text in texts if text is not None}
    if not different:
        return None
    numbers = {text: number for text in different if (number := _number(text)) is not None}
    if len(numbers) == len(different):
        return _of_numbers(name, texts, numbers, project)
    verdicts: dict[str, Verdict] = {text: found for text in different if (found := _verdict(name, text)) is not None}
    if numbers:
        coded = _codes(name, set(numbers.values()), project=False)
        if coded is not None:
            verdicts |= {text: coded[0][number] for text, number in numbers.items()}
    if "good" in verdicts.values():
        verdicts |= {text: "bad" for text in different - verdicts.keys() if " ".join(text.lower().split()) in MARKS}
    elif len(verdicts) < len(different):
        return None
    return _rating(texts, verdicts, "words")


def _of_numbers(name: str, texts: Sequence[str | None], numbers: dict[str, int], project: bool) -> Rating | None:
    found = _codes(name, set(numbers.values()), project)
    if found is None:
        return None
    verdicts, kind = found
    made = _rating(texts, {text: verdicts[number] for text, number in numbers.items()}, kind)
    if kind != PROJECT:
        return made
    codes = np.array([0 if text is None else numbers[text] for text in texts], dtype=np.uint8)
    return Rating(made.bad, made.uncertain, kind, codes)


PROJECT = "codes of this project"


def _codes(name: str, codes: set[int], project: bool) -> tuple[dict[int, Verdict], str] | None:
    """Return the verdict on each code and the kind of them, None for codes of no known kind.

    Zero and one alone are of no kind: one is stale in this project's records and good in others. The high byte of an
    OPC code belongs to the vendor.
    """
    sense = _sense(name)
    if codes <= {0, 1}:
        if sense is None:
            return None
        one, zero = ("good", "bad") if sense == "good" else (sense, "good")
        return {0: zero, 1: one}, "marks"  # type: ignore[dict-item]
    if any(OPC_GOOD <= code <= 0xFF for code in codes) and all(
        code <= 0xFFFF and code & 0xFC in _OPC for code in codes
    ):
        return {code: _opc(code & 0xFF) for code in codes}, "OPC codes"
    if 0 in codes and all(code == 0 or code >= _UA_UNCERTAIN for code in codes):
        return {code: "good" if code < _UA_UNCERTAIN else "uncertain" if code < _UA_BAD else "bad" for code in codes}, (
            "OPC UA codes"
        )
    if project and codes <= {int(member) for member in Quality} and 0 in codes:
        return {code: "bad" if code else "good" for code in codes}, PROJECT
    return None


def _opc(code: int) -> Verdict:
    return "good" if code >= OPC_GOOD else "uncertain" if code >= OPC_UNCERTAIN else "bad"


def _rating(texts: Sequence[str | None], verdicts: dict[str, Verdict], kind: str) -> Rating:
    bad = np.array([text is not None and verdicts.get(text) == "bad" for text in texts], dtype=np.bool_)
    uncertain = np.array([text is not None and verdicts.get(text) == "uncertain" for text in texts], dtype=np.bool_)
    strange = [(row, text) for row, text in enumerate(texts) if text is not None and text not in verdicts]
    reasons = np.where(bad, Quality.SENSOR_FAULT, Quality.GOOD).astype(np.uint8)
    return Rating(bad, uncertain, kind, reasons, strange[0] if strange else None, len(strange))


def _verdict(name: str, text: str) -> Verdict | None:
    low = " ".join(text.lower().split())
    first = re.split(r"[^\w.]", low, maxsplit=1)[0].strip(".")
    sense = _sense(name) or ("good" if may_rate(name) else None)
    if low in _TRUE or low in _FALSE:
        if sense is None:
            return None
        if low in _TRUE:
            return sense
        return "bad" if sense == "good" else "good"
    for word in (low, first):
        if word in _GOOD_WORDS:
            return "good"
        if word in _UNCERTAIN_WORDS:
            return "uncertain"
        if word in _BAD_WORDS:
            return "bad"
    return _PHRASES.get(low)


def _sense(name: str) -> Verdict | None:
    """Return the meaning of a mark that is set under `name`: good, bad or uncertain; None where the name gives none."""
    words = set(_words(_bare(name))[:1] + _words(_bare(name))[-1:])
    if words & _GOOD_IF:
        return "good"
    if words & _DOUBTED_IF:
        return "uncertain"
    return "bad" if words & _BAD_IF else None


def _number(text: str) -> int | None:
    if re.fullmatch(r"0x[0-9a-fA-F]{1,8}|\d{1,10}(?:\.0*)?", text, re.ASCII) is None:
        return None
    return int(text, 0) if text.startswith("0x") else int(text.split(".")[0])


def _bare(name: str) -> str:
    """Return a name in small letters, without the number by which a repeated one is told from the first."""
    return re.sub(r"_\d+$", "", _without_code(name).lower())


def _without_code(name: str) -> str:
    """Return a name without `code` behind a word of rating."""
    return re.sub(r"(?i)(quality|status|statut|qualität)[\s_.-]*code\b", r"\1", name.strip())


def _words(bare: str) -> tuple[str, ...]:
    return tuple(word for word in re.split(r"[\s_.:/()\[\]-]+", bare) if word)


def _without_last(name: str) -> str:
    """Return the name of the signal before the word of rating, "" where the last word is none."""
    found = re.fullmatch(r"(.+?)[\s_.:/(\[-]+([^\s_.:/()\[\]-]+)[)\]]?", _without_code(name))
    return found[1].strip() if found and found[2].lower() in _RATES | _GOOD_IF | _BAD_IF else ""


def _without_first(name: str) -> str:
    found = re.fullmatch(r"([^\s_.:/()\[\]-]+)[\s_.:/(\[-]+(.+?)[)\]]?", _without_code(name))
    return found[2].strip() if found and found[1].lower() in _RATES | _GOOD_IF | _BAD_IF else ""


def holds_flags(cells: Sequence[str | None]) -> bool:
    """Return True for cells of True and False alone, in any language, which name nothing."""
    flags = _TRUE | _FALSE
    return any(cells) and all(cell.strip().lower() in flags for cell in cells if cell)


def texts_of(cells: Any) -> list[str | None]:
    """Return the cells of a column as text, None for no cell and for types without text; whole numbers are without
    decimals.
    """
    import pyarrow as pa
    import pyarrow.types as kinds

    kind = cells.type
    if kinds.is_dictionary(kind):
        return texts_of(cells.cast(kind.value_type))
    if kinds.is_floating(kind):
        return [None if x is None or x != x else f"{x:.15g}" for x in cells.to_pylist()]
    try:
        found: list[str | None] = cells.cast(pa.string()).to_pylist()
    except (pa.ArrowNotImplementedError, pa.ArrowInvalid):
        return [None] * len(cells)
    return found
