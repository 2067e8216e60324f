"""Rounds of an explanation as data, and their file `explanation.json`, from which `hil explain` continues.

A round is a diagnosis with the records that there are. All rounds but the first have an experiment before it.
"""

from __future__ import annotations

import datetime
import json
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from drivers.rig_file import file_sha256
from hil.files import read_json, replacing

DOCUMENT, PAGE = "explanation.json", "explanation.html"
LEAST_SHARE = 0.005
"""Posterior share from which an explanation is listed: below it no page shows a digit of it."""

Verdict = Literal["adequate", "effect found", "ambiguous", "unexplained"]
End = Literal["settled", "not separable", "no rig", "no more rounds", "declined", "stopped", ""]


class ExplanationError(ValueError):
    """Error of a folder whose explanation cannot be continued; the message states the remedy."""


class _ExplanationPart(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class HashedFile(_ExplanationPart):
    """File that an explanation is about; its hash finds a change."""

    path: str
    sha256: str

    @classmethod
    def of(cls, path: Path) -> HashedFile:
        """Return the file with its hash; raises OSError."""
        return cls(path=str(path.absolute()), sha256=file_sha256(path))


class Belief(_ExplanationPart):
    """Explanation by kind and place, with its drivers: `share` is its posterior probability, None where none is
    given; `size` is that of the answer with its unit, "" of the others."""

    label: str
    share: float | None
    drivers: dict[str, float | None]
    size: str = ""


class SensorErrors(_ExplanationPart):
    """RMSE in K of free runs: baseline twin, re-tuned, with the answer; and the sensor's noise."""

    baseline: float | None
    retuned: float | None
    after: float | None
    noise: float | None


class Experiment(_ExplanationPart):
    """Planned experiment: its load profile, one sentence on its inputs, the reason, and its steps.

    `possible` is False where no input separates the causes; `why` then names a measurement. `rig` is the rig file
    whose limits it keeps, None without one.
    """

    possible: bool
    why: str
    sentence: str = ""
    profile: str = ""
    hours: float = 0.0
    hottest_C: float | None = None
    steps: list[dict[str, float]] = []
    rig: HashedFile | None = None


class Round(_ExplanationPart):
    """Diagnosis with `records` beside the first one; `ran` is the experiment before it, `next` the planned one.

    `after` names the twin of the errors with the answer; `further` holds the errors over each later record.
    """

    number: int
    made: datetime.datetime
    records: list[HashedFile]
    ran: Experiment | None
    verdict: Verdict
    summary: str
    beliefs: list[Belief]
    held_out_s: tuple[float, float]
    after: str
    errors: dict[str, SensorErrors]
    further: dict[str, dict[str, SensorErrors]]
    folder: str
    revision: str | None
    next: Experiment | None


class Explanation(_ExplanationPart):
    """All rounds about one record, and their end: `end` in a word, `reason` in a sentence."""

    record: HashedFile
    twin: HashedFile
    healthy: HashedFile | None
    rounds: list[Round] = []
    end: End = ""
    reason: str = ""

    @property
    def last(self) -> Round:
        """Return the last round; raises IndexError without any."""
        return self.rounds[-1]

    @property
    def experiments(self) -> int:
        """Return the number of rounds that had an experiment."""
        return sum(one.ran is not None for one in self.rounds)

    def ended(self, end: End, reason: str) -> Explanation:
        """Return the explanation with another end."""
        return self.model_copy(update={"end": end, "reason": reason})

    def with_round(self, one: Round) -> Explanation:
        """Return the explanation with a further round, or with another one of that number, and no end yet."""
        before = [other for other in self.rounds if other.number < one.number]
        return self.model_copy(update={"rounds": [*before, one], "end": "", "reason": ""})


def beliefs_of(document: dict[str, Any]) -> list[Belief]:
    """Return the explanations that a `diagnosis.json` leaves open, by kind and place, the likeliest first."""
    drivers: dict[tuple[str, str], dict[str, float | None]] = {}
    for one in (*document["indistinguishable"], *document["alternatives"]):
        if (one["confidence"] or 0.0) >= LEAST_SHARE:
            drivers.setdefault((one["kind"], one["where"]), {})[_words(one["driver"])] = one["confidence"]
    sizes: dict[tuple[str, str], tuple[str, float | None]] = {}
    for effect in document["effects"]:
        key = (effect["kind"], effect["where"])
        drivers.setdefault(key, {}).setdefault(_words(effect["driver"]), effect["confidence"])
        sizes.setdefault(key, (f"{effect['value']:.4g} {effect['unit']}".removesuffix(" 1"), effect["confidence"]))
    found = []
    for (kind, where), each in drivers.items():
        size, share = sizes.get((kind, where), ("", sum(x or 0.0 for x in each.values())))
        label = f"sensor {where}" if kind == "sensor" else _words(f"{kind} at {where}")
        found.append(Belief(label=label, share=share, drivers=each, size=size))
    return sorted(found, key=lambda one: -(one.share or 0.0))


def errors_of(sensors: dict[str, Any]) -> dict[str, SensorErrors]:
    """Return the errors of the sensors of a `diagnosis.json`, K, by sensor."""
    names = {"baseline": "stale", "retuned": "before", "after": "after", "noise": "noise"}
    return {
        sensor: SensorErrors(**{name: errors[key] for name, key in names.items()}) for sensor, errors in sensors.items()
    }


def write_explanation(explanation: Explanation, folder: Path) -> Path:
    """Write `explanation.json` into the folder atomically, and return its path; raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / DOCUMENT
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(explanation.model_dump(mode="json"), indent=1) + "\n", encoding="utf-8")
    return path


def read_explanation(folder: Path) -> Explanation | None:
    """Return the explanation in the folder, None if there is none.

    Raises
    ------
    ExplanationError
        The file is damaged, or no `hil explain` wrote it.
    """
    path, remedy = folder / DOCUMENT, "give another folder with --out, or take the file away to begin anew"
    try:
        document = read_json(path, ExplanationError)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ExplanationError(f"{path} cannot be read ({error.strerror}); {remedy}") from None
    try:
        return Explanation.model_validate(document)
    except ValidationError as error:
        place = ".".join(str(part) for part in error.errors(include_url=False)[0]["loc"]) or "the document"
        raise ExplanationError(f"{path} is not what `hil explain` writes (at {place[:60]!a}); {remedy}") from None


def _words(text: str) -> str:
    return text.replace("_", " ")
