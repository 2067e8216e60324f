"""Campaign of `hil bench faults --chaos`: attacks at random instants, alone and in pairs, half of them without the
rig's watchdog.

Each case is `hil run` in a process of its own on a virtual rig of its own, in real time at ten hertz. The rig's own log
says when the heater was off (`drivers.virtual.devices.truth`). Finished cases are kept and not run again.
"""

from __future__ import annotations

import asyncio
import json
import statistics
from collections.abc import Callable, Sequence
from pathlib import Path

from hil.bench.chaos.case import run_chaos_case
from hil.bench.chaos.clock import NoCompilerError, need_compiler
from hil.bench.chaos.kinds import CHAOS_KINDS
from hil.bench.chaos.plan import ChaosCase, chaos_cases
from hil.bench.chaos.verdict import LIMIT_S, ROUGH_S, ChaosResult, as_document
from hil.bench.faults import STALL_S, WATCHDOG_S, fingerprint, hear_signals
from hil.bench.measure import Cell, ReportTable
from hil.files import replacing

RESUME_EVERY = 5
"""Cases for each resumed case: a resume takes as long as the case itself."""
_BY_WATCHDOG = ("unguarded", "lies")


async def campaign(
    cases: Sequence[ChaosCase],
    seed: int,
    *,
    jobs: int = 2,
    keep: Path | None = None,
    resume: bool = True,
    done: Callable[[ChaosResult], None] = lambda result: None,
) -> list[ChaosResult]:
    """Run `cases`, `jobs` at a time; with `keep`, cases with a result in that folder are not run again."""
    room = asyncio.Semaphore(jobs)

    async def one(case: ChaosCase) -> ChaosResult:
        name = case.name.replace(", ", "_").replace(" ", "_").replace("'", "")
        path = None if keep is None else keep / f"{case.index:04d}_{name}_{'on' if case.watchdog else 'off'}.json"
        async with room:
            result = None if path is None else _kept(path)
            if result is None:
                result = await run_chaos_case(case, seed, resume=resume and case.index % RESUME_EVERY == 0)
                if path is not None:
                    with replacing(path) as temporary:
                        temporary.write_text(json.dumps(as_document(result), indent=1), encoding="utf-8")
        done(result)
        return result

    return list(await asyncio.gather(*(one(case) for case in cases)))


def measure(
    runs: int,
    seed: int,
    work: Path,
    progress: Callable[[float, str], None],
    *,
    kinds: Sequence[str] = (),
    jobs: int = 2,
) -> tuple[tuple[ReportTable, ...], tuple[str, ...], bool]:
    """Return the campaign's tables, a line for everything left out, and True if no requirement was broken."""
    keep = work / f"chaos_{fingerprint()}_{seed}"
    keep.mkdir(parents=True, exist_ok=True)
    names, skipped = list(kinds) or list(CHAOS_KINDS), []
    try:
        need_compiler()
    except NoCompilerError as error:
        names = [name for name in names if "clock" not in CHAOS_KINDS[name].needs]
        skipped.append(str(error))
    cases = chaos_cases(runs, seed, names)
    finished: list[ChaosResult] = []

    def done(result: ChaosResult) -> None:
        finished.append(result)
        said = "; ".join(result.failures) or result.left_out or result.ended
        progress(len(finished) / len(cases), f"{result.name}: {said}")

    hear_signals()
    results = asyncio.run(campaign(cases, seed, jobs=jobs, keep=keep, done=done))
    skipped += sorted({f"{r.name}: {r.left_out}" for r in results if r.left_out})
    return chaos_tables(results), tuple(skipped), not any(result.failures for result in results)


def chaos_tables(results: Sequence[ChaosResult]) -> tuple[ReportTable, ...]:
    """Return the requirements, the outcomes by kind, the kinds themselves, and every case that broke a requirement."""
    tried = [result for result in results if not result.left_out]
    names = [name for name in CHAOS_KINDS if any(name in result.names for result in tried)]
    rows = [_row(name, [result for result in tried if name in result.names]) for name in names]
    rows.append(_row("all", tried))
    kinds = ReportTable(
        "kinds",
        "Outcomes by kind",
        ("kind", "runs", "in pairs", "safe s", "worst", "in time", "lost", "wrong", "readable", "resumed"),
        tuple(rows),
        (
            "A pair counts under both of its kinds.",
            "Safe: seconds from the event to a heater without power for good, by the rig's log; median and worst. The "
            "event is the attack where the run has to end, the signal at the end where it has to go on, the last "
            "sample where it may end and did. While neither harness nor guardian can run, the time does not count.",
            f"In time: within {LIMIT_S:g} s; cases in which only the rig's watchdog can cut are not counted.",
            "Lost: acknowledged samples, that is samples that another process had read from the live journal. Samples "
            "that an attack itself deleted do not count.",
            "Wrong: values recorded as good that were not true within the staleness limit, and rows with values of "
            "another time than theirs.",
            f"Resumed: `hil resume` restores the thermal state, or refuses in a sentence; one case of {RESUME_EVERY}.",
        ),
    )
    about = ReportTable(
        "about",
        "The kinds",
        ("kind", "outcome", "attack"),
        tuple((name, CHAOS_KINDS[name].ending, CHAOS_KINDS[name].about) for name in names),
    )
    broken = tuple((_title(r), "; ".join(r.failures), r.reason[-200:]) for r in tried if r.failures)
    found = ReportTable("broken", "Cases that broke a must", ("case", "must", "last words"), broken)
    return (_musts(tried), kinds, about, *((found,) if broken else ()))


def _title(result: ChaosResult) -> str:
    return f"{result.index} {result.name}, watchdog {'on' if result.watchdog else 'off'}"


def _row(name: str, results: Sequence[ChaosResult]) -> tuple[Cell, ...]:
    counted = [r for r in results if r.heated and r.ending not in _BY_WATCHDOG]
    safe = [r.safe for r in counted if r.safe is not None]
    resumed = [r.resumed for r in results if r.resumed is not None]
    return (
        name,
        len(results),
        sum(len(r.names) > 1 for r in results),
        statistics.median(safe) if safe else None,
        max(safe, default=None),
        f"{sum(s <= LIMIT_S for s in safe)} of {len(counted)}",
        sum(r.lost for r in results),
        sum(len(r.wrong) + r.misplaced for r in results),
        f"{sum(r.readable for r in results)} of {len(results)}",
        f"{sum(resumed)} of {len(resumed)}" if resumed else None,
    )


def _musts(results: Sequence[ChaosResult]) -> ReportTable:
    """Return each requirement with the count of the cases that met it."""
    heated = [r for r in results if r.heated and r.ending not in _BY_WATCHDOG]
    rows: list[tuple[Cell, ...]] = []
    for on in (False, True):
        half = [r for r in heated if r.watchdog is on]
        timely = sum(r.safe is not None and r.safe <= LIMIT_S for r in half)
        worst = max((r.safe for r in half if r.safe is not None), default=0.0)
        text = f"{timely} of {len(half)}, worst {worst:.2f} s"
        rows.append((f"safe within {LIMIT_S:g} s, rig's watchdog {'on' if on else 'off'}", text))
    cold = [r for r in results if not r.heated]
    quiet = sum(not r.failures for r in cold)
    rows.append(("attacked before anything heated, and nothing did", f"{quiet} of {len(cold)}"))
    alone = [r for r in results if r.ending == "unguarded"]
    cut = sum(r.safe is not None and r.safe <= WATCHDOG_S + ROUGH_S for r in alone)
    text = f"harness and guardian gone at once: cut by the rig's watchdog of {WATCHDOG_S:g} s"
    rows.append((text, f"{cut} of {len(alone)}"))
    for on in (False, True):
        lied = [r for r in results if r.ending == "lies" and r.watchdog is on]
        kept = sum(not r.failures for r in lied)
        text = "cut by the rig's watchdog" if on else "heartbeat withheld, not called safe, exit code 1"
        rows.append((f"heater does not obey, watchdog {'on' if on else 'off'}: {text}", f"{kept} of {len(lied)}"))
    rows += [
        ("acknowledged samples lost", f"{sum(r.lost for r in results)} of {sum(r.acknowledged for r in results)}"),
        ("wrong values recorded as good", f"{sum(len(r.wrong) for r in results)}"),
        ("rows with values of another time than theirs", f"{sum(r.misplaced for r in results)}"),
        ("run folders readable", f"{sum(r.readable for r in results)} of {len(results)}"),
    ]
    resumed = [r.resumed for r in results if r.resumed is not None]
    rows.append(("resumed, or refused in a sentence", f"{sum(resumed)} of {len(resumed)}" if resumed else "not tried"))
    rows.append(("cases that kept every must", f"{sum(not r.failures for r in results)} of {len(results)}"))
    again = sum(result.attempts > 1 for result in results)
    note = (
        f"{again} cases were repeated: a must was broken while rig, harness or relays waited {STALL_S:g} s or longer "
        "for a processor, or no heater was on when the attack came."
    )
    return ReportTable("musts", f"Musts of {len(results)} cases", ("must", "found"), tuple(rows), (note,))


def _kept(path: Path) -> ChaosResult | None:
    try:
        return ChaosResult(**json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None
