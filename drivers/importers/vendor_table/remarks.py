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
    r"(?:±|\+/-|\b(?:accuracy|tolerance|genauigkeit|toleranz|uncertainty|noise|"
    r"(?:max\w*|typ\w*|measur\w+|relative|absolute|mess)[. -]{0,2}(?:error|fehler))\b)[^;,]{0,12}?\d+(?:[.,]\d+)?",
    re.I,
)
"""Dates, places in documents, versions, and accuracies."""
_RAW = r"(?:raw|value|val|reg(?:ister)?|counts?|wert|rohwert|reading|data|valeur|adc|x)"
_NUMBER = r"-?\d+(?:[.,]\d+)?"
_SIGN = r"[-+\u2212\u2013]?"
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
    r"(?:invalid|undefined|not (?:available|connected|present|valid|fitted|measured)|unavailable|disconnected|"
    r"unplugged|n/a|nan|null|err(?:ors?)?|faults?|faulty|fail\w*|broken|break(?:age)?|burn-?out|open|short\w*|missing|implausible|"
    r"defe[ck]t\w*|no (?:sensor|probe|signal|value|data|reading|measurement)|out of (?:range|order|service)|"
    r"over-?range|under-?range|overflow|underflow|"
    r"ung[üu]e?ltig\w*|unplausib\w*|\w*fehler\w*|\w*bruch|\w*unterbrechung|\w*kurzschlu(?:ss|ß)|st(?:ö|oe)rung|"
    r"nicht (?:verf|vorh|angeschl|belegt)\w*|kein\w* (?:\w*f(?:ü|ue)hler|sensor|signal|\w*wert|messung)|"
    r"invalide|erreur|d[ée]faut|panne|coupure|rupture|absente?|court-?circuit|indisponible|"
    r"pas de (?:sonde|capteur|signal|valeur)|non (?:disponible|valide))"
)
_CERTAIN = (
    r"(?:-?0x[0-9a-f]{2,}\b|\b[0-9a-f]{4}h\b|"
    rf"(?<![\w.,]){_SIGN}(?:3[.,]?2[.,]?7[.,]?6[.,]?[78]|6[.,]?5[.,]?5[.,]?3[.,]?5|9(?:[.,]?9){{2,}})(?![\w]*\d|[.,]\d)|"
    r"(?<![\w.,])[-\u2212]\d{3,}(?:[.,]\d+)?(?![\w]*\d|[.,]\d))"
)
"""Numbers that stand for no value wherever a fault is named near them, raw or in the unit: 32767 and 3276.7."""
_CODE_NUMBER = (
    rf"(?<![\w.,])(?:{_SIGN}\d+[.,]\d+(?:e[-+]?\d+)?(?!\d|[.,]\d)|{_SIGN}\d+e[-+]?\d+\b|\d{{3,}}\b(?![.,]\d)|"
    r"[-+\u2212]\d+\b(?![.,]\d))"
)
"""Numbers that may be a code where words link them to a fault. Small ones without a sign or decimals may be states."""
_EQUALS = (
    r"(?:=|≙|≡|->|→|"
    r"\b(?:means?|equals|stands for|signals|signif\w+|bedeutet|hei(?:ß|ss)t|entspricht|steht f(?:ü|ue)r)\b)"
)
_LINK = rf"(?:{_EQUALS}|:|\(|\b(?:is|when|if|indicates?|bei|wenn|si|indique|value|code|reads?|gives|returns|wert)\b)"
_BETWEEN = r"[^.;,\d]{0,20}?"
_SENSOR = r"\b\w*(?:sensor|f(?:ü|ue)hler|probe|sonde|capteur)\b"
_NO_END = r"(?!\s*(?:the )?(?:max|full|upper|lower|min|limit|end|obere|untere|range))"
_CODE = re.compile(
    rf"\b{_FAULT}\b[^.;]{{0,20}}?{_CERTAIN}|{_CERTAIN}[^.;]{{0,20}}?\b{_FAULT}|"
    rf"{_CERTAIN}\s*[°%\w]{{0,4}}\s*{_EQUALS}{_NO_END}\s*[^\W\d]|{_SENSOR}{_BETWEEN}{_EQUALS}\s*{_CERTAIN}|"
    rf"\b{_FAULT}\b{_BETWEEN}{_LINK}{_BETWEEN}{_CODE_NUMBER}|"
    rf"{_CODE_NUMBER}{_BETWEEN}(?:{_LINK}|\b(?:on|upon|at|for|in case of|en cas de|pour)\b){_BETWEEN}\b{_FAULT}|"
    rf"\b(?:on|upon|at|if|when|in case of|bei|wenn|si|en cas de)\b{_BETWEEN}\b{_FAULT}\b{_BETWEEN}{_CODE_NUMBER}",
    re.I,
)
_CODE_OF_A_QUANTITY = re.compile(
    rf"(?<!bit )(?<![\w.,])\d{{1,2}}\b(?![.,]\d){_BETWEEN}{_EQUALS}{_BETWEEN}\b{_FAULT}|"
    rf"\b{_FAULT}\b{_BETWEEN}{_EQUALS}{_BETWEEN}\d{{1,2}}\b(?![.,]\d)",
    re.I,
)
"""Small codes, as in `99 = sensor break`: of a register without a unit such a number may be a state."""
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
    if not cells.get("invalid") and (found := _code_in(text, has_unit=_has_unit(cells))):
        remedy = "put the code in a column invalid (raw or in the unit), - where there is none"
        return f"its remark says {_shown(found)}; {remedy}"
    if is_integer and not has_factor:
        words = factor_in_words(cells["name"], text)
        found = _FACTOR.search(text)
        if words is not None or found is not None:
            said = repr(words) if words is not None else _shown(found)
            return f"its name or remark says {said}; put the factor in a column scale, 1 where there is none"
    if not cells.get("offset") and not has_factor and (found := _OFFSET.search(text)):
        return f"its remark says {_shown(found)}; put the offset in a column offset, 0 where there is none"
    return None


def _code_in(text: str, *, has_unit: bool) -> re.Match[str] | None:
    """Return the words that name a code for "no value"; a small one counts only for a quantity with a unit."""
    return _CODE.search(text) or (_CODE_OF_A_QUANTITY.search(text) if has_unit else None)


def _has_unit(cells: Mapping[str, str]) -> bool:
    return cells.get("unit", "").strip() not in ("", "1", "-", "--", "–", "none", "n/a")


def number_in_remark(remark: str) -> str | None:
    """Return a number of a remark that may be a factor or a range, though nothing says so; None where there is none."""
    found = _SOME_NUMBER.search(_HARMLESS.sub(" ", remark))
    return None if found is None else found[0].strip()


def _shown(found: re.Match[str] | None) -> str:
    return repr(" ".join(found[0].split())) if found is not None else "''"
