"""Unmodelled effects while a record goes on: energy balance, window scores, network, weights, watch."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from tests.twin.hiera.effects_rig import HEATED, PROJECT, record, twin  # noqa: E402
from twin.calibrators.hiera_unet.effects.balance import Balance, Figures  # noqa: E402
from twin.calibrators.hiera_unet.effects.courses import linear_course  # noqa: E402
from twin.calibrators.hiera_unet.effects.labels import Effect, Example, example  # noqa: E402
from twin.calibrators.hiera_unet.effects.member import EffectsMember, load_effects, save_effects  # noqa: E402
from twin.calibrators.hiera_unet.effects.memory import Memory, learn  # noqa: E402
from twin.calibrators.hiera_unet.effects.network import EffectsNetwork  # noqa: E402
from twin.calibrators.hiera_unet.effects.scores import window_scores  # noqa: E402
from twin.calibrators.hiera_unet.effects.tokens import WIDTH, tokens  # noqa: E402
from twin.calibrators.hiera_unet.effects.train import EffectsPlan, EffectsTrainer  # noqa: E402
from twin.calibrators.hiera_unet.effects.watch import EffectAnswer, EffectsWatch  # noqa: E402
from twin.calibrators.hiera_unet.model.config import HieraError  # noqa: E402
from twin.twinfile import load  # noqa: E402

ONSET_S = 7200.0


@cache
def balance() -> Balance:
    return Balance(twin())


@cache
def healthy() -> Figures:
    return balance().figures(*record(10.0, 1))


@cache
def memory() -> Memory:
    return learn(healthy())


@cache
def heated(power_W: float = 60.0, bias_K: float = 0.0) -> Figures:
    return balance().figures(*record(4.0, 2, power_W, ONSET_S, bias_K))


def untrained(seed: int = 0) -> EffectsMember:
    torch.manual_seed(seed)
    return EffectsMember(EffectsNetwork().eval())


def test_the_balance_shows_hidden_heat_at_its_node_and_nowhere_else() -> None:
    figures = heated()
    nodes = twin().nodes
    before, after = figures.end_s <= ONSET_S, figures.end_s > ONSET_S + 900.0
    change = figures.power[after].mean(axis=0) - figures.power[before].mean(axis=0)
    assert change[nodes.index(HEATED)] == pytest.approx(60.0, abs=3.0)
    assert np.abs(np.delete(change, nodes.index(HEATED))).max() < 3.0


def test_windows_that_overlap_by_half_miss_no_energy() -> None:
    whole, every = heated(), 300.0
    inside = (whole.end_s > ONSET_S) & (whole.end_s <= ONSET_S + 3600.0)
    energy = every * (whole.power[inside, twin().nodes.index(HEATED)]).sum()
    assert energy == pytest.approx(60.0 * 3600.0, rel=0.1)


@pytest.mark.parametrize(("power_W", "bias_K", "where"), [(60.0, 0.0, HEATED), (0.0, 1.5, "T_tank_C")])
def test_the_largest_window_score_names_the_place_and_the_size_within_two_windows(
    power_W: float, bias_K: float, where: str
) -> None:
    figures = heated(power_W, bias_K)
    course = linear_course(window_scores(figures, memory()))
    calm = course.statistic[figures.end_s <= ONSET_S].max()
    at = int(np.searchsorted(figures.end_s, ONSET_S + 1200.0))
    assert course.statistic[at] > 3.0 * calm
    named = balance().hypotheses[int(course.hypothesis[at])]
    assert named.where == where
    if named.kind in ("heat_source", "sensor"):
        assert course.size[at] == pytest.approx(power_W or bias_K, rel=0.25)


def test_nothing_before_a_moment_depends_on_later_samples() -> None:
    t, inputs, readings = record(4.0, 2, 60.0, ONSET_S)
    late = t > ONSET_S
    other_inputs, other = inputs.copy(), readings.copy()
    other[late] += 3.0
    other_inputs[late, 0] *= 0.5
    found = []
    for u, y in ((inputs, readings), (other_inputs, other)):
        figures = balance().figures(t, u, y)
        found.append(untrained().course(window_scores(figures, memory()), balance().hypotheses))
    before = figures.end_s <= ONSET_S
    for name in ("statistic", "hypothesis", "size", "size_low", "since_s", "since_high_s"):
        one, two = (getattr(course, name) for course in found)
        assert np.allclose(one[before], two[before], rtol=1e-6)
    assert not np.allclose(found[0].statistic[~before], found[1].statistic[~before])


def test_hypotheses_in_another_order_give_the_answers_in_that_order() -> None:
    one = torch.from_numpy(tokens(window_scores(heated(), memory()), balance().hypotheses))[None]
    order = torch.randperm(one.shape[2], generator=torch.Generator().manual_seed(1))
    network, real = untrained().network, torch.ones(1, one.shape[2], dtype=torch.bool)
    with torch.inference_mode():
        straight, mixed = network(one, real), network(one[:, :, order], real)
    for name in ("log_odds", "weight", "size_scale", "since"):
        assert torch.allclose(getattr(straight, name)[:, :, order], getattr(mixed, name), atol=1e-4)


def test_padding_changes_no_answer() -> None:
    one = torch.from_numpy(tokens(window_scores(heated(), memory()), balance().hypotheses))[None]
    h = one.shape[2]
    padded = torch.cat([one, torch.full((1, one.shape[1], 5, WIDTH), 3.0)], dim=2)
    real = torch.arange(h + 5)[None] < h
    with torch.inference_mode():
        alone, beside = untrained().network(one, real[:, :h]), untrained().network(padded, real)
    assert torch.allclose(alone.log_odds, beside.log_odds[:, :, :h], atol=1e-4)
    assert bool((beside.log_odds[:, :, h:] < -1e3).all())


def test_weights_come_back_as_they_were_saved(tmp_path: Path) -> None:
    member = replace(untrained(), threshold=3.5, since_factor=1.7, size_factor=2.9, card={"seed": 4})
    save_effects(member, tmp_path / "effects.safetensors")
    back = load_effects(tmp_path / "effects.safetensors")
    scores = window_scores(heated(), memory())
    one, two = (m.course(scores, balance().hypotheses) for m in (member, back))
    assert np.array_equal(one.statistic, two.statistic)
    assert np.array_equal(one.size_high, two.size_high)
    assert (back.threshold, back.card["seed"]) == (3.5, 4)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"format": 99}, "OTHER_FORMAT"),
        ({"subject": "loop"}, "OTHER_SUBJECT"),
        ({"table": {}}, "OTHER_TABLE"),
        ({"weights": {"sha256": "0"}}, "OTHER_MEMBER"),
    ],
)
def test_weights_of_another_kind_are_refused_in_one_sentence(tmp_path: Path, change: dict[str, Any], code: str) -> None:
    card = save_effects(untrained(), tmp_path / "effects.safetensors")
    card.write_text(json.dumps(json.loads(card.read_text()) | change))
    with pytest.raises(HieraError, match=r"effects\.json") as refused:
        load_effects(tmp_path / "effects.safetensors")
    assert refused.value.code == code
    assert "\n" not in str(refused.value)


def test_a_missing_card_is_named(tmp_path: Path) -> None:
    with pytest.raises(HieraError, match=r"no model card .*effects\.json"):
        load_effects(tmp_path / "effects.safetensors")


def test_samples_in_pieces_give_the_answers_of_the_whole_record() -> None:
    t, inputs, readings = record(3.0, 2, 60.0, ONSET_S)
    course = untrained().course(window_scores(balance().figures(t, inputs, readings), memory()), balance().hypotheses)
    watch = EffectsWatch(twin(), healthy(), untrained())
    answers: list[EffectAnswer] = []
    for begin in range(0, len(t), 47):
        piece = slice(begin, begin + 47)
        answers += watch.push(t[piece], inputs[piece], readings[piece])
    assert [a.end_s for a in answers] == list(np.arange(600.0, t[-1] + 1.0, 300.0))
    named = [balance().hypotheses[int(h)] for h in course.hypothesis]
    assert [(a.kind, a.where) for a in answers] == [(h.named, h.where) for h in named]
    assert np.allclose([a.size for a in answers], course.size, rtol=1e-3, atol=1e-6)


def test_a_twin_without_a_thermometer_at_a_node_is_refused() -> None:
    with pytest.raises(HieraError, match="no thermometer at element") as refused:
        Balance(load(PROJECT / "profiles" / "twins" / "loop_six.toml"))
    assert refused.value.code == "OTHER_TWIN"


def test_a_short_healthy_record_is_refused() -> None:
    with pytest.raises(HieraError, match="give at least 36"):
        learn(balance().figures(*record(1.0, 1)))


def test_a_window_with_lost_readings_is_void() -> None:
    t, inputs, readings = record(1.0, 2)
    readings[(t > 600.0) & (t < 900.0)] = np.nan
    valid = balance().figures(t, inputs, readings).valid
    assert not valid[1]
    assert valid[0]
    assert valid[-1]


@cache
def lessons() -> tuple[Example, ...]:
    figures, calm = heated(), heated(0.0)
    truth = Effect((HEATED,), (("heat_source", HEATED),), ONSET_S, np.full(len(figures.end_s), 60.0), "heat_source")
    hypotheses = balance().hypotheses
    return (
        example(figures, calm, memory(), hypotheses, truth),
        example(calm, calm, memory(), hypotheses, None),
    )


def test_an_effect_has_to_be_named_only_once_it_shows() -> None:
    shown, none = lessons()
    acting = shown.since > 0.0
    assert set(shown.state[~acting]) == {0}
    assert shown.state[-1] == 1
    assert set(none.state) == {0}
    assert not none.place.any()


def test_a_training_learns_and_continues_as_if_it_had_not_stopped() -> None:
    plan = EffectsPlan(steps=30, batch=4)
    whole = EffectsTrainer(lessons(), plan)
    losses = [whole.step()["loss"] for _ in range(30)]
    assert np.mean(losses[-5:]) < 0.7 * np.mean(losses[:5])
    first, second = EffectsTrainer(lessons(), plan), EffectsTrainer(lessons(), plan)
    for _ in range(3):
        first.step()
    second.restore(first.state())
    assert second.step()["loss"] == losses[3]
    with pytest.raises(HieraError, match="another plan"):
        EffectsTrainer(lessons(), replace(plan, seed=1)).restore(first.state())
