"""Questions with a default and a check, and the person, file or default that answers them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from hil.start.errors import StopRequest

NONE = "none"
"""Answer for a thing that the rig has not."""


@dataclass(frozen=True, slots=True)
class Question:
    """Question of a step.

    Attributes
    ----------
    key
        Name of its answer in the file of answers.
    text
        Question, as it is shown.
    default
        Answer of an empty line and of `--yes`; None where somebody must say it.
    check
        Returns the answer as it is kept; raises ValueError with the reason why it is refused.
    consent
        Text of all that will be written to a rig; only `yes` at the terminal or this text agrees to it, no default
        and no answer of an earlier call.
    """

    key: str
    text: str
    default: str | None
    check: Callable[[str], str]
    consent: str | None = None


@dataclass(slots=True)
class Answering:
    """Source of answers: given ones first, then those of an earlier call, then defaults or the person at the terminal.

    Attributes
    ----------
    given
        Answers of `--answers` and of options, by key.
    saved
        Answers of earlier calls, by key.
    takes_defaults
        True takes each default without asking.
    say
        Shows a line.
    read
        Shows a prompt and returns a line; raises EOFError where there is no more input.
    """

    given: Mapping[str, str]
    saved: Mapping[str, str]
    takes_defaults: bool
    say: Callable[[str], None]
    read: Callable[[str], str]
    _refused: set[str] = field(default_factory=set)

    def refuse(self, keys: Iterable[str]) -> None:
        """Take no answer for these questions but one of the person at the terminal."""
        self._refused.update(keys)

    def answer(self, question: Question) -> str:
        """Return an answer that the question accepts.

        Raises
        ------
        StopRequest
            Input ended.
        """
        for text in self._known(question):
            try:
                return self._checked(question, text)
            except ValueError as error:
                self.say(f"  {question.key} = {text!r} is refused: {error}")
        default = "" if question.default is None else f" [{question.default}]"
        while True:
            try:
                text = self.read(f"{question.text}{default}: ").strip() or (question.default or "")
            except EOFError:
                raise StopRequest(
                    f"input ended at the question {question.key!r}; answer it with --answers FILE or at a terminal"
                ) from None
            try:
                if not text:
                    raise ValueError("there is no default; type an answer")
                return self._checked(question, question.consent if question.consent and text == "yes" else text)
            except ValueError as error:
                self.say(f"  refused: {error}")

    def _known(self, question: Question) -> Iterator[str]:
        """Yield answers that nobody needs to be asked for."""
        if question.key in self._refused:
            return
        if question.key in self.given:  # where it is refused, no older answer and no default takes its place
            yield self.given[question.key]
            return
        if question.consent is not None:
            return
        if question.key in self.saved:
            yield self.saved[question.key]
        if self.takes_defaults and question.default is not None:
            yield question.default

    @staticmethod
    def _checked(question: Question, text: str) -> str:
        if question.consent is not None:
            if text == question.consent:
                return text
            raise ValueError("only yes at the terminal, or exactly this text as an answer, agrees to writing")
        return question.check(text)


def anything(text: str) -> str:
    """Return any answer."""
    return text


def one_of(*choices: str) -> Callable[[str], str]:
    """Return a check that accepts these words alone."""

    def check(text: str) -> str:
        if text not in choices:
            raise ValueError(f"{text!r} is none of {', '.join(choices)}")
        return text

    return check


def whole(low: int, high: int) -> Callable[[str], str]:
    """Return a check for a whole number from `low` to `high`."""

    def check(text: str) -> str:
        if not (text.isascii() and text.isdigit() and low <= int(text[:9]) <= high):
            raise ValueError(f"{text!r} is no whole number from {low} to {high}")
        return str(int(text))

    return check


def number(low: float, high: float) -> Callable[[str], str]:
    """Return a check for a number from `low` to `high`."""

    def check(text: str) -> str:
        value = _number(text)
        if not low <= value <= high:
            raise ValueError(f"{text} is not from {low:g} to {high:g}")
        return f"{value:g}"

    return check


def limits(text: str) -> str:
    """Return `LOW, HIGH` as it is kept; raise ValueError."""
    if text == NONE:
        return text
    low, comma, high = text.partition(",")
    if not comma or not _number(low) < _number(high):
        raise ValueError(f"{text!r} is no LOW, HIGH with LOW below HIGH; write it like 0, 100, or {NONE}")
    return f"{_number(low):g}, {_number(high):g}"


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{text.strip()!r} is no number") from None
    if not abs(value) < 1e9:
        raise ValueError(f"{text.strip()!r} is no number of a rig")
    return value
