"""Two linked nodes on which one element at a time is tried."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from twin.kernel import simulate
from twin.network import Network
from twin.reference_simulation import right_hand_side
from twin.twinfile import parse

TWO = """
format = 1
name = "two"
[inputs]
heater_power_W = { nominal = 500.0 }
pump_speed_pct = { nominal = 100.0 }
fan_speed_pct = { nominal = 50.0 }
T_ambient_C = { nominal = 20.0 }
time_of_day_h = { nominal = 12.0 }
humidity_pct = { nominal = 40.0 }
T_supply_C = { nominal = 30.0 }
q_m3_h = { nominal = 1.0 }
[elements.a]
kind = "node"
capacitance = 1000.0
[elements.b]
kind = "node"
capacitance = 4000.0
[elements.T_a_C]
kind = "sensor"
node = "a"
columns = ["T_a_C"]
[elements.T_b_C]
kind = "sensor"
node = "b"
columns = ["T_b_C"]
[elements.link]
kind = "conduction"
from = "a"
to = "b"
resistance = 0.5
"""
U = np.array([500.0, 80.0, 50.0, 20.0, 15.0, 40.0, 35.0, 0.9])
CAPACITY = np.array([1000.0, 4000.0])


def network(extra: str) -> Network:
    return parse(TWO + extra)


def heat(extra: str, temperatures: tuple[float, float] = (40.0, 30.0), inputs: np.ndarray = U) -> np.ndarray:
    """Heat into a and b, W, of what `extra` adds to the two nodes."""

    def into(net: Network) -> np.ndarray:
        return np.array(right_hand_side(net)(np.array(temperatures), inputs, net.values)) * CAPACITY

    return into(network(extra)) - into(parse(TWO))


def drivers(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (n,) of irregular steps and inputs (n, 8) that jump at each of them."""
    rng = np.random.default_rng(seed)
    low = np.array([0.0, 20.0, 0.0, 5.0, 0.0, 10.0, 15.0, 0.2])
    high = np.array([900.0, 100.0, 100.0, 35.0, 24.0, 90.0, 60.0, 2.0])
    return np.cumsum(rng.uniform(0.5, 8.0, n)), rng.uniform(low, high, (n, low.size))


def worst_error(extra: str, start: tuple[float, float] = (70.0, 25.0), n: int = 120, seed: int = 0) -> float:
    """Largest difference, K, between the kernel and solve_ivp restarted at every sample."""
    net = network(extra)
    t, u = drivers(n, seed)
    rhs = right_hand_side(net)
    expected = np.empty((n, 2))
    expected[0] = start
    for i in range(n - 1):
        span = (0.0, float(t[i + 1] - t[i]))
        done = solve_ivp(
            lambda _, x, now: rhs(x, now, net.values), span, expected[i], "DOP853", args=(u[i],), rtol=1e-11, atol=1e-11
        )
        expected[i + 1] = done.y[:, -1]
    return float(np.abs(simulate(net, t, u, np.array(start)) - expected).max())
