"""Mutated files of every kind against their readers, from a fixed seed: each is read, or refused in one sentence.

A mutation keeps most of a file's structure, since random bytes are refused before anything is read. A refusal is one of
the project's own errors and names the file; another exception, a library's words alone and a reader that takes longer
than `LONGEST_S` are failures.
"""

from __future__ import annotations

import contextlib
import random
import re
import signal
import tempfile
import threading
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hil.bench.fuzz import texts as fuzz_texts
from hil.bench.fuzz.texts import mutated, mutated_json
from hil.cli.options import PROJECT
from hil.errors import exit_code

READ, REFUSED, UNCLEAR, TRACEBACK, HANG = "read", "refused", "refused unclearly", "traceback", "too slow"
LONGEST_S = 2.0
"""Processor time in s that a reader may take for a file of a few kilobytes."""
_FOREIGN = re.compile(
    r"Input should|Field required|Extra inputs|validation error|pydantic|object has no attribute|NoneType|"
    r"not subscriptable|unhashable|positional argument|Traceback|is not iterable|could not convert string"
)
"""Words of pydantic and of Python's own errors, which give a user no remedy."""
_MOST_EXAMPLES = 20


@dataclass
class ReaderOutcomes:
    """Outcomes of one reader: counts by outcome, and the first files with a failure."""

    counts: Counter[str] = field(default_factory=Counter)
    examples: list[str] = field(default_factory=list)

    @property
    def failures(self) -> int:
        """Return the number of files that were neither read nor refused with a sentence."""
        return self.counts[UNCLEAR] + self.counts[TRACEBACK] + self.counts[HANG]


@dataclass(frozen=True)
class FuzzedReader:
    """Reader under test: `make` writes a mutated file to a path, `read` reads it."""

    suffix: str
    make: Callable[[Path, random.Random], object]
    read: Callable[[Path], object]


def readers(folder: Path) -> dict[str, FuzzedReader]:
    """Return every reader by the kind of its files; `folder` holds the journal that is copied."""
    from hil.bench.fuzz.journal import damaged, read_all, sound_journal
    from hil.diagnosis import CURVES, ResidualCurves, Unknown, write_curves
    from hil.profile import read_scenario
    from twin import load as load_twin

    sound = folder / "sound.sqlite"
    sound_journal(sound)
    journal = sound.read_bytes()
    twins = [(PROJECT / "profiles" / "twins" / f"{name}.toml").read_text() for name in ("heated_pipe", "tclab_bare")]
    load = (PROJECT / "profiles" / "loads" / "commissioning.toml").read_text()
    line = np.zeros(3)
    write_curves(
        ResidualCurves(line, {"T": line}, {"T": line}, {"T": 0.1}, (Unknown("tank", "W", line, line, 0.0),)),
        folder / CURVES,
    )
    (folder / "bus.dbc").write_text(fuzz_texts.DBC, encoding="utf-8")
    return {
        "rig file": _text("toml", _rig, fuzz_texts.RIG),
        "twin file": _text("toml", load_twin, *twins),
        "effects file": _text("toml", _effects, fuzz_texts.EFFECTS),
        "scenario": _text("toml", read_scenario, load),
        "register table": _text("csv", _table, fuzz_texts.TABLE),
        "Telegraf": _text("toml", _telegraf, fuzz_texts.TELEGRAF),
        "Home Assistant": _text("yaml", _home, fuzz_texts.HOME),
        "DBC": _text("dbc", _dbc, fuzz_texts.DBC),
        "data sheet": _json(_sheet, _SHEET),
        "model card": _json(_card, fuzz_texts.CARD),
        "run.json": _json(_run, fuzz_texts.RUN),
        "diagnosis.json": _json(_diagnosis, {"format": 1, "findings": [{"label": "a", "p": 0.1}], "sensors": {}}),
        "journal": FuzzedReader("sqlite", lambda path, pick: damaged(journal, path, pick), read_all),
    }


def fuzz_files(
    count: int, seed: int, *, kinds: tuple[str, ...] = (), progress: Callable[[float], None] = lambda share: None
) -> dict[str, ReaderOutcomes]:
    """Return by kind of file the outcomes of `count` mutated ones of each kind (all where `kinds` is empty).

    Kinds whose reader needs a library that is not installed are left out.
    """
    found: dict[str, ReaderOutcomes] = {}
    with tempfile.TemporaryDirectory(prefix="hil-fuzz-") as name, warnings.catch_warnings():
        warnings.simplefilter("error")  # A library's warning is an unhandled fault.
        folder = Path(name)
        chosen = {kind: one for kind, one in readers(folder).items() if not kinds or kind in kinds}
        if not _has_yaml():
            chosen.pop("Home Assistant", None)
        for at, (kind, reader) in enumerate(chosen.items()):
            pick = random.Random(f"{seed} {kind}")
            path = folder / f"fuzzed.{reader.suffix}"
            outcomes = found[kind] = ReaderOutcomes()
            reader.make(path, random.Random(0))
            with contextlib.suppress(Exception):
                reader.read(path)  # Imports of large libraries do not count as time of a file.
            for number in range(count):
                reader.make(path, pick)
                outcome, said = outcome_of(reader.read, path)
                outcomes.counts[outcome] += 1
                if outcome not in (READ, REFUSED) and len(outcomes.examples) < _MOST_EXAMPLES:
                    outcomes.examples.append(f"{kind} {number}: {said}")
                if number % 500 == 0:
                    progress((at + number / count) / len(chosen))
    progress(1.0)
    return found


def outcome_of(read: Callable[[Path], object], path: Path) -> tuple[str, str]:
    """Return the outcome of reading a file, and the words of a refusal or of a failure."""
    try:
        with _limited():
            read(path)
    except _SlowError:
        return HANG, f"took more than {LONGEST_S:g} s"
    except Exception as error:  # Any exception of a reader is a finding.
        said = str(error)
        if exit_code(error) is None:
            return TRACEBACK, f"{type(error).__name__}: {said}"
        lines = said.splitlines()
        clear = lines and all(path.name in line or str(path.parent) in line for line in lines)
        return (REFUSED if clear and not _FOREIGN.search(said) else UNCLEAR), said
    return READ, ""


class _SlowError(BaseException):
    """Error of a reader that takes too long."""


@contextlib.contextmanager
def _limited() -> Iterator[None]:
    """Raise _SlowError after `LONGEST_S` of computing; only the main thread gets signals."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(*_: object) -> None:
        raise _SlowError

    before = signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, LONGEST_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)


def _text(suffix: str, read: Callable[[Path], object], *texts: str) -> FuzzedReader:
    return FuzzedReader(suffix, lambda path, pick: path.write_bytes(mutated(pick.choice(texts), pick)), read)


def _json(read: Callable[[Path], object], document: Any) -> FuzzedReader:
    return FuzzedReader("json", lambda path, pick: path.write_bytes(mutated_json(document, pick)), read)


def _has_yaml() -> bool:
    try:
        import yaml  # noqa: F401
    except ImportError:
        return False
    return True


_BUS = {"transport": "modbus_tcp", "host": "10.0.0.5", "port": 502, "device_id": 1}
_SHEET = {
    "rig": "a",
    "nominal_flow_L_per_min_at_pump_100pct": 8.0,
    "tank_volume_L": 10.0,
    "heater_water_volume_L": 1.0,
    "heater_rated_W": 1500.0,
    "thermocouple_sigma_K": 0.05,
    "flow_is": "proportional to pump speed",
    "pipe_volumes_L": {"tank_to_heater": 0.2, "heater_to_modules": 0.3},
}


def _rig(path: Path) -> None:
    from drivers.can import bind
    from drivers.rig_file import CanBus, load_rig

    rig = load_rig(path)
    for name, bus in rig.bus.items():
        if isinstance(bus, CanBus):
            bind(name, bus, [point for point in rig.point if point.bus == name])


def _effects(path: Path) -> None:
    from drivers.virtual.plant import load_effects

    load_effects(path)


_READ_AGAIN = 4
"""Drafts for each draft that is written and read as a rig file, which takes longer than the import."""


def _accepted(draft: Any) -> None:
    """Read the rig file of a draft again: an import must not write what `hil check` refuses."""
    if not _is_read_again(draft.source):
        return
    from drivers.importers import rig_file_text
    from drivers.rig_file import load_rig

    made = draft.source.with_name("made.toml")
    made.write_text(rig_file_text(draft, "made"), encoding="utf-8")
    try:
        load_rig(made)
    except ValueError as error:
        raise AssertionError(f"the draft is refused: {error}") from error


def _is_read_again(path: Path) -> bool:
    return zlib.crc32(path.read_bytes()) % _READ_AGAIN == 0


def _table(path: Path) -> None:
    from drivers.importers import import_csv

    _accepted(import_csv(path, "modicon", dict(_BUS)))


def _telegraf(path: Path) -> None:
    from drivers.importers import import_telegraf

    _accepted(import_telegraf(path))


def _home(path: Path) -> None:
    from drivers.importers import import_homeassistant

    _accepted(import_homeassistant(path))


def _dbc(path: Path) -> None:
    from drivers.can import bind
    from drivers.importers import import_dbc, rig_file_text
    from drivers.rig_file import load_rig

    made = path.with_name("made.toml")
    draft = import_dbc(path, made, {"transport": "virtual", "channel": "c"})
    if not _is_read_again(path):
        return
    made.write_text(rig_file_text(draft, "made"), encoding="utf-8")
    try:
        rig = load_rig(made)
        for bound in bind("can", rig.bus["can"], rig.point):  # type: ignore[arg-type]
            bound.decode(bytes(bound.length))
    except ValueError as error:
        raise AssertionError(f"the draft is refused: {error}") from error


def _sheet(path: Path) -> None:
    from twin import from_datasheet

    from_datasheet(path)


def _card(path: Path) -> None:
    from twin.calibrators.hiera_unet import Identity, load_ensemble

    load_ensemble(path, Identity("t", "c", ("p",), ("o",)))


def _run(path: Path) -> None:
    from hil.run_folder import RunFolder

    folder = RunFolder(path.parent)
    path.replace(folder.manifest)
    folder.read_manifest()


def _diagnosis(path: Path) -> None:
    from hil.diagnosis import DOCUMENT, read_findings

    path.replace(path.with_name(DOCUMENT))
    read_findings(path.parent)
