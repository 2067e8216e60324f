"""What the network's gates let through: nothing in shadow mode, one reversible revision in controlled mode."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.record.reader import Record
from hil.tracking.adoption import IN_A_ROW, Advice, accepted, adopt, clearly_better, closed_gates
from hil.tracking.twins import Proposed
from twin.kernel import simulate
from twin.revisions import chain, diff, revert
from twin.twinfile import load

LOOP = Path(__file__).resolve().parents[2] / "profiles" / "twins" / "loop.toml"
TRUE = {"fins.UA_100": 45.0, "tank_loss.hA": 8.0}
HOURS = 3.0
CHANGED_S = 1800.0


@pytest.fixture
def twin(tmp_path: Path) -> Path:
    return Path(shutil.copy(LOOP, tmp_path / "my_twin.toml"))


@pytest.fixture(scope="module")
def record() -> Record:
    """Three hours of a loop whose fins and tank are others than the twin's."""
    rng, network = np.random.default_rng(0), load(LOOP)
    n = int(HOURS * 3600)
    time_s = np.arange(n, dtype=np.float64)
    heat = np.repeat(rng.uniform(400, 900, n // 600 + 1), 600)[:n]
    inputs = np.column_stack([heat, np.full(n, 80.0), np.full(n, 60.0), np.full(n, 22.0)])
    clean = simulate(network.with_values(TRUE), time_s, inputs, np.array([35.0, 32.0, 29.0, 30.0]))
    columns = dict(zip(network.input_columns, inputs.T, strict=True))
    for j, parts in enumerate(network.sensor_columns.values()):
        columns |= {c: clean[:, j] + 0.05 * rng.standard_normal(n) for c in parts}
    return Record(time_s, columns)


def proposed(time_s: float, values: dict[str, float], *, closed: str = "", held: tuple[str, ...] = ()) -> Proposed:
    names = (*values, *held)
    document: dict[str, Any] = {
        "time_s": time_s,
        "values": {name: values.get(name, 1.0) for name in names},
        "standard_errors": dict.fromkeys(names, 0.5),
        "held": dict.fromkeys(names, closed) if closed else dict.fromkeys(held, "LOW_SENSITIVITY"),
        "reasons": [f"{closed or 'LOW_SENSITIVITY'}: why"] if closed or held else [],
    }
    return Proposed("hiera_unet", time_s, document)


def proposals(values: dict[str, float], **other: Any) -> list[Proposed]:
    return [proposed(t, values, **other) for t in np.arange(300.0, HOURS * 3600, 300.0).tolist()]


def test_what_was_accepted_becomes_one_revision_that_can_be_reverted(twin: Path, record: Record) -> None:
    held = ("heater_to_modules.resistance",)
    done = adopt(twin, record, proposals(TRUE, held=held), "hil track it")
    assert done.path == twin.with_name("my_twin.r2.toml") or done.path == twin.with_name("my_twin.r1.toml")
    assert [p.name for p in twin.parent.glob("*.toml") if p != twin] == [done.path.name]
    moved = {move.parameter: move.after for move in diff(load(twin), load(done.path)).moved}
    assert moved == TRUE
    newest, oldest = chain(done.path)
    assert oldest.path == twin and not newest.faults
    revision = newest.network.revision
    assert revision.made_by == "hil track it" and "2 of 3 parameters" in revision.evidence
    assert "fins.UA_100: 60 -> 45.00 ± 0.82" in revision.notes[0] and "LOW_SENSITIVITY in" in revision.notes[-1]
    assert revision.held_out_s == (HOURS * 3600 - 1 - 0.2 * (HOURS * 3600 - 1), HOURS * 3600 - 1)
    for sensor, before in revision.error_before_K.items():
        assert revision.error_after_K[sensor] < 0.06 < before
    again = revert(done.path)
    assert diff(load(twin), load(again)).empty


def doubting(seen: list[Proposed], since_s: float, until_s: float = np.inf) -> list[Proposed]:
    """The same proposals with the tank's thermometer left aside."""
    doubt = {"sensor": "T_tank_C", "since_s": since_s, "off_K": -0.8}
    return [
        Proposed(p.calibrator, p.time_s, p.document | {"doubted": [doubt] * (since_s < p.time_s <= until_s)})
        for p in seen
    ]


def test_a_thermometer_that_was_left_aside_speaks_neither_for_a_revision_nor_against_it(
    twin: Path, record: Record
) -> None:
    since = 5400.0
    columns = dict(record.columns)
    for name in load(LOOP).sensor_columns["T_tank_C"]:
        columns[name] = columns[name] - 2.5 * (record.time_s >= since)
    lying = Record(record.time_s, columns)
    assert adopt(twin, lying, proposals(TRUE), "hil track it").path is None
    done = adopt(twin, lying, doubting(proposals(TRUE), since), "hil track it")
    assert done.path is not None
    revision = load(done.path).revision
    assert "T_tank_C" not in revision.error_after_K and max(revision.error_after_K.values()) < 0.06
    assert "T_tank_C excluded from 1.50 h on: it read 0.80 K less than the other" in revision.notes[-1]
    until = closed_gates(doubting(proposals(TRUE), since, 7200.0))
    assert until.endswith(
        "T_tank_C excluded from 1.50 h to 2.00 h: it read 0.80 K less than the other "
        "thermometers and any parameter allow"
    )


def test_only_what_came_before_the_end_is_saved_and_errors_are_of_the_end(twin: Path, record: Record) -> None:
    late = [proposed(HOURS * 3600 - 300.0, {"fins.UA_100": 10.0})]
    done = adopt(twin, record, proposals(TRUE)[:20] + late, "a test")
    assert done.path is not None and load(done.path).parameters["fins.UA_100"].value == 45.0


def test_accepted_is_what_several_proposals_in_a_row_agree_on() -> None:
    def after(*given: float | None) -> dict[str, float]:
        row = [
            proposed(300.0 * k, {}, held=("a",)) if v is None else proposed(300.0 * k, {"a": v})
            for k, v in enumerate(given)
        ]
        return {name: found.value for name, found in accepted(row, IN_A_ROW).items()}

    assert after(5.0, 5.1, 5.2) == after(5.0, 5.1, 5.2, None) == {"a": 5.2}
    assert after(5.0, 5.1) == after(5.0, None, 5.1, 5.2) == after(5.0, 5.1, 7.0) == {}
    assert after(5.0, 5.1, 5.2, 7.0) == {}, "what no longer holds is not taken on"
    assert after(5.0, 5.1, 5.2, 7.0, 7.1, 7.2) == {"a": 7.2}


def test_clearly_better_is_what_is_so_in_most_blocks() -> None:
    time_s, rng = np.arange(3600.0), np.random.default_rng(0)
    before = rng.chisquare(4, 3600)
    assert clearly_better(before, 0.6 * before, time_s) and not clearly_better(before, 0.97 * before, time_s)
    once = np.where(time_s < 300.0, 40.0, 1.0) * before
    assert not clearly_better(once, before, time_s), "one block of twelve is no ground"


def test_a_record_in_another_order_is_not_the_twins_fault(twin: Path, record: Record) -> None:
    """Some parameter always leaves a little less of two kelvins; that is no ground for a revision."""
    order = np.random.default_rng(0).permutation(len(record.time_s) // 600)
    rows = np.concatenate([np.arange(600) + 600 * k for k in order])
    mixed = Record(record.time_s[: len(rows)], {name: v[rows] for name, v in record.columns.items()})
    done = adopt(twin, mixed, proposals({"fins.UA_100": 61.0}), "a test")
    assert done.path is None and "neither within 0.1 K nor clearly better than" in done.sentence
    assert list(twin.parent.glob("*.toml")) == [twin]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ([], "hiera_unet has proposed nothing"),
        (
            proposals(TRUE, closed="MISSING_REQUIRED"),
            "held everything in 28 of 28 proposals; MISSING_REQUIRED in 28 (why)",
        ),
        (proposals({"fins.UA_100": 75.0}), "predicted worse"),
    ],
)
def test_a_closed_gate_or_a_worse_twin_saves_nothing(twin: Path, record: Record, given: Any, words: str) -> None:
    done = adopt(twin, record, given, "a test")
    assert done.path is None and words in done.sentence
    assert list(twin.parent.glob("*.toml")) == [twin]


def test_advice_is_given_where_it_is_news(twin: Path) -> None:
    advise = Advice(load(twin)).news
    assert advise(proposed(300.0, {"fins.UA_100": 60.3})) is None
    assert advise(proposed(600.0, {"fins.UA_100": 45.0})) == (
        "hiera_unet would change fins.UA_100 60 -> 45.00 ± 0.82 W/K"
    )
    assert advise(proposed(900.0, {"fins.UA_100": 45.5})) is None
    assert advise(proposed(900.0, {"fins.UA_100": 20.0}, closed="OUT_OF_ENVELOPE")) is None
