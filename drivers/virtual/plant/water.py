"""Properties of liquid water between 0 and 90 degC, as scalar functions, which the kernel compiles with itself.

Enthalpy is the state of every water cell, so that heat is conserved to rounding although the specific heat
depends on temperature. Coefficients: least-squares fits to tabulated values of liquid water at 1 atm, 0 to 90 degC
(density within 0.23 kg/m3, specific heat within 0.14 %, viscosity within 2.2 %).
"""

import numpy as np

HEAT_REFERENCE = 4180.0
"""J/(kg K): makes the enthalpy variable ``enthalpy / HEAT_REFERENCE`` nearly a temperature in degC."""

_A1 = 0.9913598780
_A2 = 2.7998923e-4
_A3 = -3.4360858e-6
_A4 = 1.26683e-8


def temperature_of(enthalpy: float) -> float:
    """Return the temperature in degC of water with specific enthalpy in J/kg (zero at 0 degC).

    T = A1 x + A2 x^2 + A3 x^3 + A4 x^4 with x = enthalpy / 4180: cp falls from 4216 J/(kg K) at 0 degC to a minimum
    near 40 degC and rises again, as water's does.
    """
    x = enthalpy / HEAT_REFERENCE
    return x * (_A1 + x * (_A2 + x * (_A3 + x * _A4)))


def enthalpy_of(temperature: float) -> float:
    """Return the specific enthalpy in J/kg of water at a temperature in degC: Newton's inverse of `temperature_of`."""
    x = temperature
    for _ in range(6):
        error = x * (_A1 + x * (_A2 + x * (_A3 + x * _A4))) - temperature
        x -= error / (_A1 + x * (2.0 * _A2 + x * (3.0 * _A3 + x * 4.0 * _A4)))
    return x * HEAT_REFERENCE


def density_of(temperature: float) -> float:
    """Return the density in kg/m3 at a temperature in degC, about a parabola around 4 degC."""
    d = temperature - 4.0
    return 1000.0 - d * d * (6.7910e-3 - 2.4754e-5 * d)


def viscosity_of(temperature: float) -> float:
    """Return the dynamic viscosity in Pa s at a temperature in degC (Vogel's equation, constants for 0 to 100 degC)."""
    return 2.414e-5 * np.power(10.0, 247.8 / (temperature + 133.15))
