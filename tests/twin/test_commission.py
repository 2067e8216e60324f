"""Commissioning on records whose truth is known, against scipy, and on records that cannot be fitted."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from tests.twin.conftest import START, drive
from twin.commissioning import CommissionOptions, commission
from twin.gauss_newton import FitData, GaussianPrior, Scaling, fit_initial_state, fit_parameters
from twin.kernel import Kernel, mask_measurements, simulate
from twin.network import Network, TwinFileError
from twin.twinfile import dump, parse

TRUTH = {
    "heater.capacitance": 4200.0,
    "tank.capacitance": 1.5e5,
    "circuit.factor": 1.08,
    "fins.UA_100": 52.0,
    "fins.fan_exponent": 0.72,
    "tank_loss.hA": 1.7,
}


def record(net: Network, n: int = 4 * 3600, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    t, u = drive(n, seed)
    u[:, 1] = np.repeat([100.0, 70.0, 85.0, 100.0], n // 4)
    rng = np.random.default_rng(seed)
    return t, u, simulate(net, t, u, START) + rng.normal(0.0, 1.0, (n, 4)) * net.sigma


def test_recovers_the_truth_and_reaches_the_noise(loop: Network) -> None:
    truth = loop.with_values(TRUTH)
    t, u, y = record(truth)
    done = commission(loop, t, u, y)
    for name, value in TRUTH.items():
        if name not in done.unidentifiable:
            assert abs(done.values[name] - value) < 4.0 * done.standard_error[name], name
    for name in ("circuit.factor", "fins.fan_exponent", "tank.capacitance", "heater.capacitance"):
        low, high = done.interval90[name]
        assert name not in done.unidentifiable
        assert low < done.values[name] < high
        assert done.values[name] == pytest.approx(TRUTH[name], rel=0.05)
    for name, sigma in zip(loop.sensor_names, loop.sigma, strict=True):
        assert done.rmse_after[name] < 1.05 * sigma
        assert done.rmse_before[name] > 5.0 * sigma
    assert done.held_out_s[0] == pytest.approx(0.8 * t[-1], abs=1.0)


def test_makes_a_new_revision_and_leaves_the_parent_alone(loop: Network) -> None:
    t, u, y = record(loop.with_values(TRUTH), n=3600)
    before = loop.values.copy()
    done = commission(loop, t, u, y, CommissionOptions(starts=1))
    assert np.array_equal(loop.values, before)
    revision = done.network.revision
    assert revision.number == 1
    assert revision.parent == loop.digest
    assert set(revision.error_after_K) == set(loop.sensor_names)
    again = parse(dump(done.network))
    assert again.revision == revision
    assert again.parameters == done.network.parameters


def test_names_what_the_record_cannot_tell(loop: Network) -> None:
    n = 3600
    t = np.arange(n) * 1.0
    u = np.tile([700.0, 100.0, 70.0, 22.0], (n, 1))  # nothing varies
    y = simulate(loop, t, u, START) + np.random.default_rng(0).normal(0.0, 1.0, (n, 4)) * loop.sigma
    done = commission(loop, t, u, y, CommissionOptions(starts=2))
    assert {"fins.fan_exponent", "fins.UA_still"} <= set(done.unidentifiable)
    assert any("did not vary" in note for note in done.notes)
    for name in done.unidentifiable:
        moved = f"{done.start[name]:.4g} to {done.values[name]:.4g}"
        is_kept = f"{done.start[name]:.4g}" == f"{done.values[name]:.4g}"
        said = "their values come from the twin file" if is_kept else f"{name} ({moved})"
        assert any(name in note and said in note for note in done.notes), name
    assert all(np.isfinite(list(done.values.values())))


def test_a_parameter_that_ends_where_its_effect_is_off_is_no_hint(loop: Network) -> None:
    ids = ("fins.UA_100", "T_tank_C.lag_s")
    t, u, y = record(loop.with_values(TRUTH), n=2400)
    early = y.copy()
    tank = loop.sensor_names.index("T_tank_C")
    early[:-20, tank] = y[20:, tank]  # a reading before its time: the lag ends at 0
    done = commission(loop, t, u, early, CommissionOptions(tunables=ids, starts=1))
    assert done.at_bound == ("T_tank_C.lag_s",)
    assert any(note.startswith("T_tank_C.lag_s = 0: the record shows no such effect") for note in done.notes)
    assert not any("ended on a bound" in note for note in done.notes)
    narrow = loop.with_values({"fins.UA_100": 40.0})
    parameters = {**narrow.parameters, "fins.UA_100": replace(narrow.parameters["fins.UA_100"], upper=41.0)}
    done = commission(replace(narrow, parameters=parameters), t, u, y, CommissionOptions(tunables=ids[:1], starts=1))
    assert any("fins.UA_100 ended on a bound" in note for note in done.notes)


def test_is_deterministic_and_fast_code_agrees_with_scipy(loop: Network) -> None:
    ids = ("fins.UA_100", "heater.capacitance", "tank_loss.hA", "circuit.factor")
    t, u, y = record(loop.with_values(TRUTH), n=2400)
    a = commission(loop, t, u, y, CommissionOptions(tunables=ids))
    b = commission(loop, t, u, y, CommissionOptions(tunables=ids))
    assert a.values == b.values
    kernel, scaling = Kernel(loop, ids), Scaling.of(loop, ids)
    fill, weight = mask_measurements(y, loop.sigma)
    low, high = scaling.to_z(scaling.lower), scaling.to_z(scaling.upper)

    def residual(v: np.ndarray) -> np.ndarray:
        full = loop.values.copy()
        full[scaling.index] = scaling.to_values(v[:4])
        return ((kernel.trace(full, v[4:], t, u)[0][0] - fill) * weight).ravel()

    z0 = np.concatenate([scaling.to_z(loop.values[scaling.index]), START])
    box = (np.concatenate([low, np.full(4, -100.0)]), np.concatenate([high, np.full(4, 200.0)]))
    oracle = least_squares(residual, z0, bounds=box, x_scale="jac", xtol=1e-12, ftol=1e-12)
    flat = GaussianPrior(z0, 1e-9 * np.eye(8))
    ours = fit_parameters(
        kernel, scaling, loop.values, FitData(t, u, fill, weight), loop.values[scaling.index], START, flat
    )
    assert ours.cost <= 2.0 * oracle.cost * (1.0 + 1e-6)
    assert ours.values == pytest.approx(scaling.to_values(oracle.x[:4]), rel=1e-3)


def test_a_truth_on_the_bound_ends_there(loop: Network) -> None:
    low, _ = loop.bounds(("tank_loss.hA",))
    t, u, y = record(loop.with_values({"tank_loss.hA": float(low[0])}), n=2400)
    kernel, scaling = Kernel(loop, ("tank_loss.hA",)), Scaling.of(loop, ("tank_loss.hA",))
    fill, weight = mask_measurements(y - 0.05, loop.sigma)
    flat = GaussianPrior(np.concatenate([[0.0], START]), 1e-9 * np.eye(5))
    fit = fit_parameters(
        kernel,
        scaling,
        loop.values,
        FitData(t, u, fill + 0.2 * (t[:, None] < 60), weight),
        np.array([2.5]),
        START,
        flat,
    )
    assert np.isfinite(fit.cost)
    assert scaling.lower[0] <= fit.values[0] <= scaling.upper[0]


def test_align_finds_the_initial_state(loop: Network) -> None:
    t, u, y = record(loop, n=60)
    fill, weight = mask_measurements(y, loop.sigma)
    found = fit_initial_state(Kernel(loop, ()), loop.values, START + 3.0, FitData(t, u, fill, weight), 5.0)
    assert np.abs(found - START).max() < 0.05


def test_masked_and_dead_sensors_do_not_spoil_the_fit(loop: Network) -> None:
    t, u, y = record(loop.with_values(TRUTH), n=3600)
    y[:, 2] = np.nan
    y[100:900] = np.nan
    u[50:60, 3] = np.nan
    done = commission(loop, t, u, y, CommissionOptions(starts=1))
    assert np.isnan(done.rmse_after["T_radiator_C"])
    assert done.rmse_after["T_tank_C"] < 0.06
    assert all(np.isfinite(list(done.values.values())))
    assert "T_radiator_C" not in done.network.revision.error_after_K


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t, u, y: (t[:50], u[:50], y[:50]), "needs at least 100 samples"),
        (lambda t, u, y: (t[::-1], u, y), "must not go back"),
        (lambda t, u, y: (t, u, np.full_like(y, np.nan)), "no finite measurement"),
        (lambda t, u, y: (t, u[:10], y), "differ in length"),
        (lambda t, u, y: (t, u[:, :2], y), "expected 4 input columns"),
    ],
)
def test_records_that_cannot_be_fitted(loop: Network, change, words: str) -> None:  # type: ignore[no-untyped-def]
    t, u, y = record(loop, n=1200)
    with pytest.raises(TwinFileError, match=words):
        commission(loop, *change(t, u, y))


def test_a_firm_initial_state_is_kept(loop: Network) -> None:
    t, u, y = record(loop.with_values(TRUTH), n=3600)
    y[:30] += 1.0
    loose, firm = (commission(loop, t, u, y, CommissionOptions(starts=1, initial_sd=sd)) for sd in (5.0, 0.001))
    first = y[:30].mean(axis=0)
    assert np.abs(firm.state[:4] - first).max() < 0.01
    assert np.abs(loose.state[:4] - first).max() > 0.5
    with pytest.raises(TwinFileError, match="initial_sd must be above 0"):
        commission(loop, t, u, y, CommissionOptions(initial_sd=0.0))


def test_the_first_guess_looks_no_further_than_the_first_move(loop: Network) -> None:
    t, u, y = record(loop, n=3600)
    u[:, 3] = 22.0
    u[:12, 0], u[12:, 0] = 600.0, 900.0
    y[12:] += 5.0
    firm = commission(loop, t, u, y, CommissionOptions(starts=1, initial_sd=0.001))
    assert np.abs(firm.state[:4] - y[:12].mean(axis=0)).max() < 0.01


def test_draws_spread_as_the_intervals_say(loop: Network) -> None:
    done = commission(loop, *record(loop.with_values(TRUTH)), CommissionOptions(starts=1))
    drawn = done.sample(4000)
    for name, sd in done.standard_error.items():
        column = drawn[:, loop.index([name])[0]]
        if name not in done.unidentifiable and name not in done.at_bound:
            assert column.std() == pytest.approx(sd, rel=0.15), name
            assert column.mean() == pytest.approx(done.values[name], abs=0.2 * sd)
    others = [i for i, name in enumerate(loop.ids) if name not in done.values]
    assert (drawn[:, others] == done.network.values[others]).all()


def test_what_the_record_shows_at_its_end_alone_is_fitted(loop: Network) -> None:
    """A fan that is off in the last fifth only: what the radiator then loses has to come from there."""
    truth = loop.with_values({**TRUTH, "fins.UA_still": 6.0})
    n = 4 * 3600
    t, u = drive(n, 0)
    u[:, 1] = np.repeat([100.0, 70.0, 85.0, 100.0], n // 4)
    u[int(0.92 * n) :, 2] = 0.0
    y = simulate(truth, t, u, START) + np.random.default_rng(0).normal(0.0, 1.0, (n, 4)) * loop.sigma
    done = commission(loop, t, u, y)
    assert done.held_out_s[1] < 0.92 * t[-1]
    assert done.held_out_s[1] - done.held_out_s[0] == pytest.approx(0.2 * t[-1], abs=2.0)
    assert "fins.UA_still" not in done.unidentifiable
    assert abs(done.values["fins.UA_still"] - 6.0) < 4.0 * done.standard_error["fins.UA_still"]
    for name, sigma in zip(loop.sensor_names, loop.sigma, strict=True):
        assert done.rmse_after[name] < 1.05 * sigma
    assert done.network.revision.held_out_s == done.held_out_s


def test_a_descent_from_few_samples_sees_the_same_heat_weight_and_restarts(loop: Network) -> None:
    t, u, y = record(loop, n=3600)
    weight = np.where(np.isfinite(y), 1.0 / loop.sigma, 0.0)
    full = FitData(t, u, y, weight, (0, 1234))
    few = full.thinned(10.0)
    assert few.begins == (0, 124) and few.time[124] == t[1234]
    assert len(few.time) == 361
    # All columns are held: the heat between two kept samples is that of all samples between them.
    lengths = np.diff(few.time, append=t[-1])[:, None]
    assert (few.inputs * lengths).sum(axis=0) == pytest.approx((u * np.diff(t, append=t[-1])[:, None]).sum(axis=0))
    assert (few.weight**2).sum() == pytest.approx((weight**2).sum(), rel=0.01)
    assert full.thinned(1.9) is full
    twice = FitData(np.repeat(t, 3), np.repeat(u, 3, 0), np.repeat(y, 3, 0), np.repeat(weight, 3, 0))
    assert twice.thinned(10.0) is twice  # a store that keeps each sample three times tells no period
