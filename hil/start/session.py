"""Whole course: each step explained, asked and run in turn, and gone on with where an earlier call stopped."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from hil.files import held
from hil.start.errors import StartError, StopRequest
from hil.start.questions import Answering
from hil.start.steps import OUTPUTS, STEPS, Course, Step
from hil.start.store import SCRIPT, Store

_REFUSED = 2
"""Exit code of a command that wants its input corrected."""


@dataclass(frozen=True, slots=True)
class StartRequest:
    """Course that a user asks for.

    Attributes
    ----------
    folder
        Folder of all its files.
    virtual
        Touch no rig.
    source
        Register table, configuration or rig file; None asks.
    given
        Answers by key.
    takes_defaults
        Take defaults without asking.
    """

    folder: Path
    virtual: bool = False
    source: str | None = None
    given: Mapping[str, str] | None = None
    takes_defaults: bool = False


def start(request: StartRequest, say: Callable[[str], None], read: Callable[[str], str]) -> None:
    """Lead through the course.

    Parameters
    ----------
    request
        Folder and given answers.
    say
        Gets lines for the person.
    read
        Shows a prompt and returns an answer; raises EOFError at the end of input.

    Raises
    ------
    StartError
        The folder holds foreign files, another process leads a course in it, or an answer is for no question.
    StopRequest
        The course stopped: end of input, a signal, a command that failed. A second call goes on.
    """
    with held(request.folder.absolute(), StartError):
        _lead(request, say, read)


def _lead(request: StartRequest, say: Callable[[str], None], read: Callable[[str], str]) -> None:
    given = dict(request.given or {})
    if request.source is not None:
        given["source"] = request.source
    store = Store(request.folder, tuple(name for name in OUTPUTS if name != given.get("source")))
    was_virtual = store.answers.pop("virtual", None)
    virtual = request.virtual or (given.pop("virtual", was_virtual) == "yes")
    if was_virtual is not None and (was_virtual == "yes") != virtual:
        kind = "without a rig (--virtual)" if was_virtual == "yes" else "on a rig"
        raise StartError(f"this folder has a course {kind}; begin another one in another folder")
    store.keep("virtual", "yes" if virtual else "no")
    course = Course(request.folder, virtual)
    answering = Answering(given, store.answers, request.takes_defaults, say, read)
    for number, step in enumerate(STEPS, 1):
        if step.applies(course):
            say(f"\n{number}. {step.title}")
            _take(step, course, answering, store)
    unused = sorted(set(given) - set(course.answers))
    if unused:
        say(f"note: no question of this course is {', '.join(unused)}; these answers were not used")
    say(f"\nDone. `bash {SCRIPT}` in an empty folder with your table does the same.")


def _take(step: Step, course: Course, answering: Answering, store: Store) -> None:
    """Ask and run one step; a command that refuses an answer has the step asked again. Raises StopRequest."""
    say = answering.say
    say(step.why)
    while True:
        was_done = step.name in store.done
        asked = _ask(step, course, answering, store, was_done=was_done)
        actions = step.actions(course)
        lines = "\n".join(action.in_shell() for action in actions)
        if store.is_done(step.name, lines):
            say("done before")
            return
        if was_done:  # its commands differ now: what was agreed to before does not count
            continue
        code = 0
        for action in actions:
            code = action.run(course.folder, say)
            if code not in getattr(action, "accepted", (0,)):
                break
        else:
            store.finish(step.name, lines)
            return
        if code != _REFUSED or not asked:
            raise StopRequest(f"step {step.name!r} ended with exit code {code}; correct what it names", code)
        say("These answers are refused; give them again.")
        answering.refuse(asked)


def _ask(step: Step, course: Course, answering: Answering, store: Store, *, was_done: bool) -> list[str]:
    """Ask the questions of a step, save each answer at once; return their keys. Raises StopRequest.

    A step that is done is not agreed to again.
    """
    asked: list[str] = []
    questions = step.questions(course)
    answer: str | None = None
    while True:
        try:
            question = next(questions) if answer is None else questions.send(answer)
        except StopIteration:
            return asked
        agreed = was_done and question.consent is not None and store.answers.get(question.key) == question.consent
        answer = question.consent if agreed and question.consent is not None else answering.answer(question)
        asked.append(question.key)
        course.answers[question.key] = answer
        if store.answers.get(question.key) != answer:
            store.keep(question.key, answer)
