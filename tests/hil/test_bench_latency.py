"""What a forward of the network costs: it is timed, with all weights of its configuration."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")

from hil.bench.hiera.latency import latency  # noqa: E402
from twin.calibrators.hiera_unet.model.config import HieraError  # noqa: E402


@pytest.mark.parametrize(("config", "weights"), [("small", 1.09e6), ("full", 18.7e6)])
def test_a_forward_of_all_weights_is_timed_on_one_thread(config: str, weights: float) -> None:
    threads = torch.get_num_threads()
    found = latency(config, repetitions=3)
    assert 0.0 < found.minimum_ms <= found.median_ms and found.repetitions == 3
    assert found.weights == pytest.approx(weights, rel=0.01) and torch.get_num_threads() == threads


def test_what_cannot_be_timed_is_refused() -> None:
    with pytest.raises(HieraError, match="no configuration 'huge'"):
        latency("huge")
    with pytest.raises(ValueError, match="ask for one or more"):
        latency("small", repetitions=0)
