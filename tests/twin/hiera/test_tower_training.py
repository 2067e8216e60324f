"""Training of a tower network, its gate against blindness, and the answers of the loop's weights beside it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")
pytest.importorskip("safetensors", reason="safetensors is not installed: trained networks cannot be read")

from tests.twin.hiera.tower_tables import BIAS, made_table  # noqa: E402
from twin.calibrators.hiera_unet.model.config import HieraError  # noqa: E402
from twin.calibrators.hiera_unet.serve.service import TRAINED  # noqa: E402
from twin.calibrators.hiera_unet.tower.member import MemberTraining, adapt, load_member  # noqa: E402
from twin.calibrators.hiera_unet.tower.plan import TowerPlan  # noqa: E402
from twin.calibrators.hiera_unet.tower.predict import (  # noqa: E402
    BLIND,
    NOT_TESTED,
    Blindness,
    blindness,
    interval,
    predict,
)
from twin.calibrators.hiera_unet.tower.score import IntervalFactors, believed, mixed, scores, targets_of  # noqa: E402
from twin.calibrators.hiera_unet.tower.table import SUBJECT  # noqa: E402
from twin.calibrators.hiera_unet.tower.train import TowerTrainer  # noqa: E402
from twin.calibrators.hiera_unet.tower.windows import Fleet  # noqa: E402
from twin.calibrators.hiera_unet.weights import checkpoint  # noqa: E402

PLAN = TowerPlan(steps=6, batch=3, pairs=0.34)


@pytest.fixture(scope="module")
def fleet() -> Fleet:
    return Fleet([made_table(seed=0), made_table("made_2", seed=1)])


@pytest.fixture(scope="module")
def member_file(fleet: Fleet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Weights and card of an untrained member."""
    path = tmp_path_factory.mktemp("member") / "tower_small_0.safetensors"
    MemberTraining("small", PLAN, fleet, fleet, None, "data").write(path, NOT_TESTED, {})
    return path


def test_an_untrained_network_says_what_the_belief_says(fleet: Fleet) -> None:
    trainer = TowerTrainer(SUBJECT.config("small"), fleet, PLAN)
    rows = fleet.rows[:6]
    t = targets_of(fleet, rows)
    found, sd, water_sd = mixed(t, [predict(trainer.network, fleet, rows)])
    np.testing.assert_allclose(found.theta, t.mean, atol=1e-5)
    np.testing.assert_allclose(found.water, t.water, atol=1e-4)
    np.testing.assert_allclose(sd, t.sd, rtol=0.05)
    assert (water_sd > 0.0).all()


def test_a_training_that_was_cut_ends_as_one_that_was_not(fleet: Fleet) -> None:
    whole = TowerTrainer(SUBJECT.config("small"), fleet, PLAN, "data")
    for _ in range(4):
        whole.step()
    first = TowerTrainer(SUBJECT.config("small"), fleet, PLAN, "data")
    for _ in range(2):
        first.step()
    second = TowerTrainer(SUBJECT.config("small"), fleet, PLAN, "data")
    second.restore(first.state())
    for _ in range(2):
        second.step()
    for a, b in zip(whole.network.parameters(), second.network.parameters(), strict=True):
        assert torch.equal(a, b)
    other = TowerTrainer(SUBJECT.config("small"), fleet, replace(PLAN, steps=7), "data")
    with pytest.raises(HieraError, match=r"^OTHER_PLAN: .* another configuration, plan or data: steps was 6, is 7;"):
        other.restore(first.state())


def test_a_network_that_ignores_its_channels_is_refused_and_its_card_says_so(fleet: Fleet, tmp_path: Path) -> None:
    training = MemberTraining("small", replace(PLAN, steps=1), fleet, fleet, tmp_path / "member", "data")
    assert training.run(None, lambda: False, lambda *_: None)
    gate = training.gate(8)
    assert gate.code == BLIND
    path = tmp_path / "tower_small_0.safetensors"
    training.write(path, gate, {"command": "hil train tower"})
    with pytest.raises(HieraError, match="BLIND"):
        load_member(path)
    member = load_member(path, blind_too=True)
    assert member.card["gate"]["code"] == BLIND and member.card["refused"] == BLIND
    x, y = training.trainer.average.parameters().__next__(), member.network.parameters().__next__()
    assert torch.allclose(x, y, atol=1e-3)


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("table", "another", "^OTHER_TABLE: .* another channel table"),
        ("format", 1, "^OTHER_FORMAT: .* format 1, not"),
        ("parameters", ["fill", "air"], "^OTHER_PARAMETERS: .* tell fill, air"),
        ("twin", "loop", "^OTHER_SUBJECT: .* another structure"),
    ],
)
def test_a_member_of_another_table_format_or_twin_is_refused(
    member_file: Path, tmp_path: Path, key: str, value: object, says: str
) -> None:
    path = tmp_path / member_file.name
    path.write_bytes(member_file.read_bytes())
    card = json.loads(member_file.with_suffix(".json").read_text())
    path.with_suffix(".json").write_text(json.dumps({**card, key: value}))
    with pytest.raises(HieraError, match=says):
        load_member(path, blind_too=True)


def test_a_member_without_its_weights_is_refused(member_file: Path, tmp_path: Path) -> None:
    path = tmp_path / member_file.name
    path.with_suffix(".json").write_text(member_file.with_suffix(".json").read_text())
    with pytest.raises(HieraError, match=r"^MISSING_MEMBER: .* are missing; put them beside the card"):
        load_member(path, blind_too=True)


def test_a_station_without_nine_months_or_without_a_window_in_them_adapts_nothing(fleet: Fleet) -> None:
    network = TowerTrainer(SUBJECT.config("small"), fleet, PLAN).network
    with pytest.raises(HieraError, match=r"^FEW_MONTHS: the station's record has 0\.1 months, .* its first 9; give a"):
        adapt(network, fleet, fleet, PLAN, 0.0)
    with pytest.raises(HieraError, match=r"^NO_WINDOW: the station has no window in its first 0\.02 months"):
        adapt(network, fleet, fleet, PLAN, 0.0, months=0.02)


def test_the_gate_judges_each_head_by_its_own_figures() -> None:
    sure, weak, unsure = (0.2, 0.1, 0.3), (0.04, 0.02, 0.06), (0.2, -0.1, 0.5)
    for one, code in ((sure, ""), (weak, BLIND), (unsure, BLIND)):
        for other, its in ((sure, ""), (weak, BLIND), (unsure, BLIND)):
            gate = Blindness(one, other, 10)
            assert (gate.code, gate.outputs_code) == (code, its)


def test_the_gate_sees_a_network_that_reads_the_residual(fleet: Fleet) -> None:
    class Reader(torch.nn.Module):
        """Bias by the mean residual of the day, and the outlet by a channel of the target."""

        config = replace(SUBJECT.config("small"), corrects=False)
        trees, start_outlet = None, False

        def forward(self, x, m, regime, clock, meta, *, causal, memory):  # type: ignore[no-untyped-def]
            from twin.calibrators.hiera_unet.model.network import Prediction

            seen = (x * m)[:, :1320, SUBJECT.index("r_outlet")].sum(1) / m[:, :1320, SUBJECT.index("r_outlet")].sum(1)
            theta = meta[:, -13:-9].clone()
            theta[:, 3] = theta[:, 3] + 0.3 * seen
            delta = 0.1 * x[:, -120:, :1]
            zero = torch.zeros(len(x), 120, 1)
            return Prediction(theta, torch.zeros(len(x), 4), delta, zero, torch.zeros(len(x), 4, 12))

    tables = [made_table(seed=0), made_table("made_2", seed=1)]
    moved = replace(tables[1], reading=tables[1].reading + 1.0, outlet=tables[1].outlet + 1.0)
    moved = replace(moved, true=moved.true + np.array([0, 0, 0, 1.0], dtype=np.float32))
    found = blindness(Reader(), Fleet([tables[0], moved]), 30)  # type: ignore[arg-type]
    assert found.parameters[0] > 0.05 and found.parameters[1] > 0.0


def test_scores_count_hidden_truth_and_intervals_hold_their_share(fleet: Fleet) -> None:
    rows = fleet.rows
    t = targets_of(fleet, rows)
    belief = believed(t)
    found = scores(t, belief)
    assert found["deviation_mae"]["bias"] == pytest.approx(BIAS - 0.05, abs=1e-3)
    assert found["deviation_mae"]["fill"] == pytest.approx(0.01, abs=1e-4)
    sd, water_sd = np.full_like(t.sd, 0.5), np.full_like(t.water, 0.5)
    limited = IntervalFactors.of(t, belief, sd, water_sd).applied(belief, sd, water_sd)
    assert 0.8 <= scores(t, limited)["water_inside_90"] <= 1.0


def test_an_interval_of_a_ratio_holds_its_mean_and_excludes_none_where_all_are_worse() -> None:
    rng = np.random.default_rng(0)
    rival = rng.uniform(1.0, 2.0, 400)
    mean, low, high = interval(1.2 * rival, rival, np.arange(400) // 20, rng)
    assert mean == pytest.approx(0.2) and low == pytest.approx(0.2) and high == pytest.approx(0.2)
    _, low, high = interval(rival[::-1], rival, np.arange(400) // 20, rng)
    assert low < 0.0 < high


def test_weights_of_the_loop_are_refused_as_a_tower_and_answer_as_before() -> None:
    path = TRAINED / "loop_small_0.safetensors"
    if not path.exists():
        pytest.skip("no trained network is shipped")
    with pytest.raises(HieraError, match="another structure"):
        load_member(path)
    network = checkpoint.load(path).network.double()
    c = network.config
    i, j = np.arange(c.context)[:, None], np.arange(c.channels)[None]
    x = torch.from_numpy(np.sin(0.013 * i * (1 + 0.3 * j) + j))[None]
    m = torch.from_numpy((np.cos(0.05 * i + j) > -0.7).astype(float))[None]
    regime = torch.from_numpy((np.arange(c.context) // 200) % c.regimes)[None]
    clock = torch.from_numpy(np.sin(0.002 * i + np.arange(c.clock)[None]))[None]
    meta = torch.from_numpy(0.05 * np.cos(np.arange(c.meta) * 1.7)).abs()[None] + 0.02
    before = {
        False: (
            [
                -0.00335243742,
                0.123073771,
                -0.263313256,
                0.0490453201,
                0.0631578014,
                0.0440434275,
                0.0607381258,
                0.0319631054,
                0.0812602502,
            ],
            [-0.000459816686, -0.000745190784, -9.95711249e-06, 0.000638765572],
        ),
        True: (
            [
                -0.00373295643,
                0.124176893,
                -0.262609933,
                0.0487818674,
                0.0637455347,
                0.0448727742,
                0.0607550578,
                0.0317733359,
                0.0769103854,
            ],
            [-0.00033734716, -0.000596242453, 3.79322997e-06, 0.000632156953],
        ),
    }
    for causal, (theta, delta) in before.items():
        with torch.inference_mode():
            p = network(x, m, regime, clock, meta, causal=causal)
        np.testing.assert_allclose(p.theta[0].numpy(), theta, rtol=3e-7, atol=1e-9)
        np.testing.assert_allclose(p.delta[0, 0, :4].numpy(), delta, rtol=3e-6, atol=1e-10)
