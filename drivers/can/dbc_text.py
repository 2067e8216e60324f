"""Lines of a DBC file that cannot be used, found before cantools reads it: one bad line does not cost the others.

Syntax after Vector's DBC file format: `BO_ id name: length sender` and
`SG_ name [M|mN] : start|length@order sign (factor,offset) [minimum|maximum] "unit" receiver, ...`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from drivers.signals import in_ascii

_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
_MESSAGE = re.compile(r"\s*BO_\s+(?P<id>\d{1,10})\s+(?P<name>\w+)\s*:\s*(?P<length>\d{1,4})\s+\w+\s*")
_SIGNAL = re.compile(
    r"\s*SG_\s+(?P<name>\w+)(?:\s+(?P<multiplexing>M|m\d+M?))?\s*:\s*(?P<start>\d{1,5})\s*\|\s*(?P<length>\d{1,5})\s*@\s*[01]\s*[-+]\s*"
    rf"\(\s*{_NUMBER}\s*,\s*{_NUMBER}\s*\)\s*\[\s*{_NUMBER}\s*\|\s*{_NUMBER}\s*\]\s*"
    r'"(?:[^"\\]|\\.)*"(?P<receivers>[\s\w,]*)'
)
_EXTENDED, _INDEPENDENT = 1 << 31, 0xC0000000
"""Bit of an id of 29 bits, and the id of the message that holds signals which no message carries."""
_INDEPENDENT_NAME = "VECTOR__INDEPENDENT_SIG_MSG"
_LONGEST_SIGNAL = 64
_LAST_BIT = 8 * 1785
"""Bits of the longest message that J1939's transport protocol carries; frames of CAN FD have 512."""


@dataclass(slots=True)
class DbcText:
    """Text of a DBC file with blanks for the lines that cannot be used, and the lines of everything else.

    `left_out` has line and reason of each that was taken out, `messages` and `signals` the lines of the others;
    `multiplexing` has the mark behind a signal's name by message and name: M, m2 or m2M. `renamed` has line and
    sentence of each name that had other letters than a to z, which no name of the format has.
    """

    text: str = ""
    left_out: list[tuple[int, str]] = field(default_factory=list)
    messages: dict[str, int] = field(default_factory=dict)
    signals: dict[tuple[str, str], int] = field(default_factory=dict)
    multiplexing: dict[tuple[str, str], str] = field(default_factory=dict)
    renamed: list[tuple[int, str]] = field(default_factory=list)


def usable(text: str) -> DbcText:
    """Return a DBC file's text without lines of messages and signals that cannot be used; lines keep their numbers."""
    found = DbcText()
    kept: list[str] = []
    message: str | None = None
    in_text = False
    for number, line in enumerate(re.split(r"\r\n|\r|\n", text), 1):
        if not line.isascii():
            written, line = line, _with_ascii_names(line, in_text)
            was, now = _name(written), _name(line)
            if was != now and written.split()[:1] == ["SG_"]:
                found.renamed.append((number, f"{now} is called {was!r} in the file; its names are written in a to z"))
        word = "" if in_text else line.strip().split(maxsplit=1)[0] if line.strip() else ""
        in_text ^= len(re.findall(r'(?<!\\)"', line)) % 2 == 1
        if word == "BO_":
            message, why = _message(line, found)
            if why:
                found.left_out.append((number, why))
            elif message is not None:
                found.messages[message] = number
        elif word == "SG_":
            why = _signal(line, message, found) if message is not None else ""
            if why:
                found.left_out.append((number, why))
            elif message is not None:
                found.signals[message, _name(line)] = number
                parts = _SIGNAL.fullmatch(line)
                if parts is not None and parts["multiplexing"]:
                    found.multiplexing[message, parts["name"]] = parts["multiplexing"]
        else:
            why = ""
        unused = why or (word == "SG_" and message is None)
        in_text = in_text and not unused
        kept.append("" if unused else line)
    found.text = "\n".join(kept)
    return found


def _with_ascii_names(line: str, in_text: bool) -> str:
    """Return a line whose words outside quotes are in the letters a to z."""
    parts = re.split(r'(?<!\\)"', line)
    return '"'.join(
        part if (number % 2 == 1) != in_text else re.sub(r"[^\x00-\x7f]", "_", in_ascii(part))
        for number, part in enumerate(parts)
    )


def _message(line: str, found: DbcText) -> tuple[str | None, str]:
    """Return the name of a message, or None and why it is left out."""
    parts = _MESSAGE.fullmatch(line)
    if parts is None:
        return None, f"{_name(line, 2)}: is no message, BO_ ID NAME: LENGTH SENDER; correct the line"
    identifier, name = int(parts["id"]), parts["name"]
    if identifier == _INDEPENDENT:
        return name, ""
    bits = 29 if identifier & _EXTENDED else 11
    if identifier & ~_EXTENDED >= 1 << bits or identifier >= 1 << 32:
        return None, f"{name}: id {identifier} has more than {bits} bits; correct it"
    if name in found.messages:
        return None, f"{name}: a second message of this name (line {found.messages[name]}); rename one"
    return name, ""


def _signal(line: str, message: str | None, found: DbcText) -> str:
    """Return why a signal is left out, empty where it is not."""
    name = _name(line)
    if message == _INDEPENDENT_NAME:
        return f"{name}: no message carries it; move it into one"
    parts = _SIGNAL.fullmatch(line)
    if parts is None:
        return f"{name}: is no signal as DBC files have them; correct the line"
    if not parts["receivers"].strip(" ,\t"):
        return f"{name}: names no receiver after its unit; add one, Vector__XXX where it is nobody's"
    if not 1 <= int(parts["length"]) <= _LONGEST_SIGNAL:
        return f"{name}: has {int(parts['length'])} bits, and a signal has 1 to {_LONGEST_SIGNAL}; correct it"
    if int(parts["start"]) >= _LAST_BIT:
        return f"{name}: starts at bit {int(parts['start'])}, and no frame has more than {_LAST_BIT}; correct it"
    if (message, name) in found.signals:
        return f"{name}: a second signal of this name in {message}; rename one"
    return ""


def _name(line: str, position: int = 1) -> str:
    words = line.replace(":", " ").split()
    return words[position] if len(words) > position else "a line"
