"""Steps of the course from a register table to a diagnosis, as data: explanation, questions and commands of each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from hil.start.actions import Action, Command, FileAction, Newest, Removal
from hil.start.errors import StopRequest
from hil.start.loads import load_text, written_text
from hil.start.points import Asked, point_questions, quoted
from hil.start.questions import NONE, Question, anything, one_of, whole

BUILT_IN = "virtual"
"""Answer that takes the built-in virtual rig."""
_BUILT_IN_RIG = "profiles/rigs/virtual.toml"
DRAFT, RIG, SERVED, LOAD, HEALTHY, TWIN = (
    "draft.toml",
    "rig.toml",
    "served.toml",
    "load.csv",
    "healthy.csv",
    "twin.toml",
)
_HEALTHY_RECORD = "twin.healthy.parquet"
OUTPUTS = (DRAFT, RIG, SERVED, LOAD, HEALTHY, TWIN, _HEALTHY_RECORD)
"""Files that the course writes beside its answers and its script."""
_TABLES = (".csv", ".tsv", ".txt")
_SOURCES = (*_TABLES, ".toml", ".conf", ".yaml", ".yml", ".dbc")
_TRIAL, _HEALTHY = (1.0, 4), (10.0, 1)
"""Duration in h and pace of the generated load profiles; the second lasts as long as the shipped commissioning."""


@dataclass(slots=True)
class Course:
    """Course in a folder: what was answered so far.

    Attributes
    ----------
    folder
        Folder of all its files.
    virtual
        True if no step may touch a rig.
    answers
        Answers of this call, by key.
    settings
        Keys of points that the answers gave, for `hil init --set`.
    """

    folder: Path
    virtual: bool
    answers: dict[str, str] = field(default_factory=dict)
    settings: list[str] = field(default_factory=list)

    @property
    def is_built_in(self) -> bool:
        """True for the built-in virtual rig."""
        return self.answers.get("source") == BUILT_IN

    @property
    def is_rig_file(self) -> bool:
        """True if a rig file was given in the place of a table."""
        return _is_rig_file(self.folder / self.answers["source"])

    @property
    def rig(self) -> str:
        """Rig file of all commands after the second step."""
        return _BUILT_IN_RIG if self.is_built_in else self.answers["source"] if self.is_rig_file else RIG

    @property
    def simulated(self) -> tuple[str, ...]:
        """Options of `hil run` that keep it off a rig; none where it is to run on one."""
        return ("--virtual", "--lockstep") if self.virtual or self.is_built_in else ()

    def path(self, text: str) -> Path:
        """Return the path of a file of this folder, or of a shipped one."""
        path = self.folder / text
        return path if path.exists() else Path(__file__).resolve().parents[2] / text


@dataclass(frozen=True, slots=True)
class Step:
    """Step of the course.

    Attributes
    ----------
    name
        Name in the file of answers and in the script.
    title
        Heading.
    why
        Explanation, sentences.
    applies
        Returns False for a step that a course has not.
    questions
        Yields its questions and gets their answers.
    actions
        Returns its actions, when all questions are answered.
    """

    name: str
    title: str
    why: str
    applies: Callable[[Course], bool]
    questions: Callable[[Course], Asked]
    actions: Callable[[Course], list[Action]]


def _always(_: Course) -> bool:
    return True


def _on_a_rig(course: Course) -> bool:
    return not course.simulated


def _of_a_table(course: Course) -> bool:
    return not course.is_built_in and not course.is_rig_file


def _no_questions(_: Course) -> Asked:
    yield from ()


def _is_rig_file(path: Path) -> bool:
    from drivers.rig_file import read_regular, tables_of

    try:
        return path.suffix == ".toml" and "point" in tables_of(read_regular(path))[1]
    except (OSError, ValueError):
        return False


# 1, describe ----------------------------------------------------------------------------------------------------------


def _source_questions(course: Course) -> Asked:
    def check(text: str) -> str:
        if text == BUILT_IN:
            return text
        path = course.folder / text
        if not path.is_file():
            raise ValueError(f"{text}: there is no such file; `hil init` writes a rig file without a table")
        if path.suffix.lower() not in _SOURCES:
            raise ValueError(f"{text} is none of {', '.join(_SOURCES)}")
        written = [name for name in OUTPUTS if name not in (DRAFT, RIG) or not _is_rig_file(path)]
        if path.resolve() in [(course.folder / name).resolve() for name in written]:
            raise ValueError(f"{text} is a file that this course writes, and yours would be lost; give it another name")
        return text

    text = (
        "Register table (.csv), configuration of Telegraf or Home Assistant, .dbc file or rig file; "
        f"{BUILT_IN} is the built-in virtual rig"
    )
    source = yield Question("source", text, BUILT_IN if course.virtual else None, check)
    if source == BUILT_IN or course.is_rig_file or Path(source).suffix.lower() not in _TABLES:
        return
    text = "First holding register of the table: zero (0), one (1) or modicon (40001)"
    yield Question("addressing", text, None, one_of("zero", "one", "modicon"))
    yield Question("host", "Host of the Modbus device", "127.0.0.1", anything)
    yield Question("port", "TCP port of the Modbus device", "502", whole(1, 65535))
    yield Question("device_id", "Unit id of the Modbus device", "1", whole(0, 255))


def _import_words(course: Course) -> tuple[str, ...]:
    answers = course.answers
    words = ["init", "--from", answers["source"]]
    for key in ("addressing", "host", "port", "device_id"):
        if Path(answers["source"]).suffix.lower() in _TABLES:
            words += [f"--{key.replace('_', '-')}", answers[key]]
    return tuple(words)


def _describe(course: Course) -> list[Action]:
    if not _of_a_table(course):
        return []
    return [Command((*_import_words(course), "--force", "--out", DRAFT))]


# 2, roles, limits, read-backs, heartbeat ------------------------------------------------------------------------------


def _point_questions(course: Course) -> Asked:
    from drivers.rig_file import load_rig

    course.settings.clear()
    yield from point_questions(load_rig(course.folder / DRAFT), course.settings)


def _complete(course: Course) -> list[Action]:
    return [Command((*_import_words(course), *quoted(course.settings), "--force", "--out", RIG))]


# 3, check; 4, trial without the rig -----------------------------------------------------------------------------------


def _check(course: Course) -> list[Action]:
    return [Command(("check", course.rig))]


def _profile(course: Course, key: str, text: str, shipped: str, generated: str) -> Question:
    def check(answer: str) -> str:
        from hil.profile import read_profile

        if answer != generated:
            read_profile(course.path(_file(course, answer)))
        return answer

    return Question(key, text, shipped if course.is_built_in else generated, check)


def _load_questions(course: Course) -> Asked:
    from drivers.rig_file import load_rig

    if not load_rig(course.path(course.rig)).setpoints:
        raise StopRequest(
            f"{course.rig} has no point with limits, so that no profile can drive it; give one its limits"
        )
    text = f"Load profile of the trial; {LOAD} is made from the limits"
    yield _profile(course, "load", text, "profiles/loads/battle_10h.csv", LOAD)


def _generated(course: Course, answer: str, name: str, shape: tuple[float, int]) -> list[Action]:
    """Return the file of a generated profile and its check, in this order."""
    from drivers.rig_file import load_rig

    check = Command(("check", answer, "--rig", course.rig))
    if answer != name:
        return [check]
    return [FileAction(name, load_text(load_rig(course.path(course.rig)), *shape)), check]


def _trial(course: Course) -> list[Action]:
    served = (("rig", course.rig, "--out", SERVED), SERVED)
    actions = [
        *_generated(course, course.answers["load"], LOAD, _TRIAL),
        Command(("check", SERVED, "--online", "--seconds", "3"), beside=served),
    ]
    if not course.is_built_in:
        words = ("run", course.answers["load"], "--rig", course.rig, "--virtual", "--lockstep", "--no-twin")
        actions.append(Command((*words, "--no-report", "--runs", "runs/trial")))
    return actions


# 5, check the rig; 6, protection --------------------------------------------------------------------------------------


def _online(course: Course) -> list[Action]:
    return [Command(("check", course.rig, "--online", "--seconds", "5"))]


def _protection_questions(_: Course) -> Asked:
    def check(text: str) -> str:
        if text != "yes":
            raise ValueError("nothing is driven before it has them; Ctrl-C ends here, and `hil start` goes on later")
        return text

    text = "Do thermostat, flow switch and emergency stop of the rig work without any computer? yes, or Ctrl-C"
    yield Question("protection", text, None, check)


# 7, healthy record; 8, commission -------------------------------------------------------------------------------------


def _file(course: Course, text: str) -> str:
    if not course.path(text).is_file():
        raise ValueError(f"{text}: there is no such file")
    return text


def _consent(course: Course, key: str, load: str, generated: str, shape: tuple[float, int]) -> Asked:
    """Ask for the consent to write to a rig, with all that will be written."""
    from drivers.rig_file import load_rig
    from hil.files import replacing

    if course.simulated:
        return
    rig = load_rig(course.path(course.rig))
    if load == generated:
        with replacing(course.folder / load) as unfinished:
            unfinished.write_text(load_text(rig, *shape), encoding="utf-8")
    what = written_text(rig, course.path(load))
    yield Question(key, f"This run writes to the rig: {what}. Type yes to agree", None, anything, consent=what)


def _healthy_questions(course: Course) -> Asked:
    text = f"Load profile of the healthy rig; {HEALTHY} is made from the limits, one set-point at a time"
    load = yield _profile(course, "healthy", text, "profiles/loads/commissioning_10h.csv", HEALTHY)
    text = "Twin file to start from; its inputs and sensors must be points of the rig"
    yield Question("twin", text, "profiles/twins/loop.toml", lambda answer: _file(course, answer))
    yield from _consent(course, "writes.healthy", load, HEALTHY, _HEALTHY)


def _healthy(course: Course) -> list[Action]:
    answers = course.answers
    plant = course.simulated and not course.is_built_in
    # A simulated plant has the twin's parameters, and a run takes a twin only with a calibrator; no estimate is used.
    with_twin = ("--twin", answers["twin"], "--calibrator", "least_squares") if plant else ("--no-twin",)
    run = ("run", answers["healthy"], "--rig", course.rig, *course.simulated, *with_twin, "--runs", "runs/healthy")
    return [
        *_generated(course, answers["healthy"], HEALTHY, _HEALTHY),
        Command(("check", answers["twin"])),
        Command(run, writes=answers.get("writes.healthy")),
    ]


def _commission(course: Course) -> list[Action]:
    words = ("commission", Newest("runs/healthy"), "--twin", course.answers["twin"], "--out", TWIN)
    return [Removal((TWIN, _HEALTHY_RECORD)), Command(words)]


# 9, run; 10, diagnose -------------------------------------------------------------------------------------------------


def _run_questions(course: Course) -> Asked:
    if course.is_built_in:
        text = f"Fault that no twin knows of, an effects file or {NONE}"

        def check(answer: str) -> str:
            return answer if answer == NONE else _file(course, answer)

        yield Question("fault", text, "profiles/effects/modules_heat.toml", check)
    yield from _consent(course, "writes.load", course.answers["load"], LOAD, _TRIAL)


def _run(course: Course) -> list[Action]:
    answers = course.answers
    words = ("run", answers["load"], "--rig", course.rig, "--twin", TWIN)
    if course.simulated:
        fault = answers.get("fault", NONE)
        hidden = () if fault == NONE else ("--with", fault)
        return [Command((*words, *course.simulated, *hidden, "--runs", "runs/load"))]
    return [
        Command((*words, "--virtual", "--lockstep", "--runs", "runs/twin")),
        Command((*words, "--runs", "runs/load"), writes=answers["writes.load"]),
    ]


def _diagnose(_: Course) -> list[Action]:
    return [Command(("diagnose", Newest("runs/load")), accepted=(0, 1))]


STEPS = (
    Step(
        "describe",
        "Describe the rig",
        "A rig file lists buses and points. It is made of a table that you have; nothing is guessed silently.",
        _always,
        _source_questions,
        _describe,
    ),
    Step(
        "complete",
        "Give points their limits, safe values, read-backs and roles",
        "No profile drives a point without limits. The safe value is set on every way out of a run. A twin finds its "
        "columns by the names of points.",
        _of_a_table,
        _point_questions,
        _complete,
    ),
    Step(
        "check",
        "Check the file",
        "Each mistake has its line; notes name missing protection.",
        _always,
        _no_questions,
        _check,
    ),
    Step(
        "trial",
        "Try it without the rig",
        "The devices of the rig file are served on this computer; nothing reaches any hardware.",
        _always,
        _load_questions,
        _trial,
    ),
    Step(
        "online",
        "Check the rig",
        "All buses are opened and each point is read. Nothing is written. Compare a few values with the instruments.",
        _on_a_rig,
        _no_questions,
        _online,
    ),
    Step(
        "protection",
        "Decide about protection",
        "hil is no certified safety function: docs/explanation/safety.md.",
        _on_a_rig,
        _protection_questions,
        lambda _: [],
    ),
    Step(
        "healthy",
        "Record the healthy rig",
        "Heater, pump and fan move one at a time, so that the record identifies the parameters of the twin.",
        _always,
        _healthy_questions,
        _healthy,
    ),
    Step(
        "commission",
        "Commission the twin",
        "The parameters are fitted to four fifths of the record; the errors are those of the rest.",
        _always,
        _no_questions,
        _commission,
    ),
    Step(
        "run",
        "Run a load with the twin",
        "The static twin keeps its parameters; tracked twins follow the rig.",
        _always,
        _run_questions,
        _run,
    ),
    Step(
        "diagnose",
        "Diagnose the run",
        "The residual, measured minus predicted, is traced to the effect that the twin lacks.",
        _always,
        _no_questions,
        _diagnose,
    ),
)
