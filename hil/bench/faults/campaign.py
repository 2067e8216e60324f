"""Campaign of `hil bench faults`: seeded faults of every kind on the virtual rig, and their consequences.

With `--pairs` two of them at a time, the second while the first lasts. The requirements are the same.
Each case is `hil run` in a process of its own against a virtual rig of its own, in real time at ten hertz. The
truth comes from the rig (`devices.truth`), never from the harness. Finished cases are kept and not run again.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import resource
import signal
import statistics
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from hil.bench.faults.case import STALL_S, run_case
from hil.bench.faults.kinds import KINDS
from hil.bench.faults.plan import AND, case_of, pairs, singles
from hil.bench.faults.rig import PERIOD_S, STALE_LIMIT_S, WATCHDOG_S
from hil.bench.faults.tls import NoOpenSSLError
from hil.bench.faults.verdict import REACT_S, FaultResult, as_document
from hil.bench.measure import Cell, ReportTable
from hil.files import replacing

ROOT = Path(__file__).resolve().parents[3]
_SOURCES = ("hil/**/*.py", "drivers/**/*.py", "profiles/rigs/*")


async def campaign(
    cases: Iterable[tuple[str, int]],
    seed: int,
    *,
    jobs: int = 2,
    keep: Path | None = None,
    resume: bool = True,
    done: Callable[[FaultResult], None] = lambda result: None,
) -> list[FaultResult]:
    """Run `cases`, `jobs` at a time; with `keep`, cases with a result in that folder are not run again.

    With `resume` the first of each kind, and each that a signal struck, goes on once its fault is over, which takes it
    a minute.
    """
    room = asyncio.Semaphore(jobs)

    async def one(kind: str, number: int) -> FaultResult:
        path = None if keep is None else keep / f"{kind.replace(', ', '_').replace(' ', '_')}_{number}.json"
        async with room:
            result = None if path is None else _kept(path)
            if result is None:
                # The first of each kind is followed to its record and report, the others are not.
                thorough = number == 0 and AND not in kind
                result = await run_case(kind, number, seed, thorough=thorough, resume=resume)
                if path is not None:
                    with replacing(path) as temporary:
                        temporary.write_text(json.dumps(as_document(result), indent=1), encoding="utf-8")
        done(result)
        return result

    return list(await asyncio.gather(*(one(kind, number) for kind, number in cases)))


def measure(
    runs: int,
    seed: int,
    work: Path,
    progress: Callable[[float, str], None],
    *,
    kinds: Sequence[str] = (),
    jobs: int = 2,
    two: bool = False,
) -> tuple[tuple[ReportTable, ...], tuple[str, ...], bool]:
    """Return the campaign's tables, everything left out, and True if no requirement was broken.

    `progress` gets the share done and the last case. `two`: `runs` pairs of faults.
    """
    keep = work / f"{fingerprint()}_{seed}"
    keep.mkdir(parents=True, exist_ok=True)
    skipped: list[str] = []
    names = list(kinds) or list(KINDS)
    try:
        _need_openssl()
    except NoOpenSSLError as error:
        names = [name for name in names if KINDS[name].place != "tls"]
        skipped.append(f"faults beneath TLS: {error}")
    cases = pairs(runs, seed, names) if two else singles(runs, names)
    finished: list[FaultResult] = []

    def done(result: FaultResult) -> None:
        finished.append(result)
        said = "; ".join(result.failures) or result.ended
        progress(len(finished) / len(cases), f"{result.kind}: {said}")

    before = _cpu_s()
    hear_signals()
    results = asyncio.run(campaign(cases, seed, jobs=jobs, keep=keep, done=done))
    spent_s = (_cpu_s() - before) / max(len(results), 1)
    found = pair_tables(results, seed) if two else tables(results, spent_s)
    return found, tuple(skipped), not any(result.failures for result in results)


def tables(results: list[FaultResult], cpu_s: float) -> tuple[ReportTable, ...]:
    """Return the outcomes by kind, the requirements, the kinds themselves, and every case that broke a requirement."""
    names = [name for name in KINDS if any(result.kind == name for result in results)]
    rows = [_row(name, [result for result in results if result.kind == name]) for name in names]
    rows.append(_row("all", results))
    happened = ReportTable(
        "kinds",
        f"{len(results)} faults on the virtual rig",
        (
            "kind",
            "runs",
            "seen",
            "rode through",
            "ended",
            "safe after detection s",
            "worst",
            "safe after fault s",
            "worst",
            "samples",
            "lost",
            "wrong",
            "resumed",
        ),
        tuple(rows),
        (
            "Safe: nothing reaches the heater any more, by the rig's own log. Medians and worst.",
            "Detected: the harness left its running state, its guardian acted or the rig's watchdog cut; the earliest.",
            "PointState: a value was recorded as not good, or a warning told, or it was detected.",
            "Samples: acknowledged, that is read by another process from the live journal; lost: not in it afterwards.",
            "Resumed: the first of each kind, and each that came at any instant, by `hil resume` with the fault over: "
            "wire, disk, sensor, pump or fan in order again, the rig back from its reboot, what hung killed. The "
            "thermal state is restored, the profile goes on, and nothing is lost.",
            "Wrong: recorded as good and not true, by the rig's log, at any time within the staleness limit.",
            f"{cpu_s:.1f} CPU seconds a run, those kept from before not counted.",
        ),
    )
    about = ReportTable(
        "about",
        "Kinds of fault",
        ("kind", "what happens"),
        tuple((name, KINDS[name].about) for name in names),
        ("Two of them at a time: `hil bench faults --pairs 80`, `faults_pairs.md`.",),
    )
    return (happened, _musts(results), about, *_broken(results))


def pair_tables(results: list[FaultResult], seed: int) -> tuple[ReportTable, ...]:
    """Return the outcomes by pair, the requirements, and every pair that broke one."""
    rows: list[tuple[Cell, ...]] = []
    for r in results:
        ended = r.heated and r.safe is not None and r.detected is not None and r.ended != "rode through"
        resumed = None if r.resumed is None else "yes" if r.resumed else "no"
        rows.append(
            (
                r.kind,
                case_of(r.kind, r.number, seed).apart_s,
                r.ended,
                r.by or None,
                max((r.safe or 0.0) - (r.detected or 0.0), 0.0) if ended else None,
                r.safe if ended else None,
                r.acknowledged,
                r.lost,
                len(r.wrong),
                resumed,
            )
        )
    happened = ReportTable(
        "pairs",
        f"{len(results)} pairs of faults on the virtual rig",
        (
            "first + second",
            "apart s",
            "ended",
            "by",
            "safe after detection s",
            "safe after fault s",
            "samples",
            "lost",
            "wrong",
            "resumed",
        ),
        tuple(rows),
        (
            "Drawn so that every kind comes about equally often, but for two faults of one wire. The second strikes so "
            "long after the first, while that lasts.",
            "After fault: after the first of the two that has to end a run, or after the kill of the harness.",
            "By: who detected, the harness, its guardian or the rig's watchdog.",
            "With the wire to the heater down only the rig can act, whoever detects: see decision 0013.",
        ),
    )
    return (happened, _musts(results), *_broken(results))


def _broken(results: list[FaultResult]) -> tuple[ReportTable, ...]:
    broken = tuple((f"{r.kind} {r.number}", "; ".join(r.failures)) for r in results if r.failures)
    return (ReportTable("broken", "Cases that broke a must", ("case", "what"), broken),) if broken else ()


def _row(name: str, results: list[FaultResult]) -> tuple[Cell, ...]:
    ended = [result for result in results if result.heated and result.safe is not None]
    reacted = [max(r.safe - r.detected, 0.0) for r in ended if r.safe is not None and r.detected is not None]
    after = [r.safe for r in ended if r.safe is not None]
    resumed = [result.resumed for result in results if result.resumed is not None]
    return (
        name,
        len(results),
        sum(result.detected is not None or result.noticed is not None for result in results),
        sum(result.ended == "rode through" for result in results),
        len(results) - sum(result.ended == "rode through" for result in results),
        statistics.median(reacted) if reacted else None,
        max(reacted, default=None),
        statistics.median(after) if after else None,
        max(after, default=None),
        sum(result.acknowledged for result in results),
        sum(result.lost for result in results),
        sum(len(result.wrong) for result in results),
        f"{sum(resumed)} of {len(resumed)}" if resumed else None,
    )


def _musts(results: list[FaultResult]) -> ReportTable:
    """Return each requirement with its result."""
    heated = [r for r in results if r.heated and r.ended != "rode through"]
    # No agent was left to detect the watchdog's cut on a rig that restarted.
    told = [r for r in heated if r.ended != "killed" or r.detected is not None]
    deaf = [r for r in told if r.wire_down]
    reacted = [r for r in told if r.safe is not None and r.detected is not None]
    killed = [r for r in heated if r.ended == "killed" and r.by in ("guardian", "rig")]
    stopped = [r for r in heated if r not in killed]
    cold = [r for r in results if not r.heated]
    resumed = [r.resumed for r in results if r.resumed is not None]
    unsaved = [r.unsaved_s for r in results if r.unsaved_s is not None]
    quick = sum(r.safe - r.detected <= REACT_S for r in reacted if r.safe is not None and r.detected is not None)
    timely = sum(r.safe <= STALE_LIMIT_S for r in stopped if r.safe is not None)
    cut = sum(r.safe <= WATCHDOG_S + 2 * PERIOD_S for r in killed if r.safe is not None)
    riding = [r for r in results if r.ended == "rode through"]
    rows: list[tuple[Cell, ...]] = [
        (f"safe within {REACT_S:g} s of detection", f"{quick} of {len(told)}"),
        (f"safe within the stale limit of {STALE_LIMIT_S:g} s of the fault", f"{timely} of {len(stopped)}"),
        (
            f"harness gone: made safe by its guardian, or cut by the rig's watchdog of {WATCHDOG_S:g} s",
            f"{cut} of {len(killed)}",
        ),
        ("struck before anything heated, and nothing did", f"{sum(not r.failures for r in cold)} of {len(cold)}"),
        (
            "rode through, and safe within 1 s of SIGTERM later",
            f"{sum(not r.failures for r in riding)} of {len(riding)}",
        ),
        ("acknowledged samples lost", f"{sum(r.lost for r in results)} of {sum(r.acknowledged for r in results)}"),
        ("wrong values recorded as good", f"{sum(len(r.wrong) for r in results)}"),
        ("age of the last durable sample at a kill, worst, s", f"{max(unsaved):.2f}" if unsaved else "-"),
        ("resumable runs resumed", f"{sum(resumed)} of {len(resumed)}" if resumed else "not tried"),
    ]
    refused = [r.refused for r in results if r.refused is not None]
    if refused:
        rows.append(
            ("over before the first sample: resume refused, with a remedy", f"{sum(refused)} of {len(refused)}")
        )
    if deaf:
        after = [r.safe - r.detected for r in deaf if r.safe is not None and r.detected is not None]
        cut = sum(x <= WATCHDOG_S + 2 * PERIOD_S for x in after)
        said = f"{cut} of {len(deaf)}, worst {max(after, default=0.0):.2f} s after detection"
        rows.insert(1, ("of these with the wire to the heater down: cut by the rig's watchdog", said))
    again = sum(result.attempts > 1 for result in results)
    note = (
        f"{again} cases were repeated: a limit was missed while rig, harness or relays waited {STALL_S:g} s or "
        "longer for a processor, or the fault came before the run."
    )
    return ReportTable("musts", "Musts", ("must", "found"), tuple(rows), (note,))


def _kept(path: Path) -> FaultResult | None:
    try:
        return FaultResult(**json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None


def fingerprint() -> str:
    """Return a digest of everything that a case's outcome depends on: its change invalidates finished cases."""
    digest = hashlib.sha256()
    for pattern in _SOURCES:
        for path in sorted(ROOT.glob(pattern)):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def _need_openssl() -> None:
    import shutil

    if shutil.which("openssl") is None:
        raise NoOpenSSLError("certificates are made by the openssl program, which is not installed; install it")


def _cpu_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in used)


def hear_signals() -> None:
    """Undo what a shell does to a command in its background, or nohup: what it ignores, every run that it starts would
    ignore too. A campaign itself outlives its terminal."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        signal.signal(signal.SIGHUP, lambda *_: None)  # a started process has the default in place of a handler
