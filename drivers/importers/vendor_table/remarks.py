"""Content of a remark that changes how a register is read: factors, offsets, orders of words, formats and codes.

A remark is text for people. A point whose remark has such content, and no column that says the same, can be read in two
ways, so it is left out. Dates, chapters, versions and enumerated states (`0 = off`) change nothing.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from drivers.importers.vendor_table.scale import factor_in_words

_HARMLESS = re.compile(
    r"\b\d{4}-\d{1,2}-\d{1,2}\b|\b\d{1,2}\.\d{1,2}\.(?:\d{4}|\d{2})\b|\b\d{1,2}/\d{1,2}/\d{4}\b|"
    r"(?:\b(?:chapter|chap|ch|section|sec|kapitel|kap|abschnitt|chapitre|version|ver|v|revision|rev|fw|sw|firmware|software|"
    r"page|pp?|seite|figure|fig|abb|table|tab|tabelle|see|siehe|voir|since|seit|manual|iso|iec|en|din|no|nr)\b|§)"
    r"[\s.:#]*(?:[A-Z]{1,4}\s*)?v?\d+(?:[.\-:/]\d+)*[a-z]?|"
    r"(?:±|\+/-|\b(?:accuracy|tolerance|genauigkeit|toleranz|uncertainty|noise)\b)[^;,]{0,12}?\d+(?:[.,]\d+)?",
    re.I,
)
"""Dates, places in documents, versions, and accuracies."""
_RAW = r"(?:raw|value|val|reg(?:ister)?|counts?|wert|rohwert|reading|data|valeur|adc|x)"
_NUMBER = r"-?\d+(?:[.,]\d+)?"
_COUNT = r"(?:\d+|one|two|three|four|ein|eine|zwei|drei|un|une|deux|trois)"
_UNIT = r"(?:\s?[°%µ\w/]{1,6})?"
_FACTOR = re.compile(
    rf"\b(?<!hexa)decimals?\b|nachkomma|kommastelle|d[ée]cimale|\b{_COUNT}\s?d\.?p\b|"
    rf"÷\s*\d|\b{_RAW}\s*[/÷:*×·]\s*\d|\b{_RAW}\s?\(?\s*(?:/|\*|x)\s?\d|[a-z)]\s*/\s*(?:10+|16|32|64|128|256|512|1024)\b|"
    rf"\b(?:mal|times|fois|x|by)\s?10+\b|\b10+\s?[x×](?!\s?\d)|\b(?:geteilt|dividiert|divided?|divisor|division)\b|"
    r"\b(?:scaled|scaling|scale factor|multiplier|multiplied|skaliert?|skalierung|skalierungsfaktor|sf|sunssf)\b|"
    r"\b(?:lsb|lsd)\b(?!\s*(?:first|zuerst))|(?:\bper |/\s?)(?:count|bit|digit|lsb|step|increment|tick)\b|"
    r"\b(?:steps?|increments?|schritte?n?|multiples?|units?) (?:of|von|de) \d|\b10+ths?\b|"
    r"\b(?:tenths?|hundredths?|thousandths?)\b|"
    r"\b(?:deci|centi|milli)[- ]?(?:deg|celsius|kelvin|grad|volt|amp|bar|watt|percent)|\b10\s?(?:\^|\*\*)|\bexponent\b|"
    r"(?<![\d.,])0[.,]0*1(?![\d.,]*\d)|\b(?:gain|slope|steigung)\b[^.;]{0,12}\d|"
    rf"{_NUMBER}{_UNIT}\s*(?:=|≙|≡|->|→|means|equals|entspricht|corresponds to|is)\s*{_NUMBER}",
    re.I,
)
_OFFSET = re.compile(
    rf"\boffset\b|nullpunkt|d[ée]calage|\bbias(?:ed)?\b|\bsubtract|\babz[üu]g?l?ich|\babziehen\b|\b(?:minus|plus|add)\s?\d|"
    rf"\b{_RAW}\s*[-+\u2212]\s*\d|\bshift(?:ed)? by\b",
    re.I,
)
_ORDER = re.compile(
    r"\b(?:word|byte|register)[- ]?order\b|\b(?:word|byte|register)s?[- ]swap|\bswap(?:ped)?\b|"
    r"\bvertauscht\b|reihenfolge|"
    r"\b(?:low|lower|lo|least significant|lsw|lsb|niederwertig\w*)(?: (?:word|byte|register))?[ ,:]+(?:first|zuerst)\b|"
    r"\blittle[- ]?endian\b|\b(?:CDAB|BADC|DCBA)\b|\bmid(?:dle)?[- ]endian\b",
    re.I,
)
_FORMAT = re.compile(
    r"\bBCD\b|\bfix(?:ed)?[- ]?(?:point|komma)|\bFestkomma|\bQ\d{1,2}(?:\.\d{1,2})?\b|\bgray[- ]?code|"
    r"\bsign[- ](?:and[- ])?magnitude|"
    r"\bone'?s complement|\bpacked\b|\bmantissa",
    re.I,
)
_FAULT = (
    r"(?:invalid|not available|unavailable|n/a|nan|null|error|fault|fail\w*|broken|open|short\w*|missing|no sensor|"
    r"defe[ck]t|over-?range|under-?range|overflow|out of range|disconnected|ung[üu]e?ltig|fehler\w*|defekt|drahtbruch|"
    r"kurzschluss|invalide|erreur|d[ée]faut)"
)
_CERTAIN = r"(?:-?0x[0-9a-f]{2,}|\b[0-9a-f]{4}h|-?3276[78]|65535|-?9{3,}|-\d{3,})"
_MEANS = r"[^.;,\d]{0,20}?(?:=|:|->|→|\b(?:means?|is|when|if|indicates?|bei|wenn|bedeutet|si)\b)[^.;,\d]{0,20}?"
_CODE = re.compile(
    rf"\b{_FAULT}\b[^.;]{{0,20}}?{_CERTAIN}\b|{_CERTAIN}\b[^.;]{{0,20}}?\b{_FAULT}|"
    rf"\b{_FAULT}\b{_MEANS}\d{{3,}}\b|\b\d{{3,}}\b{_MEANS}\b{_FAULT}",
    re.I,
)
_SOME_NUMBER = re.compile(
    rf"(?<![\w.,])\d+[.,]\d+|(?<![\w.,])10+(?![\w.,]*\d)|{_NUMBER}\s*(?:\.\.+|…|\bto\b|\bbis\b)\s*{_NUMBER}|\b\d+\s?-\s?\d+\s?mA",
    re.I,
)


def doubt_in_remark(cells: Mapping[str, str], kind: str, registers: int, *, has_factor: bool, order: str) -> str | None:
    """Return the doubt about a point and its remedy, for content of its remark that no column has; None for no doubt.

    Parameters
    ----------
    cells
        Texts of the line by key.
    kind, registers
        Type of the value, and how many registers it has.
    has_factor
        True where a column, a unit or a range gives the value of one count.
    order
        Order of bytes that is used.
    """
    text = _HARMLESS.sub(" ", cells.get("doc", ""))
    is_integer = "int" in kind
    if is_integer and (found := _FORMAT.search(text)):
        return f"its remark says {_shown(found)}, a format that is not read here; take the point or that remark out"
    if order == "ABCD" and not any(cells.get(key) for key in ("order", "swap", "word_swap", "byte_swap")):
        found = _ORDER.search(text)
        if found is not None and (registers > 1 or "byte" in text.lower()):
            return f"its remark says {_shown(found)}; put the order in a column order (ABCD, CDAB, BADC or DCBA)"
    if not cells.get("invalid") and (found := _CODE.search(text)):
        return f"its remark says {_shown(found)}; put the code in a column invalid, - where there is none"
    if is_integer and not has_factor:
        words = factor_in_words(cells["name"], text)
        found = _FACTOR.search(text)
        if words is not None or found is not None:
            said = repr(words) if words is not None else _shown(found)
            return f"its name or remark says {said}; put the factor in a column scale, 1 where there is none"
    if not cells.get("offset") and not has_factor and (found := _OFFSET.search(text)):
        return f"its remark says {_shown(found)}; put the offset in a column offset, 0 where there is none"
    return None


def number_in_remark(remark: str) -> str | None:
    """Return a number of a remark that may be a factor or a range, though nothing says so; None where there is none."""
    found = _SOME_NUMBER.search(_HARMLESS.sub(" ", remark))
    return None if found is None else found[0].strip()


def _shown(found: re.Match[str] | None) -> str:
    return repr(" ".join(found[0].split())) if found is not None else "''"
