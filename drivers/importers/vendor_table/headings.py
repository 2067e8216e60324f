"""Meaning of the headings of a register table, by its words, and of a column whose heading is not known, by its cells.

A column that may change a value, or the place from which it is read, is used or refused. Only a column that can do
neither is left unused.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from drivers.importers.vendor_table.words import HEADINGS, SIGNS, TABLES, squeezed, squeezed_heading
from drivers.signals import canonical_unit

_AMBIGUOUS = re.compile(
    r"\b(?:gain|verstaerkung|resolution|aufloesung|step|schrittweite|pas|increment|inkrement|lsb|granularity|precision|"
    r"praezision|decimals?|digits?|dezimalstellen|nachkomma(?:stellen)?|kommastellen|decimales|exponent|exposant|"
    r"power of ten|sf|formula|formel|formule|conversion|umrechnung|ratio|weight|wertigkeit|count value|slope|steigung|"
    r"pente|calculation|berechnung|span|spanne|zero|full scale|fullscale|endwert|vollausschlag|pleine echelle)\b"
)
"""Words that may change a value and have no agreed meaning: vendors use `gain` for a factor and for a divisor."""
_CHANGES_A_VALUE = re.compile(
    r"\b(?:scal|skal|echelle|fact|fakt|multipl|gain|divis|divid|teiler|resol|aufloes|expon|decimal|dezimal|offset|"
    r"decalage|nullpunkt|coef|formul|formel|umrechn|convers|komma)|(?:faktor|factor|skalierung|teiler)\b|\bsf\b"
)
_ORDERS_BYTES = re.compile(
    r"endian|boutisme|(?:byte|word)s? (?:order|sequence)|ordre (?:des )?(?:octets|mots)|"
    r"(?:byte|wort|word)\w* ?(?:reihen|ab)folge"
)
_INVERTS = re.compile(r"\b(?:inver\w*|negat\w*|negie\w*|active low|low active|polarit\w*|polaritaet)\b")

_COUNT = r"(?:bits?|counts?|lsb|digits?|increments?|inkremente?|raw(?: unit| count| value)?|rohwert)"
_PER = r"(?:per|pro|par|je)"
_OF_ONE = (
    r"(?:(?:\w+ )?(?:units?|values?|einheit(?:en)?|werte?|unites?|valeurs?|scal\w+|skal\w+|fa[ck]t\w+|resolution|"
    r"aufloesung|weight|wertigkeit|poids))"
)
_VALUE_OF_A_COUNT = re.compile(
    rf"{_OF_ONE} (?:{_PER} {_COUNT}|of (?:one |1 )?(?:lsb|count|bit)|du bit)|(?:lsb|bit|count) (?:value|weight)|bitwert"
)
_COUNTS_OF_A_VALUE = re.compile(rf"{_COUNT} {_PER} (?:eng(?:ineering)? )?(?:units?|einheit|unite)")

_NUMBERED = r"(?:id|ids|ident\w*|address|addr|adr|adresse|no|nr|number|nummer|num|kennung)"
_DEVICE = re.compile(
    rf"(?:modbus )?(?:unit|slave|server|station|node|device|instrument|controller) ?{_NUMBERED}|uid|(?:modbus|mb) id|"
    rf"(?:modbus )?(?:slave|esclave|station|node|noeud|teilnehmer|knoten)|"
    rf"(?:modbus )?(?:geraete?|slave|stations?|teilnehmer|knoten|unit|bus) ?{_NUMBERED}|"
    r"(?:adresse|numero|no|nr|n|id|identifiant)(?: (?:de|d|du|des|l|modbus))* "
    r"(?:esclave|station|noeud|appareil|unite|peripherique|equipement)"
)
_DEVICE_NAME = re.compile(
    r"(?:modbus )?(?:device|devices|slave|station|node|equipment|instrument|controller|geraet|regler|anlage|appareil|"
    r"equipement|peripherique)(?: ?(?:name|label|tag|nom))?|geraetename|"
    r"nom (?:de l |d |du )(?:appareil|esclave|equipement)"
)
_PLACE = re.compile(
    r"(?:ip|host|hostname|gateway|server|network|netzwerk|reseau|bus|segment|(?:tcp |ip |serial |com )?port)"
    r"(?: (?:address|adresse|name|no|nr))?|adresse ip"
)

_RAW = r"(?:raw|roh(?:wert(?:e)?)?|brute?s?|counts?|digits|adc|unscaled|unskaliert)"
_ENGINEERING = r"(?:eng|engineering|eu|scaled?|scaling|skalier\w*|skala|echelle|phys\w*|ingenieur\w*)"
_LOW = re.compile(r"(?:min(?:imum|imal|imalwert|wert|i)?|low|lo|lower|from|von|ab|anfang|unten|untere|bas|debut|inf)")
_HIGH = re.compile(r"(?:max(?:imum|imal|imalwert|wert|i)?|high|hi|upper|to|bis|ende|oben|obere|haut|fin|sup)")
_RANGE = re.compile(r"(?:range|bereich|plage|limits)")
_FILLER = re.compile(
    r"(?:value|values|wert|werte|valeur|valeurs|limit|messbereich|wertebereich|mesure|measuring|measurement|setting|de|of|"
    r"unit|units|input|output|sensor)"
)
_WORD = re.compile(
    rf"(?P<raw>{_RAW})|(?P<eng>{_ENGINEERING})|(?P<low>{_LOW.pattern})|(?P<high>{_HIGH.pattern})|"
    rf"(?P<range>{_RANGE.pattern})|(?P<filler>{_FILLER.pattern})"
)
_COMPOUND = re.compile(r"(roh|skalier)(?:wert|ungs)?[ -]?(min|max|bereich|anfang|ende|von|bis)")

_HARMLESS = re.compile(
    r"(?:no|nr|num|number|nummer|numero|n|index|item|pos|position|line|row|zeile|ligne|lfd nr|"
    r"(?:tag|point|param|parameter|signal|object|item|row|line|variable) ?(?:id|no|nr|number|nummer)|"
    r"(?:default|initial|factory|standard|reset|example|sample|test|preset)\w*(?: (?:value|setting|default|data))?|"
    r"werkseinstellung|werkswert|standardwert|vorgabe\w*|vorbelegung|beispiel\w*|exemple|"
    r"valeur (?:par defaut|initiale)|"
    r"defaut|reglage usine|page|seite|chapter|kapitel|section|group|gruppe|groupe|category|kategorie|categorie|level|"
    r"priority|prioritaet|priorite|version|revision|rev|firmware|(?:since|from|ab) version|date|datum|"
    r"(?:poll|polling|scan|update|refresh|sample|cycle|logging)(?: (?:rate|time|interval|class|cycle))?|interval\w*|"
    r"zyklus\w*|abtast\w*|accuracy|genauigkeit|tolerance|toleranz|colou?r|farbe|couleur|mnemonic|label|symbol|location|"
    r"ort|room|raum|terminal|klemme|pin|wire|cable|kabel|draht|phase|"
    r"(?:[a-z]+ )?(?:alarm|warn|warning|trip|alarme)\w*(?: \w+){0,2}|hh|h|l|ll|hihi|lolo|"
    r"ena(?:ble|bled)|values|enum\w*|options|auswahl|states|status text|tag|kks|comment \d|remark \d)"
)
"""Headings of columns that change neither a value nor its place, whatever numbers they hold."""

_BRACKETED = re.compile(r"[(\[{]([^()\[\]{}]*)[)\]}]")
"""Innermost brackets alone: an opening one inside would be looked for again from each of those before it."""


def heading_key(cell: str) -> tuple[str | None, str]:
    """Return the key of a column and the words in brackets behind its heading: `Address (hex)` is an address in hex.

    The key is None for a column that is not known, and `?` for one that may change a value and has no agreed meaning.
    """
    outside = _BRACKETED.sub(" ", cell)
    inside = squeezed_heading(" ".join(_BRACKETED.findall(cell)))
    heading = squeezed_heading(outside) or squeezed_heading(cell)
    number_base = re.fullmatch(r"(.*?) ?(hex|dec)(?:imal)?", heading)
    if number_base is not None and number_base[1]:
        heading, inside = number_base[1], f"{inside} {number_base[2]}".strip()
    key = next((key for key, names in HEADINGS.items() if heading in names), None)
    if key in (None, "min", "max"):
        key = _range_key(f"{heading} {inside}".strip()) or key
    if key == "address" and re.search(r"\b(?:slave|unit|device|station|node|geraet|esclave|appareil)\b", inside):
        return "device", inside
    key = key or _key_by_words(heading, squeezed_heading(re.sub(r"/|÷", " per ", outside)))
    if key in ("scale", "divisor", "offset", "unit") and re.search(
        r"\d|raw|roh|brut|\b(?:bit|count|lsb|digit)", inside
    ):
        key = "?"  # a formula, or a unit that is one count's
    return key, inside


def _key_by_words(heading: str, with_per: str) -> str | None:
    """Return the key of a heading that is in no list; `with_per` has `per` for each stroke."""
    if "swap" in heading:
        return "word_swap" if "word" in heading else "byte_swap" if "byte" in heading else "swap"
    for key, known in (
        ("unit_per_count", _VALUE_OF_A_COUNT),
        ("count_per_unit", _COUNTS_OF_A_VALUE),
        ("device", _DEVICE),
        ("device_name", _DEVICE_NAME),
        ("place", _PLACE),
    ):
        if known.fullmatch(with_per) or known.fullmatch(heading):
            return key
    if _ORDERS_BYTES.search(heading):
        return "order"
    if _INVERTS.search(heading):
        return "invert"
    if _HARMLESS.fullmatch(heading):
        return None
    return "?" if _AMBIGUOUS.search(heading) or _CHANGES_A_VALUE.search(heading) else None


def _range_key(heading: str) -> str | None:
    """Return the key of an end of a raw or engineering range, or of such a range in one cell; None for other headings.

    `Raw min`, `Min (raw)`, `Rohwert von` and `valeur brute max` are of the raw range. Ends without a side, such as
    `Messbereich von` or `Range low`, are the ends of the value's own range.
    """
    words = _COMPOUND.sub(r"\1 \2", heading).replace("messbereichs", "messbereich ").split()
    found = [_WORD.fullmatch("roh" if word == "roh" else word) for word in words]
    if not found or any(match is None for match in found):
        return None
    kinds = {match.lastgroup for match in found if match is not None}
    side = "raw_" if "raw" in kinds else "eng_" if "eng" in kinds or "skalier" in words else ""
    ends = kinds & {"low", "high"}
    if len(ends) == 1 and (side or len(words) > 1):  # one word alone may be anything: `from` and `to` are addresses
        return side + ("min" if "low" in ends else "max")
    is_range = "range" in kinds or bool({"messbereich", "wertebereich"} & set(words))
    return f"{side}range" if is_range and not ends else None


_NUMBER = re.compile(
    r"[x×*·/÷:]?\s*[-+]?(?:0x[0-9a-f]+|[0-9a-f]+h|\d[\d.,' ]*(?:e[-+]?\d+)?)(?:\s*/\s*\d+)?\s*(?P<unit>\D{0,8})", re.I
)
_ORDER_CELL = re.compile(
    r"(?:abcd|cdab|badc|dcba|[1-4]-[1-4]-[1-4]-[1-4]|ab|ba|(?:big|little|mid)[ -]?(?:little[ -]|big[ -])?endian.*|"
    r"[ml]s[wb](?: first)?|(?:low|high) (?:word|byte) first)",
    re.I,
)


def is_harmless(heading: str) -> bool:
    """Return True for a heading whose column changes neither a value nor the place that it is read from."""
    plain = squeezed_heading(_BRACKETED.sub(" ", heading)) or squeezed_heading(heading)
    return heading.strip() == "#" or _HARMLESS.fullmatch(plain) is not None


FACTORS = "factors of units"
_FACTOR_OF_UNIT = re.compile(r"(?<![\d.,-])(?:0[.,]0*1|1/10+|[x×*]\s*10+)\s*(?:°\s*[CFK]|[A-Za-z%]+)")
"""Value of one count before a unit within a text, as in `-400...1500 (0.1 °C)`."""


def contents_that_matter(cells: Sequence[str]) -> str | None:
    """Return the likely meaning of the cells of an unknown column if it may change a value or its place, else None."""
    there = [cell for cell in cells if cell not in ("", "-", "–", "n/a", "N/A")]
    if not there:
        return None
    if any(_is_number(cell) for cell in there):
        return "numbers"
    if any(_FACTOR_OF_UNIT.search(cell) for cell in there):
        return FACTORS
    words = [squeezed(cell) for cell in there]
    if all(_ORDER_CELL.fullmatch(cell) for cell in there):
        return "orders of bytes"
    if all(word in SIGNS for word in words) and any(len(word) > 1 for word in words):
        return "signs of numbers"
    if all(word in TABLES for word in words) and not {"input"} >= set(words):
        return "tables"
    return None


def _is_number(cell: str) -> bool:
    found = _NUMBER.fullmatch(cell.strip())
    if found is None:
        return False
    unit = found["unit"].strip()
    if not unit:
        return True
    try:
        canonical_unit(unit)
    except ValueError:
        return False
    return True


def names_registers(names: Sequence[str]) -> bool:
    """Return True for the headings of a register table: they name a point, its address and its type."""
    return {"name", "address", "type"} <= {heading_key(name)[0] for name in names}
