"""Seeded faults on the virtual rig, in processes of their own: heater, samples and values, told by the rig."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import shutil
import uuid
from pathlib import Path

import pytest

from drivers.signals.points import Quality
from drivers.virtual.devices.truth import Moment
from hil.bench.faults import judge
from hil.bench.faults.campaign import campaign, pair_tables, tables
from hil.bench.faults.kinds import KINDS
from hil.bench.faults.plan import AND, case_of, pairs, singles
from hil.bench.faults.rig import STALE_LIMIT_S, WATCHDOG_S, rig_text
from hil.bench.faults.verdict import FaultResult

SEED = 20_261
COSTLY = ("calibrator crash", "viewer killed", "SIGKILL")
"""Seconds of processor time each, and tested elsewhere; `hil bench faults` has them."""
OF_FRAMES = (
    "garbled replies",
    "garbled replies, brief",
    "garbled over TLS, brief",
    "cut-off replies",
    "too few registers",
    "wrong function",
    "late replies, brief",
    "replies in pieces",
    "CAN text garbled",
)
"""Replies that the driver refuses: tests/contract has each on every transport, and the run sees the same link fault of
all. "late replies" and "garbled over TLS" stand for them here; `hil bench faults` has them all."""
RIDDEN = "CAN link drop, brief + link drop, brief"
"""Faults that a run rides through, on both wires at a time: either alone would be seen to end it."""
TWO_AT_A_TIME = ("thermocouple stuck + link drop", "pump stop + disk full", "late replies, brief + loop hangs")
IN_PAIRS = ("thermocouple stuck", "link drop", "pump stop", *RIDDEN.split(AND))
"""Each with another fault in `RIDDEN` or `TWO_AT_A_TIME`."""
ALIKE = ("CAN silent", "SIGINT")
"""A bus-off is silence as well, and SIGTERM takes the way of SIGINT, which tests/hil/test_run.py sends, too."""
HUNG, KILLED = ("loop hangs", 0), ("SIGKILL", 3)
AFTER = ("disk full", "thermocouple open", "rig reboot")
"""Followed until the run has gone on with the fault over; a reboot drops the link, too."""


def cases() -> list[tuple[str, int]]:
    names = [name for name in KINDS if name not in (*COSTLY, *OF_FRAMES, *IN_PAIRS, *ALIKE, *AFTER, HUNG[0])]
    names = [name for name in names if KINDS[name].place != "tls" or shutil.which("openssl")]
    return [(kind, number + 1) for kind, number in singles(len(names), names)] + [HUNG, KILLED] + [(RIDDEN, 0)]


TOKEN = uuid.uuid4().hex
"""In the environment of all that the campaign starts."""


@pytest.fixture(scope="module")
def followed() -> list[FaultResult]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HIL_TEST_TOKEN", TOKEN)
        return asyncio.run(campaign([(name, 0) for name in AFTER], SEED, jobs=3))


@pytest.fixture(scope="module")
def results(followed) -> list[FaultResult]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HIL_TEST_TOKEN", TOKEN)
        return asyncio.run(campaign(cases(), SEED, jobs=4, resume=False)) + followed


def started(token: str) -> list[str]:
    """The commands of the live processes with `token` in their environment."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # it has gone, or is another user's
            if token.encode() in (place / "environ").read_bytes():
                found.append((place / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace"))
    return found


def test_a_campaign_leaves_no_process_behind_not_even_a_guardian_without_its_rig(results):
    assert {result.by for result in results} >= {"guardian", "harness"}
    assert started(TOKEN) == []


@pytest.mark.timeout(900)
def test_a_fault_of_each_kind_breaks_no_must(results):
    assert len(results) == len(cases()) + len(AFTER)
    assert len({kind for result in results for kind in result.kind.split(AND)}) >= 16
    assert [result.ended for result in results if result.kind == RIDDEN] == ["rode through"]
    broken = [f"{r.kind} {r.number}: {'; '.join(r.failures)} [{r.reason}]" for r in results if r.failures]
    assert not broken, "\n".join(broken)
    struck = [r for r in results if r.heated and r.ended != "rode through"]
    assert len(struck) >= 10
    for result in struck:
        limit = WATCHDOG_S + 0.2 if result.ended == "killed" else STALE_LIMIT_S
        assert result.safe is not None
        assert result.safe <= limit, result
    assert sum(result.acknowledged for result in results) > 10 * len(results)
    assert not any(result.lost or result.wrong for result in results)


@pytest.mark.parametrize("case", [HUNG, KILLED])
def test_a_loop_that_hangs_or_was_killed_is_made_safe_by_its_guardian(results, case):
    (gone,) = (result for result in results if (result.kind, result.number) == case)
    assert gone.heated
    assert gone.by == "guardian"
    assert gone.safe is not None
    assert gone.safe <= WATCHDOG_S
    assert gone.acknowledged > 0
    assert gone.lost == 0
    assert gone.unsaved_s is not None
    assert gone.unsaved_s < 1.0


@pytest.mark.timeout(600)
def test_a_run_goes_on_after_a_disk_a_sensor_and_a_rig_that_are_in_order_again(followed):
    broken = [f"{r.kind}: {'; '.join(r.failures)} [{r.reason}]" for r in followed if r.failures]
    assert not broken, "\n".join(broken)
    assert [r.resumed for r in followed] == [True] * len(AFTER)
    assert not any(r.lost or r.wrong for r in followed)
    assert dict(tables(followed, 1.0)[1].rows)["resumable runs resumed"] == "3 of 3"


@pytest.mark.timeout(300)
def test_two_faults_at_a_time_break_no_must():
    found = asyncio.run(campaign([(name, 0) for name in TWO_AT_A_TIME], SEED, jobs=3, resume=False))
    broken = [f"{r.kind}: {'; '.join(r.failures)} [{r.reason}]" for r in found if r.failures]
    assert not broken, "\n".join(broken)
    assert all(r.heated and r.safe is not None and r.acknowledged for r in found)
    stuck, stopped, hung = found
    assert stuck.safe <= STALE_LIMIT_S
    assert stopped.safe <= STALE_LIMIT_S
    assert (hung.ended, hung.by) == ("killed", "guardian")
    assert hung.safe <= WATCHDOG_S + 0.2
    table, musts = pair_tables(found, SEED)
    assert [row[0] for row in table.rows] == list(TWO_AT_A_TIME)
    assert dict(musts.rows)["wrong values recorded as good"] == "0"


def test_pairs_are_of_different_wires_and_every_kind_is_among_forty():
    drawn = [name.split(AND) for name, _ in pairs(40, 0)]
    assert drawn == [name.split(AND) for name, _ in pairs(40, 0)] != [n.split(AND) for n, _ in pairs(40, 1)]
    assert len({frozenset(pair) for pair in drawn}) == 40
    assert {kind for pair in drawn for kind in pair} == set(KINDS)
    for first, second in drawn:
        assert KINDS[first].wire == "" or KINDS[first].wire != KINDS[second].wire
        assert first != "SIGKILL"
    assert len(pairs(10_000, 0)) == 33 * 32 // 2 - 14 * 13 // 2 - 6 * 5 // 2  # but for those of one wire


def test_what_comes_of_two_faults_is_what_comes_of_the_graver():
    assert case_of("link drop, brief + thermocouple stuck", 0, 0).ending == "stops"
    assert case_of("server restart + loop hangs", 0, 0).ending == "killed"
    assert case_of("calibrator crash + viewer killed", 0, 0).ending == "rides"
    assert case_of("garbled replies, brief + SIGKILL", 0, 0).resumable
    assert case_of("pump stop", 0, 0).resumable
    assert not case_of("pump stop + SIGKILL", 0, 0).resumable
    assert 0.0 < case_of("SIGTERM + pump stop", 0, 0).apart_s < 1.0
    assert not case_of("SIGTERM + pump stop", 0, 0).early
    assert case_of("SIGTERM", 0, 0).early


def test_the_tables_count_what_happened(results):
    kinds, musts, about = tables(results, 2.0)[:3]
    rows = {row[0]: row for row in kinds.rows}
    assert rows["all"][1] == len(results)
    assert rows["all"][10:12] == (0, 0)
    assert dict(musts.rows)["wrong values recorded as good"] == "0"
    assert len(about.rows) == len(kinds.rows) - 1
    bad = dataclasses.replace(results[0], lost=2, failures=["2 acknowledged samples lost"])
    assert tables([bad], 2.0)[-1].key == "broken"


# The judge itself must be able to find what is wrong.


def moment(wall_s: float, heater_W: float = 500.0, status: int = 1, tank_C: float = 30.0) -> Moment:
    return Moment(wall_s, wall_s, heater_W, status, heater_W, 3.8, 100.0, 100.0, 20.0, (30.0,) * 8 + (tank_C,))


TRUE = {
    "heater_power_W": 500.0,
    "flow_L_per_min": 3.8,
    "pump_speed_pct": 100.0,
    "fan_speed_pct": 100.0,
    "T_ambient_C": 20.0,
    **dict.fromkeys((f"T_{name}_C" for name in ("heater", *(f"pm{k}" for k in range(1, 7)), "radiator", "tank")), 30.0),
}


def journal(tank: list[float], quality: list[int] | None = None, **others: object) -> judge.JournalContent:
    count = len(tank)
    values = {name: [value] * count for name, value in TRUE.items()} | {"T_tank_C": tank}
    good = {name: [0] * count for name in TRUE} | {"T_tank_C": quality or [0] * count}
    raw = tuple(bytes([good["T_tank_C"][k]]) for k in range(count))
    return judge.JournalContent(
        tuple(range(count)),
        tuple(0.1 * k for k in range(count)),
        values,
        good,
        raw,
        **others,  # type: ignore[arg-type]
    )


def test_a_wrong_value_is_found_unless_it_is_recorded_as_not_good():
    truth = [moment(0.1 * k) for k in range(20)]
    assert judge.wrong_values(journal([30.1, 29.9, 30.2]), truth) == []
    assert "T_tank_C 31 recorded as good" in judge.wrong_values(journal([30.0, 31.0, 30.0]), truth)[0]
    assert judge.wrong_values(journal([30.0, 31.0], [0, int(Quality.SENSOR_FAULT)]), truth) == []


def test_a_value_may_be_as_old_as_the_staleness_limit_and_no_older():
    truth = [moment(0.1 * k, tank_C=40.0 if k < 10 else 30.0) for k in range(60)]
    assert judge.wrong_values(journal([40.0] * 20), truth) == []
    assert len(judge.wrong_values(journal([40.0] * 40), truth)) > 10


def test_a_lost_and_a_changed_sample_are_counted():
    kept = journal([30.0] * 4)
    seen = judge.AcknowledgedSamples({k: (0.1 * k, b"\0") for k in range(4)})
    assert judge.lost(seen, kept) == 0
    seen.rows[4] = (0.4, b"\0")
    seen.rows[1] = (0.1, b"\3")
    assert judge.lost(seen, kept) == 2


def test_safe_is_from_when_on_nothing_heats_any_more():
    truth = [moment(0.0), moment(1.0, 0.0), moment(2.0), moment(3.0, 0.0), moment(4.0, 0.0)]
    assert judge.safe_since(truth, 0.5) == 3.0
    assert judge.safe_since(truth, 3.5) == 3.5
    assert judge.safe_since(truth[:3], 0.5) is None
    assert judge.watchdog_at([moment(0.0), moment(2.0, 0.0, 2)], 1.0) == 2.0


def test_every_kind_is_among_two_hundred_runs_at_least_six_times():
    names = [kind for kind, _ in singles(200)]
    assert set(names) == set(KINDS)
    assert min(names.count(name) for name in KINDS) >= 6


def test_the_rig_of_the_campaign_is_the_shipped_one_with_short_limits(tmp_path):
    from drivers.rig_file.reader import load_rig

    path = tmp_path / "rig.toml"
    path.write_text(rig_text({"plc": 5999, "thermocouples": 5998}), encoding="utf-8")
    rig = load_rig(path)
    assert (rig.period_s, rig.abort_after_s, rig.bus["plc"].port) == (0.1, 1.5, 5999)
    assert rig.heartbeat is not None
    assert rig.heartbeat.timeout_s == WATCHDOG_S
    assert {point.stale_after_s for point in rig.point} == {1.0}
    assert rig.get("T_tank").stuck_after_s == 1.0
    assert {spec.kind for spec in rig.interlock} == {"no_flow", "heater_power"}
