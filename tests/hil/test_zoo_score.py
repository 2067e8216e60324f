"""Score, plan, seals and command of the zoo's trial."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from hil.bench.commands.bench import command
from hil.bench.discovery.ledger import Ledger, LedgerError
from hil.bench.zoo import score
from hil.bench.zoo.case import SealedFamilyError, make_case
from hil.bench.zoo.plan import plan
from hil.bench.zoo.plants.families import DEVELOPMENT, SEALED, draw_plant
from hil.bench.zoo.tables import tables
from hil.bench.zoo.twins import sheet_twin
from hil.bench.zoo.visibility import Yardstick, blocks

PUMP_HEAT = [{"kind": "heat_source", "where": "tank", "drivers": ["pump_speed"]}]
ANY_LOSS = [{"kind": "heat_loss", "where": "tank", "drivers": []}]


def effect(kind: str, where: str, driver: str = "constant") -> dict[str, Any]:
    return {
        "kind": kind,
        "where": where,
        "driver": driver,
        "value": 1.0,
        "unit": "W",
        "onset_s": 0.0,
        "shape": "step",
        "z": 9.0,
    }


def answer(verdict: str, effects: tuple[dict[str, Any], ...] = (), others: tuple[dict[str, Any], ...] = ()) -> Any:
    sensors = {"T": {"before": 0.4, "after": 0.2, "noise": 0.1}}
    return {
        "verdict": verdict,
        "effects": list(effects),
        "indistinguishable": list(others),
        "error": {"sensors": sensors},
    }


def truth(accepted: list[dict[str, Any]], place: str = "tank", hidden: str = "something") -> dict[str, Any]:
    return {
        "family": "serial",
        "effect": hidden,
        "group": "heat",
        "element": True,
        "answers": accepted,
        "place": place,
        "score": 20.0,
        "score_of_noise": 50.0,
        "rows": 100,
        "schedule": {"kind": "steps"},
    }


CASES = [
    (PUMP_HEAT, answer("effect found", (effect("heat_source", "tank", "pump_speed"),)), score.RIGHT),
    (PUMP_HEAT, answer("effect found", (effect("heat_source", "tank", "fan_speed"),)), score.WRONG),
    (PUMP_HEAT, answer("effect found", (effect("heat_source", "heater", "pump_speed"),)), score.WRONG),
    (
        PUMP_HEAT,
        answer("ambiguous", (effect("flow", "loop"),), (effect("heat_source", "tank", "pump_speed"),)),
        score.ALIKE,
    ),
    (ANY_LOSS, answer("effect found", (effect("heat_loss", "tank", "temperature"),)), score.RIGHT),
    (ANY_LOSS, answer("unexplained", (effect("heat_source", "tank"),)), score.ABSTAINED),
    (
        PUMP_HEAT,
        answer("effect found", (effect("heat_source", "tank", "history") | {"shape": "own course"},)),
        score.RIGHT,
    ),
    (PUMP_HEAT, answer("effect found", (effect("sensor", "tank", "history") | {"shape": "own course"},)), score.WRONG),
    (
        ANY_LOSS,
        answer("effect found", (effect("heat_source", "tank", "history") | {"shape": "own course"},)),
        score.RIGHT,
    ),
    (ANY_LOSS, answer("effect found", (effect("heat_source", "tank", "history"),)), score.WRONG),
    (ANY_LOSS, answer("adequate"), score.MISSED),
    (ANY_LOSS, answer("crashed"), score.CRASHED),
]


@pytest.mark.parametrize(("accepted", "given", "outcome"), CASES)
def test_an_answer_is_judged_by_what_was_declared_with_the_effect(accepted: Any, given: Any, outcome: str) -> None:
    assert score.judge("case_0", truth(accepted), given).outcome == outcome


def test_a_healthy_plant_should_be_quiet() -> None:
    healthy = truth([], "", "none")
    assert score.judge("h", healthy, answer("adequate")).outcome == score.QUIET
    assert score.judge("h", healthy, answer("unexplained")).outcome == score.FALSE_ALARM
    assert score.judge("h", healthy, answer("effect found", (effect("flow", "loop"),))).outcome == score.FALSE_ALARM


def test_further_effects_count_as_spurious_unless_an_accepted_answer_covers_them() -> None:
    first, other = effect("heat_loss", "tank"), effect("sensor", "T_tank_C")
    one = score.judge("c", truth(ANY_LOSS), answer("effect found", (first, other, first)))
    assert (one.outcome, one.spurious) == (score.RIGHT, 1)


def test_the_place_of_what_is_left_unexplained_counts() -> None:
    right = score.judge("c", truth(ANY_LOSS), answer("unexplained", (effect("sensor", "tank"),)))
    wrong = score.judge("c", truth(ANY_LOSS), answer("unexplained", (effect("sensor", "heater"),)))
    assert (right.place, wrong.place) == (True, False)
    loop = score.judge("c", truth(ANY_LOSS, "loop"), answer("unexplained", (effect("sensor", "heater"),)))
    assert loop.place is None


def test_tables_hold_every_case_and_count_it_once() -> None:
    done = [score.judge(f"case_{k}", truth(a), g, healthy_K=0.1) for k, (a, g, _) in enumerate(CASES)]
    found = {t.key: t for t in tables(done, "dev")}
    assert len(found["cases"].rows) == len(CASES)
    assert sum(row[1] for row in found["group"].rows if isinstance(row[1], int)) == len(CASES)
    over = next(r for r in found["numbers"].rows if r[0] == "held out, with the effects, over the healthy floor")
    assert over[1] == pytest.approx(2.0)


def test_a_case_without_an_answer_has_a_row_of_its_own() -> None:
    a, g, _ = CASES[0]
    done = [score.judge("case_0", truth(a), g, healthy_K=0.1)]
    unanswered = replace(done[0], case="case_1", score=math.nan, outcome="no answer")
    found = {t.key: t for t in tables([*done, unanswered], "dev")}
    assert [row[0] for row in found["score"].rows][-1] == "-"


def test_plans_of_the_two_halves_share_neither_family_nor_seed() -> None:
    dev, sealed = plan("dev", 30, 5, 2), plan("sealed", 30, 5, 2)
    assert {c.family for c in dev} == set(DEVELOPMENT)
    assert {c.family for c in sealed} == set(SEALED)
    assert not {c.seed for c in dev} & {c.seed for c in sealed}
    assert len({c.seed for c in (*dev, *sealed)}) == 70
    assert len({c.effect for c in dev}) == 31  # Thirty different ones, and none.


def test_a_longer_plan_begins_like_a_shorter_one() -> None:
    assert plan("dev", 100, 0, 4)[:20] == plan("dev", 20, 0, 4)


def test_a_sealed_family_is_not_run_unless_it_is_opened(tmp_path: Path) -> None:
    with pytest.raises(SealedFamilyError, match="sealed"):
        make_case(SEALED[0], 1)
    done = CliRunner().invoke(command, ["zoo", "--families", "sealed", "--work", str(tmp_path)])
    assert done.exit_code == 2
    assert "--open-sealed" in done.output
    assert not list(tmp_path.iterdir())


def test_the_ledger_holds_a_note_in_its_chain(tmp_path: Path) -> None:
    path = tmp_path / "ledger.jsonl"
    ledger = Ledger(path)
    ledger.note("opened families", "two_tanks")
    ledger.write("case_0", "sealed", "a")
    assert json.loads(path.read_text(encoding="utf-8").splitlines()[0])["text"] == "two_tanks"
    Ledger(path).write("case_0", "answered", "b")
    path.write_text(path.read_text(encoding="utf-8").replace("two_tanks", "serial"), encoding="utf-8")
    with pytest.raises(LedgerError):
        Ledger(path)


@pytest.mark.parametrize("family", [*DEVELOPMENT, *SEALED])
def test_each_family_has_a_lumped_twin_of_three_to_nine_volumes(family: str) -> None:
    for seed in range(4):
        plant = draw_plant(family, seed)
        network = sheet_twin(plant.sheet, fan_varies=True, pump_varies=True)
        assert 3 <= len(network.nodes) <= 9
        accepted = {t.column for t in plant.thermometers}
        assert {c for s in network.sensors for c in s.measured} == accepted
        assert network.tunables("commission")


def test_block_means_leave_out_the_rest() -> None:
    assert blocks(np.arange(481.0)[:, None])[:2, 0] == pytest.approx([0.5, 2.5])


def test_the_true_score_counts_what_re_tuning_cannot_absorb() -> None:
    n = 480
    calm, inputs = np.full((n, 1), 30.0), np.zeros((n, 1))
    late = (np.arange(n) >= n // 2).astype(float)[:, None]
    tunable = np.where(np.arange(240) < 120, 1.0, 0.0)[:, None]
    yard = Yardstick(lambda u: calm, 50.0 * tunable, np.full(240, 0.04), np.full(240, 0.01))
    # Nothing that the tunable does resembles an effect in the second half: 120 blocks of 0.1 K over 0.2 K.
    assert yard.scores(calm + 0.1 * late, inputs, calm, inputs) == pytest.approx((30.0**0.5, 120.0**0.5))
    # An effect in the first half is what the tunable does at a five-hundredth of its standard deviation.
    absorbed, _ = yard.scores(calm + 0.1 * (1.0 - late), inputs, calm, inputs)
    assert absorbed < 0.01
    assert yard.scores(calm, inputs, calm, inputs) == (0.0, 0.0)


def test_an_error_of_a_recorded_input_counts_through_the_twin() -> None:
    n = 240
    calm = np.full((n, 1), 30.0)
    yard = Yardstick(lambda u: 2.0 * u, np.zeros((240, 1)), np.full(240, 1.0), np.full(240, 1.0))
    seen, _ = yard.scores(calm, np.ones((n, 1)), calm, np.zeros((n, 1)))
    assert seen == pytest.approx(2.0 * 240.0**0.5)


def test_a_case_has_a_fitted_twin_and_an_effect_of_the_wanted_score_or_the_largest_size() -> None:
    case = make_case("layered_tank", 4, "thermometer: bias")
    truth = case.truth
    assert truth["answers"][0]["kind"] == "sensor"
    assert truth["answers"][0]["where"] == truth["place"]
    assert truth["size"] == pytest.approx(8.0) or truth["score"] == pytest.approx(truth["wanted"], rel=0.4)
    assert len(case.record.time_s) == truth["rows"] <= 150_000
    fitted, before = (case.network.revision.error_after_K, case.network.revision.error_before_K)
    assert all(fitted[name] < before[name] for name in fitted)
    column = case.network.sensor_names.index(truth["place"])
    after = case.record.time_s >= truth["onset_s"]
    healthy = make_case("layered_tank", 4, "thermometer: bias", size=0.0)
    change = (case.record.measured - healthy.record.measured)[:, column]
    assert change[after] == pytest.approx(truth["size"])
    assert np.abs(change[~after]).max(initial=0.0) < 1e-9


def test_an_effect_that_feeds_itself_is_made_smaller_until_its_plant_stays_within_numbers() -> None:
    truth = make_case("layered_tank", 780021, "heat above a temperature").truth
    assert np.isfinite(truth["score"]) and truth["size"] > 0.0


def test_reliability_sets_stated_confidences_beside_the_share_of_right_names() -> None:
    def named(confidence: float, right: bool) -> score.ZooScore:
        found = answer("effect found", (effect("heat_source", "tank", "pump_speed") | {"confidence": confidence},))
        return score.judge("case_0", truth(PUMP_HEAT if right else ANY_LOSS), found)

    sure = [named(0.9, k < 18) for k in range(24)]
    unsure = [named(0.4, k < 6) for k in range(12)]
    silent = [score.judge("case_1", truth(PUMP_HEAT), answer("unexplained"))] * 5
    table = next(t for t in tables([*sure, *silent, *unsure], "dev") if t.key == "reliability")
    assert [row[1] for row in table.rows] == [12, 12, 12]
    assert table.rows[0][2:4] == (pytest.approx(0.4), 0.5)
    assert [row[3] for row in table.rows] == [0.5, 1.0, 0.5]
    # A third of the effects each, with differences of 0.1, 0.1 and 0.4.
    assert "calibration error 0.200" in table.notes[0]
