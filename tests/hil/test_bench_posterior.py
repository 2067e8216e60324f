"""`hil bench posterior`: calibrators begin alike, and the sampler finds the posterior that it is asked for."""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from click.testing import CliRunner

from hil.bench.commands.bench import command
from hil.bench.posterior import trial
from hil.bench.posterior.windows import PosteriorWindow, posterior_windows
from twin.gauss_newton import Scaling


@lru_cache(maxsize=1)
def windows() -> tuple[PosteriorWindow, ...]:
    return tuple(posterior_windows(2, 0, 5))


def scaling() -> Scaling:
    return Scaling.of(windows()[0].network, windows()[0].network.tunables("nine"))


def test_without_numpyro_the_benchmark_is_left_out_with_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numpyro", None)
    monkeypatch.delitem(sys.modules, "hil.bench.posterior.nuts", raising=False)
    done = CliRunner().invoke(command, ["posterior", "--quick"])
    assert done.exit_code == 0
    assert "numpyro: not installed" in done.output


def test_a_changed_window_lies_wholly_after_the_change() -> None:
    changed, healthy = windows()
    assert (changed.state, healthy.state) == ("changed", "healthy")
    assert changed.window.error_K > healthy.window.error_K
    opened = np.diag(changed.before.covariance - changed.known.covariance)
    assert (opened > np.diag(healthy.before.covariance - healthy.known.covariance)).all()


def test_swarm_and_least_squares_agree_from_the_same_prior() -> None:
    healthy = windows()[1]
    least, swarm = (trial.calibrated(name, healthy, scaling(), 0) for name in ("least_squares", "pso"))
    assert least.covariance is not None and swarm.covariance is not None
    assert least.frozen == swarm.frozen
    sd = np.sqrt(np.diag(least.covariance))
    assert np.abs(np.array(list(swarm.values.values())) - np.array(list(least.values.values()))).max() < sd.max()
    np.testing.assert_allclose(np.sqrt(np.diag(swarm.covariance)), sd, rtol=0.2)


@pytest.mark.skipif(importlib.util.find_spec("numpyro") is None, reason="numpyro is not installed")
def test_a_narrow_prior_is_its_own_posterior_and_the_kernel_agrees_with_jax() -> None:
    from hil.bench.posterior.nuts import PosteriorSampler

    healthy = windows()[1]
    model, start = trial.stated_model(healthy, scaling())
    narrow = replace(model, covariance=1e-10 * np.eye(start.size), mean=start)
    draws = PosteriorSampler(healthy.network, scaling().ids, 100, 300).draw(narrow, start, 0)
    assert draws.kernel_K < 1e-5
    np.testing.assert_allclose(draws.z.mean(axis=0), start[: draws.z.shape[1]], atol=1e-5)
    np.testing.assert_allclose(draws.z.std(axis=0), 1e-5, rtol=0.3)
