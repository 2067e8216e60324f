"""Test plan: TOML file of a profile, named steps and limits, each limit with a requirement and a severity."""

from __future__ import annotations

import difflib
import hashlib
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from drivers.rig_file import line_of, mistake, read_regular, tables_of
from hil.testing.limits import NoEffect, Sentence, SentenceError, Window, parse, parse_time

Severity = Literal["critical", "major", "minor"]
SEVERITIES: tuple[Severity, ...] = ("minor", "major", "critical")
"""Severities, the least first."""
_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.:-]*")
_FILES = ("profile", "rig", "twin")
_STAND_INS = {
    "step": {"name": "step-{}", "from": "0 s", "to": "1 s"},
    "limit": {"id": "limit-{}", "limit": "no trip", "requirement": "none"},
}
"""Values in place of mistaken ones, with which the rest of a plan is checked."""


class TestPlanError(ValueError):
    """Error of a test plan; one sentence in each line, with file, line and remedy."""

    __test__ = False  # no class of tests


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


def _checked_id(text: str) -> str:
    if not _ID.fullmatch(text):
        raise ValueError(f"{text!r} must be letters, digits and _ . : - only, so that results can name it; rename it")
    return text


_Id = Annotated[str, AfterValidator(_checked_id)]


class StepSection(_Strict):
    """Step of a test: a named part of the profile, `from` and `to` in profile time."""

    name: Annotated[str, Field(min_length=1)]
    from_: Annotated[str, Field(alias="from")]
    to: str


class LimitSection(_Strict):
    """Limit of a test: a sentence, with the requirement that it verifies and its severity."""

    id: _Id
    limit: str
    requirement: Annotated[str, Field(min_length=1)]
    severity: Severity = "major"
    step: str | None = None
    gap_at_most: str = "0 s"
    note: str = ""


class PlanSection(_Strict):
    """Content of a plan file."""

    id: _Id
    title: str = ""
    profile: str | None = None
    rig: str | None = None
    twin: str | None = None
    trip_on: Severity | None = None
    step: Annotated[tuple[StepSection, ...], Field(strict=False)] = ()
    limit: Annotated[tuple[LimitSection, ...], Field(min_length=1, strict=False)]


@dataclass(frozen=True, slots=True)
class Step:
    """Named part of a profile, s of profile time; `place` is its file and line."""

    name: str
    from_s: float
    to_s: float
    place: str


@dataclass(frozen=True, slots=True)
class Limit:
    """Limit of a plan. `place` is its file and line, `gap_at_most_s` the longest time without a good value, s."""

    id: str
    text: str
    sentence: Sentence
    requirement: str
    severity: Severity
    step: str | None
    gap_at_most_s: float
    place: str


@dataclass(frozen=True, slots=True)
class Plan:
    """Test plan, read and checked in itself.

    `profile`, `rig` and `twin` are paths, None where the plan names none; `place` is file and line of `profile`. A
    failed limit of severity `trip_on` or above trips a live run; None trips on none.
    """

    id: str
    title: str
    path: Path
    sha256: str
    profile: Path | None
    rig: Path | None
    twin: Path | None
    trip_on: Severity | None
    place: str
    steps: tuple[Step, ...]
    limits: tuple[Limit, ...]

    def trips(self, limit: Limit) -> bool:
        """Return True for a limit that trips a live run when it fails."""
        return self.trip_on is not None and SEVERITIES.index(limit.severity) >= SEVERITIES.index(self.trip_on)

    @property
    def needs_diagnosis(self) -> bool:
        """True where a limit judges the diagnosis of the run."""
        return any(isinstance(limit.sentence.statement, NoEffect) for limit in self.limits)


def read_plan(path: Path) -> Plan:
    """Read the test plan in the TOML file at `path`; raise TestPlanError with a sentence for every mistake."""
    try:
        content = read_regular(path)
        text, document = tables_of(content)
    except OSError as error:
        raise TestPlanError(f"{path} cannot be read ({error.strerror}); give the path of a test plan") from error
    except ValueError as error:
        raise TestPlanError(f"{path} {error}") from None
    problems: list[str] = []
    read = _checked(path, text, document, problems)
    files = _paths(path, text, read, problems)
    steps = _steps(path, text, read, problems)
    limits = _limits(path, text, read, {step.name: step for step in steps}, problems)
    if problems:
        raise TestPlanError("\n".join(problems))
    digest = hashlib.sha256(content).hexdigest()
    return Plan(
        id=read.id,
        title=read.title or read.id,
        path=path,
        sha256=digest,
        **files,
        trip_on=read.trip_on,
        place=f"{path}, line {line_of(text, ('profile',))}",
        steps=steps,
        limits=limits,
    )


def _checked(path: Path, text: str, document: dict[str, Any], problems: list[str]) -> PlanSection:
    """Return the content of a plan; each mistake is added to `problems` and replaced, so that later checks go on.

    Raises
    ------
    TestPlanError
        The plan has no limit, or its steps or limits are no tables.
    """
    try:
        return PlanSection.model_validate(document)
    except ValidationError as error:
        items = [item for item in error.errors() if item["type"] != "too_short" or not document.get("limit")]
    problems += [_sentence(path, text, document, item) for item in items]
    try:
        return PlanSection.model_validate(_replaced(document, [tuple(item["loc"]) for item in items]))
    except ValidationError:
        raise TestPlanError("\n".join(problems)) from None


def _replaced(document: dict[str, Any], wrong: list[tuple[int | str, ...]]) -> dict[str, Any]:
    """Return a plan's tables without the values at the places `wrong`, and with stand-ins of those that it needs."""
    whole = {key: value for key, value in document.items() if (key,) not in wrong}
    for name, stand_ins in _STAND_INS.items():
        tables = whole.get(name, [])
        if not isinstance(tables, list) or not all(isinstance(each, dict) for each in tables):
            continue
        kept = [
            {key: value for key, value in each.items() if (name, number, key) not in wrong}
            for number, each in enumerate(tables)
        ]
        whole[name] = [
            {key: value.format(number) for key, value in stand_ins.items()} | each for number, each in enumerate(kept)
        ]
    return {"id": "plan"} | whole


def _sentence(path: Path, text: str, document: dict[str, Any], item: Any) -> str:
    place = tuple(item["loc"])
    owner = ""
    if len(place) > 1 and place[0] in ("limit", "step") and isinstance(place[1], int):
        tables = document[place[0]]
        named = tables[place[1]].get("id" if place[0] == "limit" else "name") if place[1] < len(tables) else None
        owner = f" of {place[0]} {named if isinstance(named, str) and named else place[1] + 1}"
    keys = ".".join(str(part) for part in place if not isinstance(part, int))
    keys = keys.partition(".")[2] or keys if owner else keys
    if item["type"] == "too_short":
        return f"{path}, line 1: the plan has no [[limit]]; add one"
    return f"{path}, line {line_of(text, place)}: {keys}{owner}: {_remedy(place, item)}"


def _remedy(place: tuple[int | str, ...], item: Any) -> str:
    """Return the mistake with its remedy; for a key that is not known, the nearest one."""
    said = mistake(item)
    if place in (("step",), ("limit",)) and item["type"] != "missing" and isinstance(item["input"], dict):
        return f"is one table; begin each with [[{place[0]}]]"
    if item["type"] != "extra_forbidden":
        return said
    sections: dict[str, type[BaseModel]] = {"step": StepSection, "limit": LimitSection}
    model = sections.get(str(place[0]), PlanSection) if len(place) > 1 else PlanSection
    keys = [field.alias or name for name, field in model.model_fields.items()]
    near = difflib.get_close_matches(str(place[-1]), keys, n=1)
    return f"is not a key of this section; did you mean {near[0]}?" if near else f"{said}; it has {', '.join(keys)}"


def _paths(path: Path, text: str, read: PlanSection, problems: list[str]) -> dict[str, Path | None]:
    """Return the files that the plan names, relative to it."""
    found: dict[str, Path | None] = {}
    for key in _FILES:
        named = getattr(read, key)
        found[key] = None if named is None else _plain(path.parent / named)
        if found[key] is not None and not found[key].is_file():  # type: ignore[union-attr]
            problems.append(
                f"{path}, line {line_of(text, (key,))}: {key}: there is no file {found[key]}; correct the path, which "
                "begins at the plan's folder"
            )
    return found


def _plain(path: Path) -> Path:
    """Return a path without `..`, unless a link makes that another file."""
    plain = Path(os.path.normpath(path))
    return plain if plain.is_file() and path.is_file() and plain.samefile(path) else path


def _steps(path: Path, text: str, read: PlanSection, problems: list[str]) -> tuple[Step, ...]:
    steps: dict[str, Step] = {}
    for number, section in enumerate(read.step):
        line = f"{path}, line {line_of(text, ('step', number))}"
        place = f"{line}: step {section.name}"
        try:
            step = Step(section.name, parse_time(section.from_), parse_time(section.to), line)
        except SentenceError as error:
            problems.append(f"{place}: a time {error}")
            continue
        if not step.from_s < step.to_s:
            problems.append(f"{place} ends at {step.to_s:g} s, not after its beginning; correct the times")
        if section.name in steps:
            problems.append(f"{place} is there twice; give each step its own name")
        steps[section.name] = step
    return tuple(steps.values())


def _limits(path: Path, text: str, read: PlanSection, steps: dict[str, Step], problems: list[str]) -> tuple[Limit, ...]:
    limits: dict[str, Limit] = {}
    for number, section in enumerate(read.limit):
        place = f"{path}, line {line_of(text, ('limit', number, 'limit'))}"
        owner = f"{place}: limit {section.id}"
        try:
            sentence = parse(section.limit)
        except SentenceError as error:
            problems.append(f"{owner}: {section.limit!r} {error}")
            continue
        try:
            gap_s = parse_time(section.gap_at_most)
        except SentenceError as error:
            problems.append(f"{owner}: gap_at_most {error}")
            continue
        if section.id in limits:
            problems.append(f"{owner} is there twice; give each limit its own id")
        if section.step is not None:
            problem, sentence = _in_step(section, sentence, steps)
            if problem:
                problems.append(f"{owner}: {problem}")
        limits[section.id] = Limit(
            section.id, section.limit, sentence, section.requirement, section.severity, section.step, gap_s, place
        )
    return tuple(limits.values())


def _in_step(section: LimitSection, sentence: Sentence, steps: dict[str, Step]) -> tuple[str, Sentence]:
    """Return the problem of a limit's step, "" for none, and the sentence with the times of the step."""
    assert section.step is not None
    step = steps.get(section.step)
    if step is None:
        return f"there is no step {section.step!r}; there are {', '.join(steps) or 'none'}", sentence
    if isinstance(sentence.statement, NoEffect):
        return f"{section.limit!r} judges the whole run; take `step` out", sentence
    window = sentence.window
    if window.from_s is not None or window.to_s is not None:
        return "it has times and a step; keep one of them", sentence
    return "", Sentence(sentence.statement, Window(step.from_s, step.to_s, window.while_))
