"""`hil bench audit`: replaced inputs, gradients by term, and verdicts that follow their figures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")

from hil.bench.audit import causes, loop, tower  # noqa: E402
from hil.bench.audit.probe import ALL_CHANNELS, EVIDENCE, Probe, ask  # noqa: E402
from hil.bench.audit.shares import between_plants, correction, intraclass, replacements, worst_share  # noqa: E402
from hil.bench.audit.subject import MemberAudit, OutputGain, SubjectAudit, TrainingProgress  # noqa: E402
from hil.bench.audit.terms import gradient_of, weighed  # noqa: E402
from tests.hil.tower.made_ensemble import write_ensemble  # noqa: E402
from tests.twin.hiera import fake  # noqa: E402
from tests.twin.hiera.tower_tables import made_table  # noqa: E402
from twin.calibrators.hiera_unet import Trainer, TrainingPlan  # noqa: E402
from twin.calibrators.hiera_unet.model.network import HieraUNet  # noqa: E402
from twin.calibrators.hiera_unet.tower import Fleet, load_tower_ensemble  # noqa: E402
from twin.calibrators.hiera_unet.training.train import Physics  # noqa: E402

PHYSICS = Physics(fake.simulate, fake.TOLD)
GROUPS = dict(zip(("u", "y"), fake.GROUPS, strict=True))


def probe(count: int = 8) -> Probe:
    return loop.probe_of(fake.config(), fake.windows(count), PHYSICS, GROUPS, None)


def network(alive: bool) -> HieraUNet:
    """Return an untrained network, or one with heads that read their features."""
    torch.manual_seed(0)
    made = HieraUNet(fake.config())
    if alive:
        for head in (made.parameter_head, made.output_head):
            torch.nn.init.normal_(head.out.weight, std=0.5)
    return made


def subject(made: HieraUNet) -> SubjectAudit:
    given = probe()
    trainer = Trainer(fake.config(), fake.windows(8), PHYSICS, TrainingPlan(steps=1, batch=6, pairs=1))
    trainer.done = 1
    losses = {"before training": loop.loss_terms(trainer)}
    progress = TrainingProgress("one", 100, 8, 400, -0.1, -0.1, -0.001)
    member = MemberAudit.of("one", made, given, 0)
    terms = (loop.OUTPUT_TERMS, loop.PARAMETER_TERMS, loop.TWIN_TERMS)
    return SubjectAudit(given, (member,), losses, terms, (progress,), sensitivities=0, channels=5)


def test_an_untrained_network_answers_by_its_evidence_token_alone() -> None:
    given = probe()
    found = {one.part: one for one in replacements(network(alive=False), given, 0)}
    assert found[ALL_CHANNELS].theta == found["u"].theta == found["y"].delta_K == 0.0
    assert found[EVIDENCE].theta > 0.01 and found[EVIDENCE].theta == pytest.approx(found["everything"].theta, rel=0.2)
    told = correction(network(alive=False), given)
    assert told.theta == pytest.approx(0.0, abs=1e-6) and told.delta_K == 0.0 and told.theta_start > 0.01


def test_channels_of_another_plant_move_a_network_that_reads_them() -> None:
    given = probe()
    found = {one.part: one for one in replacements(network(alive=True), given, 0)}
    assert found[ALL_CHANNELS].theta > 0.0 and found["u"].delta_K > 0.0
    assert ask(network(alive=True), given).theta.shape == (8, 2)


def test_replaced_inputs_are_those_of_the_other_windows_and_no_others() -> None:
    given = probe()
    other = given.other(np.random.default_rng(0))
    assert (given.plant[other] != given.plant).all()
    one = given.replaced("y", other)
    assert torch.equal(one.inputs["x"][..., 2:], given.inputs["x"][other][..., 2:])
    assert torch.equal(one.inputs["x"][..., :2], given.inputs["x"][..., :2])
    token = given.replaced(EVIDENCE, other).inputs["meta"]
    assert torch.equal(token[:, 2:], given.inputs["meta"][other][:, 2:])
    assert torch.equal(token[:, :2], given.inputs["meta"][:, :2])
    with pytest.raises(ValueError, match="of one plant"):
        replace(given, plant=np.zeros(8, dtype=np.int64)).other(np.random.default_rng(0))


def test_a_head_that_starts_at_zero_has_a_gradient_and_its_encoder_none() -> None:
    trainer = Trainer(fake.config(), fake.windows(8), PHYSICS, TrainingPlan(steps=1, batch=6, pairs=1))
    trainer.done = 1
    found = loop.loss_terms(trainer)
    assert sum(term.share for term in found) == pytest.approx(1.0)
    assert gradient_of(found, ("data",)) == 0.0 and gradient_of(found, ("data",), "output_head") > 0.0
    assert gradient_of(found, ("parameter",), "output_head") == 0.0


def test_terms_are_means_over_batches() -> None:
    made = network(alive=False)
    weight = made.output_head.out.bias
    batches = [{"a": (weight * k).sum() + k, "b": torch.tensor(1.0)} for k in (1.0, 3.0)]
    a, b = weighed(made, batches)
    assert (a.value, b.value) == (2.0, 1.0) and a.share == pytest.approx(2.0 / 3.0)
    assert a.gradients[2] == pytest.approx(2.0 * np.sqrt(weight.numel())) and b.gradients == (0.0, 0.0, 0.0)


def test_shares_of_an_error_between_plants() -> None:
    plant = np.repeat(np.arange(40), 5)
    rng = np.random.default_rng(0)
    assert intraclass(plant.astype(float), plant) == pytest.approx(1.0)
    assert intraclass(rng.normal(size=200), plant) < 0.15
    mixed = rng.normal(size=40)[plant] + rng.normal(size=200)
    assert intraclass(mixed, plant) == pytest.approx(0.5, abs=0.2)
    assert 0.0 <= between_plants(probe()) <= 1.0
    exponential = np.random.default_rng(1).exponential(size=20000)
    assert worst_share(exponential) == pytest.approx(causes.EXPONENTIAL, abs=0.01)


def test_verdicts_follow_their_figures() -> None:
    blind = {c.cause: c for c in causes.causes_of(subject(network(alive=False)))}
    assert blind["the parameters ignore the channels"].confirmed
    assert blind["the evidence token decides the parameters"].confirmed
    assert blind["no channel holds a sensitivity of the twin"].confirmed
    assert not blind["a label counts only where the fit can identify it"].confirmed
    assert not blind["the training was too short for the outputs"].confirmed
    found = subject(network(alive=False))
    member = found.members[0]
    sees = replace(member.replaced[ALL_CHANNELS], parameters_worse=(0.3, 0.1, 0.5))
    member = replace(member, replaced={**member.replaced, ALL_CHANNELS: sees})
    later = replace(found.trainings[0], late=-0.05)
    other = replace(found, members=(member,), trainings=(later,), sensitivities=3)
    told = {c.cause: c for c in causes.causes_of(other)}
    assert not told["the parameters ignore the channels"].confirmed
    assert not told["no channel holds a sensitivity of the twin"].confirmed
    assert told["the training was too short for the outputs"].confirmed


def test_a_correction_that_helps_on_its_own_records_alone_was_learned_by_heart() -> None:
    def gain(of: str, change: float) -> OutputGain:
        return OutputGain("one", of, "Gauss-Newton", 0.04, 0.1, 0.004, 0.7, (change, change, change), 1.0)

    whole = subject(network(alive=False))
    progress = replace(whole.trainings[0], losses=(1.0, 0.8), factors={50: 0.4, 100: 0.0, 150: 0.0})
    for others, by_heart in ((0.1, True), (-0.1, False)):
        gains = (gain(tower.LEARNED, -0.15), gain(tower.OTHERS, others), gain(tower.UNSEEN_WHOLE, 0.2))
        found = replace(whole, trainings=(progress,), gains=gains, factors={"one": 0.0})
        told = {c.cause: c for c in causes.blind_outputs(found, tower.LEARNED, tower.OTHERS, tower.GAUSS_NEWTON)}
        assert told["the correction was learned by heart"].confirmed is by_heart
        assert told["a stored factor of zero removes the correction"].confirmed
        assert "since step 100" in told["the training was too short"].finding
        assert not told["the training was too short"].confirmed
        assert not told["the output head starts at zero and never moves"].confirmed
    assert causes.blind_outputs(whole, tower.LEARNED, tower.OTHERS, tower.GAUSS_NEWTON) == []


def test_the_raw_correction_of_a_tower_member_is_that_without_its_factor(tmp_path: Path) -> None:
    ensemble = load_tower_ensemble(write_ensemble(tmp_path, blind_outputs=(0,), biased=0.5))
    member = ensemble.members[0]
    member.network.output_head.shrink.fill_(0.0)
    fleet = Fleet([made_table(f"F000{k}_1", seed=k) for k in range(2)])
    given = tower.probe_of(member.network, fleet, fleet.rows)
    assert set(given.groups) >= {"thermal", "evidence"} and given.inputs["memory"] is not None
    assert np.abs(ask(member.network, given).delta).max() == 0.0
    raw = tower.unshrunk(member.network)
    (gain,) = tower.gains_of("one", raw, fleet, fleet.rows, tower.LEARNED)
    # Half a unit of the head, whose unit is the tolerance of 0.3 K.
    assert gain.size_K == pytest.approx(0.15, abs=0.01) and gain.within_K < 0.01 and gain.start == tower.GAUSS_NEWTON
    assert float(member.network.output_head.shrink) == 0.0
