"""Value of a revised twin: later records of the same rig, without and with a further effect.

The first record has one lasting effect that the twin does not know of. Where the diagnosis finds it, the revision that
it saves is asked with two further records, in which the effect is there from the beginning: one without anything else,
one with a second effect. The healthy record is the one that the first twin was commissioned on, all along.
"""

from __future__ import annotations

import dataclasses
import json
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from hil.bench.discovery.injector import RIG
from hil.bench.discovery.score import AnswerScore, judge, wilson
from hil.bench.discovery.sides import commissioned
from hil.bench.discovery.tables import failure
from hil.bench.discovery.trial import HOUR
from hil.bench.measure import Cell, ReportTable, median
from hil.synthetic import Setting, Truth, direct_record, effects_text, lasting, profile, setting

TWIN = "loop"


@dataclass(frozen=True, slots=True)
class RigRecords:
    """Records of one rig in order; None for those without a twin to diagnose them."""

    first: AnswerScore
    same: AnswerScore | None = None
    more: AnswerScore | None = None


def measure(
    count: int, hours: float, seed: int, work: Path, progress: Callable[[float, str], None]
) -> list[RigRecords]:
    """Measure this number of rigs. `progress` is called with the share done and the last result."""
    done = []
    for number in range(count):
        kept = work / f"again-{hours:g}h-seed{seed}" / f"{number}.json"
        if not kept.is_file():
            kept.parent.mkdir(parents=True, exist_ok=True)
            kept.write_text(json.dumps(dataclasses.asdict(_chain(number, hours, seed, kept.parent))), encoding="utf-8")
        found = json.loads(kept.read_text(encoding="utf-8"))
        same, more = (AnswerScore(**found[key]) if found[key] else None for key in ("same", "more"))
        done.append(RigRecords(AnswerScore(**found["first"]), same, more))
        progress((number + 1) / count, " / ".join(o.verdict for o in _outcomes(done[-1:])))
    return done


def _chain(number: int, hours: float, seed: int, work: Path) -> RigRecords:
    before = setting(number, seed, hours, "again")
    after = dataclasses.replace(setting(number, seed, hours, "later"), unit=before.unit)
    first, second = lasting(number, seed, hours)
    rigs, folder = work / "rigs", work / str(number)
    shutil.rmtree(folder, ignore_errors=True)
    rigs.mkdir(exist_ok=True)
    folder.mkdir()
    good, own = commissioned(rigs, before.unit, TWIN)
    twin = Path(shutil.copyfile(own, folder / "twin.toml"))
    found, revision = _asked(before, first, first, twin, good)
    if revision is None:
        return RigRecords(found)
    stays = tuple({**table, "onset_s": 0.0} for table in first.effects)
    nothing = Truth("none", f"true effect:  {first.what}", stays, ())
    both = Truth("one", f"{second.what}, beside {first.what}", (*second.effects, *stays), second.labels)
    same, _ = _asked(after, nothing, nothing, revision, good)
    more, _ = _asked(after, both, second, revision, good)
    return RigRecords(found, same, more)


def _asked(case: Setting, there: Truth, new: Truth, twin: Path, good: Path) -> tuple[AnswerScore, Path | None]:
    """Diagnose a record with the effects `there`, of which `new` are new; return also the twin's next revision."""
    from drivers.rig_file import load_rig
    from drivers.virtual.plant import load_effects
    from hil.diagnosis import columns_of, read_healthy, revise, with_clock
    from twin import load
    from twin.discovery import diagnose

    hidden = twin.with_name("effects.txt")
    hidden.write_text(effects_text(there.effects), encoding="utf-8")
    record = direct_record(profile(case), load_rig(RIG), seed=case.seed, unit=case.unit, effects=load_effects(hidden))
    network, began, used = load(twin), time.monotonic(), time.process_time()
    told = with_clock(network)
    found = diagnose(told, columns_of(told, record, HOUR), read_healthy(told, twin, good, HOUR))
    took = time.monotonic() - began, time.process_time() - used
    truth = {**there.document(), "effects": list(new.effects), "labels": list(new.labels)}
    outcome = judge(f"again_{case.number}", case.load, truth, found.document(), took)
    return outcome, revise(found, network, twin, twin.with_suffix(".parquet"))


def _outcomes(chains: Sequence[RigRecords]) -> list[AnswerScore]:
    return [o for c in chains for o in (c.first, c.same, c.more) if o is not None]


def tables(chains: Sequence[RigRecords], hours: float) -> tuple[ReportTable, ...]:
    """Return counts with 90 % Wilson intervals, and every failure by name."""
    same = [c.same for c in chains if c.same is not None]
    more = [c.more for c in chains if c.more is not None]
    told = [o for o in more if o.alarmed]

    def row(name: str, hits: int, of: int) -> tuple[Cell, ...]:
        low, high = wilson(hits, of)
        return (name, hits, of, 100.0 * hits / of if of else None, 100.0 * low, 100.0 * high)

    rows = (
        row("first record: right within the ambiguity group", sum(bool(c.first.class1) for c in chains), len(chains)),
        row("first record: a revision saved", len(same), len(chains)),
        row("later record, nothing new: adequate", sum(o.verdict == "adequate" for o in same), len(same)),
        row("later record, a second effect: something found", len(told), len(more)),
        row(
            "later record, a second effect: right within the ambiguity group, of found",
            sum(bool(o.class1) for o in told),
            len(told),
        ),
    )
    seconds = median([o.seconds for o in _outcomes(chains)])
    note = (
        f"records of {hours:g} h from the virtual rig's parts, twin {TWIN}.toml; effects of all sizes, so some of the "
        f"second ones are too faint to be seen; {seconds:.0f} s a record (median)"
    )
    columns = ("what", "cases", "of", "%", "90 % from", "to")
    scores = ReportTable("again", "A revised twin on later records", columns, rows, (note,))
    wrong = [(o.case, what, o.what, o.verdict, o.said, o.z) for o in _outcomes(chains) if (what := failure(o))]
    told_of = ("case", "failure", "truth", "verdict", "answer", "z")
    return scores, ReportTable("failures", "Failures", told_of, tuple(wrong))
