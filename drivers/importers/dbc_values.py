"""Value tables of DBC signals (`VAL_`): enumerations, and special codes of signals that are measured.

A device marks "signal not available" or "error" with raw numbers that no measurement reaches, and DBC files name them
in the same table that names the states of an enumeration.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from drivers.can import DbcSignal

_FEW_BITS = 8
"""Bits of the longest signal without unit that is an enumeration by its names alone: one byte, as states usually are"""
_NEARLY_ALL = 0.75
"""Least share of a signal's values with a name: two bits have three states and one "not available" (SAE J1939-71)"""

_NO_VALUE = re.compile(
    r"error|\berr\b|\bsna\b|not ?av|unavail|\bn/?a\b|invalid|implausib|faul|fail|overr|overfl|underfl|undefined"
    r"|not def|no (?:signal|value|data|sensor)|missing|defe[ck]t|broken|break|short"
    r"|open (?:circ|load|wire|loop|sens)|open$|^open"
    r"|fehler|ung(?:ue|ü)ltig|nicht (?:verf|vorh|def)|kein(?:e|en)? (?:signal|wert|mess)|kurzschl|unterbr|bruch"
    r"|st(?:oe|ö)rung|unplausib|erreur|d[eé]faut|invalide|indisponib|non (?:disp|val|d[eé]f)|court|coupure|panne"
    r"|errore|guast|cortocirc|no (?:disp|v[aá]lid)|fallo|aver[ií]a|inv[aá]lid"
)
_NO_FAULT = re.compile(
    r"\b(?:no|without|kein\w*|ohne|sans|pas d\w*|aucun\w*|nessun\w*|senza|sin|ning[uú]n\w*|not)\W*"
    r"(?:active )?(?:err|faul|fail|short|open|break|fehl|st(?:oe|ö)r|kurz|bruch|d[eé]f[ae]|guast|fallo|pann|cour|aver)"
    r"|(?:error|fault|fehler) ?(?:free|frei)"
)
_CLOSED = re.compile(r"clos|\bshut|\bzu\b|geschl|ferm|chius|cerrad")


@dataclass(frozen=True, slots=True)
class ValueTable:
    """Meaning of a signal's value table: `labels` of an enumeration, or None with the special codes of a measurement.

    `invalid` are values in the signal's unit that stand for no measurement, `others` are names with such values that
    are noted and change nothing.
    """

    labels: dict[str, str] | None
    invalid: list[float] = field(default_factory=list)
    others: list[str] = field(default_factory=list)


def value_table(signal: DbcSignal) -> ValueTable:
    """Return the meaning of the names that a DBC file gives a signal's raw values."""
    held = 1 << signal.length  # a raw number beyond the signal's bits comes in no frame
    named = {raw: text for raw, text in (signal.choices or {}).items() if -held <= raw < held}
    choices = {_as_decoded(raw, signal): text for raw, text in named.items()}
    if not choices:
        return ValueTable(None)
    if _is_enumeration(signal, choices):
        return ValueTable({str(raw): text for raw, text in choices.items()})
    found = ValueTable(None)
    opens = {raw for raw, text in choices.items() if _words(text) == "open"}
    valve = opens and any(_CLOSED.search(_words(text)) for text in choices.values())
    for raw, text in sorted(choices.items()):
        value = float(f"{raw * signal.scale + signal.offset:.12g}")
        if means_no_value(text) and not (raw in opens and (valve or _in_range(signal, value))):
            found.invalid.append(value)
        else:
            found.others.append(f"{value:g} is {text!r}")
    return found


def means_no_value(text: str) -> bool:
    """Return True where the name of a raw value means that there is no measurement: error, not available, short."""
    words = _words(text)
    return _NO_VALUE.search(words) is not None and _NO_FAULT.search(words) is None


def _words(text: str) -> str:
    """Return a text in small letters, with blanks for underscores and before inner capitals."""
    return re.sub(r"[\s_-]+", " ", re.sub(r"(?<=[a-zäöüé])(?=[A-Z])", " ", text)).strip().lower()


def _as_decoded(raw: int, signal: DbcSignal) -> int:
    """Return a raw number as the signal decodes to: a table may write -1 of a signed signal as all ones."""
    if signal.is_signed and raw >= 1 << (signal.length - 1):
        return raw - (1 << signal.length)
    return raw


def _in_range(signal: DbcSignal, value: float) -> bool:
    if signal.minimum is None or signal.maximum is None:
        return False
    return signal.minimum <= value <= signal.maximum


def _is_enumeration(signal: DbcSignal, choices: dict[int, str]) -> bool:
    """Return True where the names are states: of nearly all values, or densely of those of a short plain signal."""
    if signal.is_float or signal.scale != 1 or signal.offset != 0:
        return False
    admitted = float(1 << signal.length)
    if signal.minimum is not None and signal.maximum is not None and signal.minimum < signal.maximum:
        admitted = min(admitted, signal.maximum - signal.minimum + 1)
        inside = sum(_in_range(signal, raw) for raw in choices)
    else:
        inside = len(choices)
    if inside >= _NEARLY_ALL * admitted:
        return True
    states = [raw for raw, text in choices.items() if not means_no_value(text)]
    if signal.unit.strip() not in ("", "1", "-") or signal.length > _FEW_BITS or len(states) < 2:
        return False
    return 2 * len(states) > max(states) - min(states)
