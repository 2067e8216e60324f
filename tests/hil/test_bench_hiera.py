"""`hil bench hiera`: its scores mean what they say, and its cases hold what their names promise."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from click.testing import CliRunner

from hil.bench.commands.bench import command
from hil.bench.hiera import cases as hiera_cases
from hil.bench.hiera import score as hiera_score
from hil.bench.hiera import trial as hiera
from hil.bench.hiera.contestants import BlindPredictions, commissioned, fitted, roster, sheet, tracked
from hil.bench.hiera.tables import goals
from hil.training.generate import features_of
from twin.calibrators.hiera_unet.data.windows import TARGET


@lru_cache(maxsize=1)
def features():
    return features_of()


@lru_cache(maxsize=1)
def heated():
    """The virtual rig's plant with heated modules."""
    return list(hiera_cases.virtual(features(), 0, 2))[1]


@lru_cache(maxsize=1)
def given():
    return sheet(features(), heated())


def scored(contestant) -> hiera_score.HieraScore:
    answer = contestant(features(), given())
    return hiera_score.score(given(), answer, commissioned(features(), given()), 0.1)


def test_a_case_changes_inside_the_window_that_it_says():
    case = heated()
    assert case.name == "modules heat" and case.kind == "tracked"
    assert not case.campaign.amiss[: case.onset].any() and case.campaign.amiss[case.onset + 1 :].all()
    assert case.first_after - 1 == case.onset // TARGET
    assert set(range(case.first_after, case.first_after + 6)) <= set(case.targets)


def test_the_commissioned_twin_does_not_recover_and_a_fit_does():
    plain, fit = scored(commissioned), scored(fitted)
    assert np.isinf(plain.recovered)
    assert fit.recovered <= 3.0
    assert hiera_score.pooled([fit], lambda s: s.after) < 0.3 * hiera_score.pooled([plain], lambda s: s.after)
    assert hiera_score.pooled([plain], lambda s: s.before) < 0.1


def test_a_tracker_predicts_ahead_with_what_it_knew_before():
    done, plain = scored(tracked("least_squares")), scored(commissioned)
    k = heated().targets.index(heated().first_after)
    assert done.rmse[k - 1] == pytest.approx(plain.rmse[k - 1], rel=0.5)
    assert done.rmse[k + 2] < 0.3 * plain.rmse[k + 2]


def test_a_perfect_answer_scores_nought_and_recovers_at_once():
    truth = heated().truth()
    right = BlindPredictions(truth, given().theta, np.ones(len(truth), dtype=bool), 0.0)
    found = hiera_score.score(given(), right, commissioned(features(), given()), 0.1)
    assert found.recovered == 1.0
    assert np.nanmax(found.rmse) == 0.0 and np.nanmax(np.abs(found.off)) == 0.0
    assert hiera_score.falsely_calibrated([found], 0.1) == 0.0


def test_a_case_without_a_change_is_not_counted_as_recovered():
    healthy = next(hiera_cases.virtual(features(), 0, 1))
    own = sheet(features(), healthy)
    plain = commissioned(features(), own)
    found = hiera_score.score(own, plain, plain, 0.1)
    assert np.isnan(found.recovered)
    assert np.isnan(hiera_score.share_recovered([found], 2.0))
    assert found.before.all() and not found.after.any()


def test_constant_widths_hold_their_share_of_exchangeable_errors():
    rng, one = np.random.default_rng(0), scored(commissioned)
    many = [replace(one, error=rng.normal(size=(10, 120, 4)) * [0.1, 0.2, 0.3, 0.4]) for _ in range(60)]
    widths = hiera_score.constant_widths(many[:40], 0)
    share, width = hiera_score.coverage(many[40:], widths)
    assert share == pytest.approx(0.9, abs=0.04)
    assert width == pytest.approx(2.0 * 1.645 * 0.25, rel=0.1)


def test_what_is_held_does_not_count_as_accepted_and_told():
    one = scored(commissioned)
    off = np.full_like(one.off, 3.0)
    off[:, 0] = 1.0
    sure = np.where(off == 1.0, 0.5, np.nan)
    everything = np.ones(len(off), dtype=bool)
    given_up = replace(one, off=off, sure=sure, calibrated=everything, before=everything)
    assert hiera_score.over_bound([given_up], accepted=True, told=True) == pytest.approx(1.0)
    assert hiera_score.over_bound([given_up], accepted=True) > 2.0
    nothing = replace(given_up, calibrated=~everything)
    assert np.isnan(hiera_score.over_bound([nothing], accepted=True, told=True))


def test_own_widths_are_brought_to_their_promise():
    rng, one = np.random.default_rng(1), scored(commissioned)
    scale = np.exp(rng.normal(size=(60, 10, 1, 1)))
    many = [replace(one, error=s * rng.normal(size=(10, 120, 4)), half=np.broadcast_to(s, (10, 120, 4))) for s in scale]
    factors = hiera_score.own_factors(many[:40], 0)
    assert hiera_score.coverage(many[40:], factors, own=True)[0] == pytest.approx(0.9, abs=0.04)


def test_parameters_inside_their_own_intervals_are_counted_where_the_data_tells_them():
    right = BlindPredictions(heated().truth(), given().theta, np.ones(len(heated().targets), dtype=bool), 0.0)
    plain = commissioned(features(), given())
    wide, off = np.full(given().theta.shape, 0.1), np.where(np.arange(given().theta.shape[1]) % 2, 0.05, 0.2)
    shares = [
        hiera_score.sure([hiera_score.score(given(), answer, plain, 0.1)], lambda s: s.after)
        for answer in (
            replace(right, theta_half=wide),
            replace(right, theta=right.theta + off, theta_half=wide),
            right,
            replace(right, theta_half=np.full(wide.shape, np.nan)),
        )
    ]
    after = hiera_score.score(given(), right, plain, 0.1).after
    known = given().known[after]
    assert shares[0] == 1.0
    assert shares[1] == pytest.approx(known[:, 1::2].sum() / known.sum())
    assert np.isnan(shares[2:]).all()


def test_a_tracker_is_told_the_noise_of_means_and_gives_intervals_of_deviations():
    answer = tracked("least_squares")(features(), given())
    assert answer.theta_half is not None and answer.theta_half.shape == answer.theta.shape
    one = hiera_score.score(given(), answer, commissioned(features(), given()), 0.1)
    assert hiera_score.sure([one], lambda s: s.before) > 0.7


def test_hiding_channels_hides_them_from_everyone_but_not_from_the_score():
    case = heated()
    fewer = hiera_cases.hidden(case, 0.25, 1)
    both = np.hstack([fewer.campaign.series.inputs, fewer.campaign.series.measured])
    assert np.isnan(both[400:]).all(axis=0).sum() == 2
    np.testing.assert_array_equal(fewer.truth(), case.truth())


def test_the_tables_of_a_small_run_name_every_contestant(tmp_path):
    size = hiera.HieraSize(
        seeds=(0,),
        simulated=1,
        virtual=1,
        rigs=("simulated", "virtual", "stranger"),
        trackers=("least_squares",),
        lost=(0.25,),
        calibrating=2,
    )
    tables, left_out = hiera.measure(size, 0, tmp_path, lambda share, note: None)
    assert any("network" in line for line in left_out)
    assert any("stranger" in line for line in left_out)
    named = {row[1] for table in tables if table.key == "errors" for row in table.rows}
    assert named == set(roster(("least_squares",)))
    assert {t.key for t in tables} >= {
        "errors",
        "recovery",
        "parameters",
        "parameter_intervals",
        "intervals",
        "lost",
        "flags",
        "cost",
    }


def test_an_unknown_rig_is_refused():
    done = CliRunner().invoke(command, ["hiera", "--rig", "mars"])
    assert done.exit_code == 2
    assert "simulated, virtual, stranger" in done.output


def test_an_untrained_network_predicts_what_its_evidence_does_and_a_fit_from_it_as_well(tmp_path):
    pytest.importorskip("torch", reason="torch is not installed: the network takes no part")
    pytest.importorskip("safetensors", reason="safetensors is not installed: trained networks cannot be read")
    from hil.bench.hiera.network import contestants
    from tests.twin.hiera.loop_ensemble import ensemble_card

    both = contestants(ensemble_card(tmp_path), features())
    alone, then_fit, fit = scored(both["network"]), scored(both["network, fit"]), scored(fitted)
    assert alone.half is not None and np.isfinite(alone.error).all()
    assert np.nanmedian(np.abs(alone.rmse - fit.rmse)) < 0.03
    assert then_fit.recovered <= fit.recovered
    assert alone.cpu_s > fit.cpu_s


def test_on_strangers_alone_only_what_is_known_of_them_is_asked():
    one = replace(scored(commissioned), rig="stranger")
    own = replace(one, half=np.ones_like(one.error))
    found = hiera.HieraResults({"network": [own, own], "fit of 2 h": [one, one]}, {}, {"network": [own] * 12}, 0.1)
    (table,) = goals(found)
    assert [row[1] for row in table.rows] == ["changes recovered by 2", "changes in which worse than fit of 2 h"]


def test_without_its_rival_a_contestant_is_measured_against_none():
    one = replace(scored(commissioned), rig="stranger")
    found = hiera.HieraResults({"network": [one]}, {}, {"network": [one] * 12}, 0.1)
    (table,) = goals(found)
    assert [row[1] for row in table.rows] == ["changes recovered by 2"]
