"""Peers: other tools on the same windows, one module each. They are imported on use, and left out if not installed.

The names below are the package's interface: the modules of the peers, and the error of a peer that is absent.
"""

from __future__ import annotations

from hil.lazy_names import lazy_names

__all__ = [
    "Absent",
    "c_peer",
    "filter_peer",
    "formulas",
    "jax_peer",
    "libmodbus",
    "modbus_peer",
    "numpy_peer",
    "optimisers",
    "scipy_ode",
    "sindy_peer",
    "torch_peer",
]


class Absent(Exception):
    """Error of a peer that cannot take part; the message states the reason in one line."""


__getattr__, __dir__ = lazy_names(__name__, {"": tuple(name for name in __all__ if name != "Absent")})
