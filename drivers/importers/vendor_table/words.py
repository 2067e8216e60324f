"""Words of vendors' register tables: headings in English, German and French, types, tables and access."""

from __future__ import annotations

import re
import unicodedata

HEADINGS = {
    "name": (
        "name",
        "register name",
        "parameter",
        "parameter name",
        "signal",
        "signal name",
        "point",
        "point name",
        "variable",
        "variable name",
        "tag",
        "tag name",
        "bezeichnung",
        "signalname",
        "registername",
        "datenpunkt",
        "messwert",
        "nom",
        "designation",
        "libelle",
        "grandeur",
    ),
    "address": (
        "address",
        "addr",
        "register",
        "register address",
        "reg",
        "register number",
        "modbus address",
        "reg address",
        "modbus register",
        "start address",
        "register no",
        "address dec",
        "register dec",
        "adresse",
        "registeradresse",
        "register adresse",
        "startadresse",
        "modbusadresse",
        "modbus adresse",
        "registernummer",
        "adr",
        "adresse registre",
        "adresse modbus",
        "registre",
    ),
    "table": (
        "table",
        "register type",
        "object type",
        "input type",
        "area",
        "modbus table",
        "registertyp",
        "registerart",
        "tabelle",
        "bereich",
        "type de registre",
        "zone",
    ),
    "function": (
        "function",
        "function code",
        "fc",
        "function codes",
        "modbus function",
        "funktion",
        "funktionscode",
        "fonction",
        "code fonction",
        "code de fonction",
    ),
    "type": (
        "type",
        "data type",
        "datatype",
        "format",
        "data format",
        "value type",
        "typ",
        "datentyp",
        "datenformat",
        "type de donnees",
        "type donnees",
    ),
    "order": ("order", "byte order", "word order", "endianness", "endian", "bytereihenfolge", "wortreihenfolge"),
    "scale": (
        "scale",
        "factor",
        "multiplier",
        "scaling",
        "scale factor",
        "scalefactor",
        "scaling factor",
        "multiplication factor",
        "multiply by",
        "conversion factor",
        "faktor",
        "skalierung",
        "skalierungsfaktor",
        "skalenfaktor",
        "skalafaktor",
        "multiplikator",
        "umrechnungsfaktor",
        "facteur",
        "echelle",
        "facteur d echelle",
        "facteur echelle",
        "coefficient",
        "coef",
        "coeff",
        "multiplicateur",
    ),
    "divisor": ("divisor", "divider", "divide by", "teiler", "diviseur"),
    "offset": ("offset", "value offset", "zero offset", "nullpunkt", "nullpunktverschiebung", "decalage"),
    "unit": (
        "unit",
        "units",
        "unit of measurement",
        "unit of measure",
        "uom",
        "eng unit",
        "einheit",
        "unite",
        "unites",
    ),
    "access": (
        "access",
        "rw",
        "r w",
        "read write",
        "permission",
        "permissions",
        "access type",
        "mode",
        "zugriff",
        "zugriffsart",
        "lesen schreiben",
        "l s",
        "acces",
        "lecture ecriture",
        "l e",
    ),
    "word_swap": (
        "word swap",
        "wordswap",
        "word swapped",
        "swap words",
        "words swapped",
        "swapped words",
        "register swap",
        "worttausch",
    ),
    "byte_swap": (
        "byte swap",
        "byteswap",
        "byte swapped",
        "swap bytes",
        "bytes swapped",
        "swapped bytes",
        "bytetausch",
    ),
    "swap": ("swap", "swapped", "swapping"),
    "bits": ("bit", "bits", "bit number", "bitnummer"),
    "length": (
        "length",
        "registers",
        "count",
        "size",
        "quantity",
        "number of registers",
        "no of registers",
        "word count",
        "words",
        "laenge",
        "anzahl",
        "anzahl register",
        "longueur",
        "nombre de registres",
        "taille",
    ),
    "min": ("min", "minimum", "min value", "minimalwert", "minwert", "mini", "valeur min", "lower limit"),
    "max": ("max", "maximum", "max value", "maximalwert", "maxwert", "maxi", "valeur max", "upper limit"),
    "doc": (
        "description",
        "doc",
        "comment",
        "comments",
        "remark",
        "remarks",
        "notes",
        "note",
        "beschreibung",
        "bemerkung",
        "bemerkungen",
        "kommentar",
        "hinweis",
        "commentaire",
        "remarque",
        "remarques",
    ),
}
"""Heading as `squeezed_heading` leaves it; the first that fits counts."""
AMBIGUOUS = (
    "gain",
    "verstaerkung",
    "resolution",
    "aufloesung",
    "step",
    "schrittweite",
    "pas",
    "increment",
    "lsb",
    "granularity",
    "precision",
    "praezision",
    "decimals",
    "decimal places",
    "decimal",
    "digits",
    "dezimalstellen",
    "nachkommastellen",
    "nachkomma",
    "kommastellen",
    "decimales",
    "exponent",
    "exposant",
    "power of ten",
    "sf",
    "formula",
    "formel",
    "formule",
    "conversion",
    "umrechnung",
    "ratio",
    "weight",
    "wertigkeit",
    "count value",
    "value per count",
    "slope",
    "steigung",
    "pente",
    "calculation",
    "berechnung",
)
"""Headings that may change a value and have no agreed meaning: vendors use `gain` for a factor and for a divisor."""
_CHANGES_A_VALUE = re.compile(
    r"\b(?:scal|skal|echelle|fact|fakt|multipl|gain|divis|divid|teiler|resol|aufloes|expon|decimal|dezimal|offset|"
    r"decalage|nullpunkt|coef|formul|formel|umrechn|convers|komma)|(?:faktor|factor|skalierung|teiler)\b|\bsf\b"
)
_ORDERS_BYTES = re.compile(
    r"endian|boutisme|(?:byte|word)s? (?:order|sequence)|ordre (?:des )?(?:octets|mots)|"
    r"(?:byte|wort|word)\w* ?(?:reihen|ab)folge"
)
TABLES = {
    "coil": "coil",
    "coils": "coil",
    "co": "coil",
    "do": "coil",
    "discrete": "discrete",
    "discreteinput": "discrete",
    "discreteinputs": "discrete",
    "di": "discrete",
    "inputstatus": "discrete",
    "holding": "holding",
    "holdingregister": "holding",
    "holdingregisters": "holding",
    "hr": "holding",
    "halteregister": "holding",
    "input": "input",
    "inputregister": "input",
    "inputregisters": "input",
    "ir": "input",
    "eingangsregister": "input",
}
OF_FUNCTION = {
    1: "coil",
    5: "coil",
    15: "coil",
    2: "discrete",
    4: "input",
    3: "holding",
    6: "holding",
    16: "holding",
    22: "holding",
    23: "holding",
}
WRITES = {5, 6, 15, 16, 22, 23}
ACCESS = {
    "r": "r",
    "ro": "r",
    "read": "r",
    "readonly": "r",
    "l": "r",
    "lesen": "r",
    "nurlesen": "r",
    "lecture": "r",
    "lectureseule": "r",
    "w": "w",
    "wo": "w",
    "write": "w",
    "writeonly": "w",
    "schreiben": "w",
    "ecriture": "w",
    "rw": "rw",
    "wr": "rw",
    "readwrite": "rw",
    "ls": "rw",
    "lesenschreiben": "rw",
    "lesschreib": "rw",
    "le": "rw",
    "lectureecriture": "rw",
}
TYPES = {
    "bool": "bool",
    "boolean": "bool",
    "bit": "bool",
    "string": "string",
    "str": "string",
    "ascii": "string",
    "char": "string",
    "float": "float32",
    "real": "float32",
    "single": "float32",
    "ieee754": "float32",
    "double": "float64",
    "lreal": "float64",
    "word": "uint16",
    "dword": "uint32",
    "qword": "uint64",
    "short": "int16",
    "ushort": "uint16",
    "enum": "uint16",
    "enum16": "uint16",
    "bitfield": "uint16",
    "bitfield16": "uint16",
    "bitfield32": "uint32",
    "float32": "float32",
    "f32": "float32",
    "real32": "float32",
    "float64": "float64",
    "f64": "float64",
}
for _size in (16, 32, 64):
    TYPES |= dict.fromkeys((f"int{_size}", f"s{_size}", f"i{_size}", f"sint{_size}"), f"int{_size}")
    TYPES |= dict.fromkeys((f"uint{_size}", f"u{_size}", f"unsigned{_size}"), f"uint{_size}")

_BRACKETED = re.compile(r"[(\[{]([^()\[\]{}]*)[)\]}]")
"""Innermost brackets alone: an opening one inside would be looked for again from each of those before it."""
_UMLAUTS = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss", "×": "x"})


def squeezed_heading(cell: str) -> str:
    """Return a heading in small letters, words parted by one blank, without accents; umlauts as ae, oe and ue."""
    plain = unicodedata.normalize("NFC", cell).lower().translate(_UMLAUTS)
    plain = "".join(c for c in unicodedata.normalize("NFKD", plain) if not unicodedata.combining(c))
    return re.sub(r"[^a-z0-9]+", " ", plain).strip()


def squeezed(text: str) -> str:
    """Return a cell's letters and digits, small."""
    return squeezed_heading(text).replace(" ", "")


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
    if key is None and "swap" in heading:
        key = "word_swap" if "word" in heading else "byte_swap" if "byte" in heading else "swap"
    if key is None and _ORDERS_BYTES.search(heading):
        key = "order"
    if key is None and (heading in AMBIGUOUS or _CHANGES_A_VALUE.search(heading)):
        key = "?"
    if key in ("scale", "divisor", "offset", "unit") and re.search(r"\d|raw|roh|brut", inside):
        key = "?"  # a formula
    return key, inside
