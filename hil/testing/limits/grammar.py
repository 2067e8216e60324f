"""Grammar of limits: sentences of a test plan, parsed by recursive descent; nothing is evaluated as code.

sentence  = statement { condition }
statement = quantity bound
          | NAME "settles" "within" TIME "to" AMOUNT [ "of" AMOUNT ]
          | NAME "measured" "within" AMOUNT "of" "set-point" [ "once" "constant" "for" TIME ]
          | ( "rmse" | "bias" | "largest" "error" ) "of" NAME "at" NAME bound
          | "no" "effect" "found" | "no" "trip" | "trip" [ "of" NAME ]
quantity  = NAME
          | ( "mean" | "max" | "min" | "deviation" | "range" ) "of" NAME
          | NUMBER "th" "percentile" "of" NAME
          | ( "time" | "longest" "time" ) "of" NAME ( "above" | "below" ) AMOUNT
          | ( "ramp" | "rise" | "fall" ) "of" NAME [ "over" TIME ]
bound     = ( "<" | "<=" | ">" | ">=" ) AMOUNT | "between" AMOUNT "and" AMOUNT
condition = "from" TIME "to" TIME | "after" TIME | "before" TIME | "while" NAME bound ; one begin, end and "while"
AMOUNT    = NUMBER [ UNIT ]
TIME      = NUMBER ( "ms" | "s" | "min" | "h" | "d" )

Words may begin with a capital letter; names and units are taken as they are.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Literal, NoReturn

from hil.testing.limits.statements import (
    TIMES_S,
    Amount,
    Bound,
    Compared,
    Follows,
    Measure,
    NoEffect,
    NoTrip,
    Operator,
    Sentence,
    Settles,
    Statement,
    Trips,
    TwinError,
    While,
    Window,
)

LONGEST = 400
"""Most characters of a limit; a longer one is no sentence."""
_TOKEN = re.compile(
    r"\s*(?:(?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)|(?P<operator><=|>=|[<>≤≥=]+)|(?P<word>[^\s<>≤≥=]+))"
)
_OPERATORS: dict[str, Operator] = {"<": "<", "<=": "<=", "≤": "<=", ">": ">", ">=": ">=", "≥": ">="}
_STATISTICS: dict[str, Measure] = {
    "mean": "mean",
    "average": "mean",
    "max": "max",
    "maximum": "max",
    "min": "min",
    "minimum": "min",
    "deviation": "deviation",
    "range": "range",
}
_ORDINALS = ("th", "st", "nd", "rd")
_RAMPS = {"ramp": 0, "rise": 1, "fall": -1}
_CONDITIONS = ("from", "after", "before", "while")
_KEYWORDS = (*_CONDITIONS, "and", "of", "to", "at", "over", "once", "within", "between", "for", "in", "during")


class SentenceError(ValueError):
    """Sentence that is no limit; the message names the place in it and the remedy."""


def parse(text: str) -> Sentence:
    """Return the statement and the window of a limit; raise SentenceError."""
    if len(text) > LONGEST:
        raise SentenceError(f"is {len(text)} characters long, at most {LONGEST} are read; split it into several limits")
    return _Parser(text).sentence()


def parse_time(text: str) -> float:
    """Return a time such as `90 s`, `10 min` or `1.5 h` in s; raise SentenceError."""
    parser = _Parser(text)
    time_s = parser.time()
    parser.end()
    return time_s


class _Parser:
    def __init__(self, text: str) -> None:
        self._tokens: list[tuple[str, str]] = []
        at = 0
        while match := _TOKEN.match(text, at):
            kind = str(match.lastgroup)
            self._tokens.append((kind, match[kind]))
            at = match.end()
        self._at = 0

    # Tokens --------------------------------------------------------------------------------------

    def _peek(self, ahead: int = 0) -> str:
        index = self._at + ahead
        return self._tokens[index][1] if index < len(self._tokens) else ""

    def _kind(self) -> str:
        return self._tokens[self._at][0] if self._at < len(self._tokens) else "end"

    def _take(self) -> str:
        token = self._peek()
        self._at += 1
        return token

    def _accept(self, *words: str) -> bool:
        if tuple(self._peek(k).lower() for k in range(len(words))) != words:
            return False
        self._at += len(words)
        return True

    def _expect(self, *words: str) -> None:
        for word in words:
            if not self._accept(word):
                self._fail(f"{word!r}")

    def _fail(self, wanted: str) -> None:
        found = repr(self._peek()) if self._kind() != "end" else "its end"
        before = f" after {self._tokens[self._at - 1][1]!r}" if 0 < self._at <= len(self._tokens) else ""
        raise SentenceError(f"has {found}{before}; write {wanted} there")

    def end(self) -> None:
        """Raise SentenceError where a token is left."""
        if self._kind() != "end":
            after = repr(self._tokens[self._at - 1][1])
            raise SentenceError(
                f"has {self._peek()!r} after {after}; end the limit there, go on with {', '.join(_CONDITIONS)}, or "
                "write another limit"
            )

    # Parts ---------------------------------------------------------------------------------------

    def _number(self, what: str = "a number") -> float:
        if self._kind() != "number":
            self._fail(what)
        written = self._take()
        number = float(written)
        if not math.isfinite(number):
            raise SentenceError(f"has the number {written}, which is too large; write one below 1e308")
        if self._peek().startswith(","):
            raise SentenceError(
                f"has a comma in {number:g}{self._peek()}; write a decimal point, without thousands marks"
            )
        return number

    def _unit(self) -> str | None:
        is_unit = self._kind() == "word" and self._peek() not in _KEYWORDS
        unit = self._take() if is_unit else None
        return "%" if unit == "percent" else unit

    def _amount(self) -> Amount:
        return Amount(self._number("a number with its unit"), self._unit())

    def time(self) -> float:
        """Return a time in s."""
        number = self._number("a time such as 120 s")
        unit = self._peek()
        if unit not in TIMES_S:
            self._fail(f"a unit of time, one of {', '.join(TIMES_S)},")
        self._take()
        if number < 0.0:
            raise SentenceError(f"has the negative time {number:g} {unit}; times count from the profile's beginning")
        time_s = number * TIMES_S[unit]
        if not math.isfinite(time_s):
            raise SentenceError(f"has the time {number:g} {unit}, which is too long; write a shorter one")
        return time_s

    def _name(self) -> str:
        if self._kind() != "word" or self._peek() in _KEYWORDS:
            self._fail("the name of a signal")
        return self._take()

    def _bound(self) -> Bound:
        if self._accept("between"):
            low = self._amount()
            self._expect("and")
            high = self._amount()
            low = Amount(low.number, low.unit or high.unit)
            if not low.number < high.number and low.unit == high.unit:
                raise SentenceError(f"is between {low} and {high}, which holds nothing; write the lesser one first")
            return Bound(">=", low, high)
        if self._peek() not in _OPERATORS:
            self._fail("one of <, <=, >, >= or between")
        return Bound(_OPERATORS[self._take()], self._amount())

    # Statements ----------------------------------------------------------------------------------

    def sentence(self) -> Sentence:
        """Return the whole sentence."""
        if self._kind() == "end":
            raise SentenceError("is empty; write a limit such as T_tank_C < 60")
        statement = self._statement()
        window = self._window()
        self.end()
        return Sentence(statement, window)

    def _statement(self) -> Statement:
        if self._accept("no", "effect", "found"):
            return NoEffect()
        if self._accept("no", "trip"):
            return NoTrip()
        if self._peek().lower() == "trip" and self._peek(1).lower() in ("", "of", *_CONDITIONS):
            self._take()
            return Trips(self._name() if self._accept("of") else None)
        kinds: tuple[tuple[tuple[str, ...], Literal["rmse", "bias", "largest"]], ...] = (
            (("rmse", "of"), "rmse"),
            (("bias", "of"), "bias"),
            (("largest", "error", "of"), "largest"),
        )
        for words, kind in kinds:
            if self._accept(*words):
                self._accept("the")
                twin = self._name()
                self._expect("at")
                return TwinError(kind, twin, self._name(), self._bound())
        if self._kind() == "word" and self._peek(1) == "settles":
            return self._settles()
        if self._kind() == "word" and self._peek(1) == "measured":
            return self._follows()
        return self._compared()

    def _settles(self) -> Settles:
        name = self._name()
        self._expect("settles", "within")
        within_s = self.time()
        self._expect("to")
        band = self._amount()
        target = self._amount() if self._accept("of") else None
        if within_s <= 0.0 or band.number <= 0.0:
            raise SentenceError("settles in no time or to no band; write positive numbers")
        return Settles(name, within_s, band, target)

    def _follows(self) -> Follows:
        name = self._name()
        self._expect("measured", "within")
        band = self._amount()
        self._expect("of")
        self._accept("its")
        if not (self._accept("set-point") or self._accept("setpoint") or self._accept("set", "point")):
            self._fail("'set-point'")
        constant_s = None
        if self._accept("once", "constant", "for"):
            constant_s = self.time()
        if band.number <= 0.0:
            raise SentenceError(f"has a band of {band}; write a positive number")
        return Follows(name, band, constant_s)

    def _compared(self) -> Compared:
        if self._kind() == "number":
            percent = self._number()
            if not (self._peek() in _ORDINALS and self._peek(1) == "percentile" and self._peek(2) == "of"):
                self._fail(
                    "a signal first, as in T_tank_C < 60, or a percentile, as in 95th percentile of T_tank_C < 60;"
                )
            self._at += 3
            if not 0.0 <= percent <= 100.0:
                raise SentenceError(f"has the {percent:g}th percentile; write one from 0 to 100")
            return Compared("percentile", self._name(), self._bound(), percent=percent)
        word = self._peek().lower()
        if word in _STATISTICS and self._peek(1) == "of":
            self._at += 2
            return Compared(_STATISTICS[word], self._name(), self._bound())
        if word in _RAMPS and self._peek(1) == "of":
            self._at += 2
            name = self._name()
            over_s = self.time() if self._accept("over") else None
            return Compared("ramp", name, self._bound(), over_s=over_s, direction=_RAMPS[word])
        longest = self._accept("longest", "time", "of")
        if longest or self._accept("time", "of"):
            name = self._name()
            side: Operator = ">" if self._accept("above") else "<"
            if side == "<":
                self._expect("below")
            threshold = Bound(side, self._amount())
            return Compared("longest" if longest else "time", name, self._bound(), threshold=threshold)
        if self._kind() == "word" and self._peek(1).lower() == "of":
            known = ", ".join([*dict.fromkeys(_STATISTICS.values()), "50th percentile", "time", *_RAMPS])
            raise SentenceError(f"asks for the {word} of a signal, which is not known; there are {known}")
        return Compared("value", self._name(), self._bound())

    def _window(self) -> Window:
        begin: _Clause | None = None
        end: _Clause | None = None
        condition: While | None = None
        while (word := self._peek().lower()) in _CONDITIONS:
            at = self._at
            self._take()
            if word == "while":
                said = While(self._name(), self._bound())
                if condition is not None:
                    self._refuse_second(at, f"while {condition.signal} {condition.bound}", "condition")
                condition = said
                continue
            first = self.time()
            last = first
            if word == "from":
                self._expect("to")
                last = self.time()
            if word in ("from", "after"):
                if begin is not None:
                    self._refuse_second(at, begin.text, "begin")
                begin = _Clause(self._text(at), first)
            if word in ("from", "before"):
                if end is not None:
                    self._refuse_second(at, end.text, "end")
                end = _Clause(self._text(at), last)
        from_s, to_s = (None if clause is None else clause.time_s for clause in (begin, end))
        if from_s is not None and to_s is not None and not from_s < to_s:
            raise SentenceError(f"ends at {to_s:g} s, not after its beginning at {from_s:g} s; correct the times")
        return Window(from_s, to_s, condition)

    def _text(self, at: int) -> str:
        """Return the words from token `at` up to the present one."""
        return " ".join(text for _, text in self._tokens[at : self._at])

    def _refuse_second(self, at: int, first: str, what: str) -> NoReturn:
        raise SentenceError(
            f"has a second {what}, {self._text(at)!r} after {first!r}; write one, and another limit for the other"
        )


@dataclass(frozen=True, slots=True)
class _Clause:
    """Clause of a sentence with a time, s."""

    text: str
    time_s: float
