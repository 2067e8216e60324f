"""Commissioning of a clean cell: Merkel number, exponent, air flow, fan law and evaporation from its test points.

The Merkel number and its exponent are fitted to the outlet temperatures by least squares; the other constants follow
each from a measured quantity of its own, in closed form. A fit that does not describe a cooling tower is refused.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares, nnls

from twin.tower import air as moist
from twin.tower.air import Array
from twin.tower.cell import KAPPA, Design, Inputs, solve_cell

FEWEST = 4
"""Test points: two for the Merkel number and its exponent, as many to see how well they fit."""
MERKEL, EXPONENT = (0.1, 10.0), (0.0, 1.5)
"""Merkel numbers and exponents of counter-flow fills with margin; published fills have 0.5 to 4 and 0.4 to 0.9."""
EVAPORATION = (0.7, 1.4)
"""Range of the evaporation over Merkel's."""
MOST_IDLE = 0.3
"""Losses of motor and drive at any speed as a share of the power at full speed; usually 2 to 8 %."""
LOADING = (0.2, 4.0)
"""Water over air, kg/kg, of cooling towers."""
LARGEST_ERROR_K = 0.6
"""RMSE of a fit that still describes the cell: twice what Merkel's method leaves of a Poppe tower in all weather."""
FULL_SPEED = 0.95
"""Share of full speed from which a point counts as one at full speed."""


class CommissioningError(ValueError):
    """Test points that do not make a cell; the sentence names the reason and the remedy."""


@dataclass(frozen=True)
class TestPoints:
    """Measured steady points of the clean cell, arrays (n,); `power` kW, `m_a` kg/s and `evaporation` kg/s may be
    NaN."""

    __test__ = False

    inputs: Inputs
    t_out: Array
    power: Array
    m_a: Array
    evaporation: Array


@dataclass(frozen=True)
class CommissionedCell:
    """Clean cell, the outlet's residuals at the test points K (n,), remarks on constants that were assumed.

    `sd`: standard deviations of the Merkel number's logarithm and of the exponent.
    """

    design: Design
    residual: Array
    remarks: tuple[str, ...]
    sd: tuple[float, float] = (0.02, 0.1)

    @property
    def rmse(self) -> float:
        """Root mean square of the outlet's residuals, K."""
        return float(np.sqrt(np.mean(self.residual**2)))


def fit_clean_cell(points: TestPoints, water_flow: float, air_flow: float | None = None) -> CommissionedCell:
    """Fit a clean cell to its test points.

    Parameters
    ----------
    points
        At least `FEWEST` of them.
    water_flow
        Design water flow, kg/s.
    air_flow
        Design air flow, kg/s; taken where no point has a measured one.

    Raises
    ------
    CommissioningError
        Too few points, or constants outside those of cooling towers.
    """
    u, remarks = points.inputs, []
    if len(points.t_out) < FEWEST:
        raise CommissioningError(
            f"has {len(points.t_out)} test points; at least {FEWEST} are needed for the law of the fill"
        )
    each = [*(getattr(u, name) for name in u.__dataclass_fields__), points.t_out]
    different = len(np.unique(np.stack(each), axis=1).T)
    if different < FEWEST:
        raise CommissioningError(
            f"has {len(points.t_out)} test points, of which {different} differ; at least {FEWEST} different ones are "
            f"needed for the law of the fill: remove those that were entered again"
        )
    ratio = np.maximum(moist.ratio_from_wet_bulb(u.dry, u.wet, u.pressure), 0.0)
    rho = moist.density(u.dry, ratio, u.pressure)
    full = u.speed >= FULL_SPEED
    if not full.any():
        full = u.speed >= u.speed.max() - 0.02
    rho0 = float(rho[full].mean())
    m_a0 = _median(points.m_a / (u.speed * rho / rho0))
    if m_a0 is None:
        if air_flow is None:
            raise CommissioningError("no test point has an air flow and the datasheet gives none; add air_flow_kg_s")
        m_a0 = air_flow
        remarks.append(f"no test point has an air flow; that of the datasheet, {air_flow:.4g} kg/s, is taken")
    if not LOADING[0] <= water_flow / m_a0 <= LOADING[1]:
        raise CommissioningError(
            f"water over air is {water_flow / m_a0:.3g} at design; cooling towers have {LOADING[0]} to "
            f"{LOADING[1]}: check the "
            "units of the flows"
        )
    power, idle = _fan_law(points.power, u.speed, rho / rho0, remarks)
    merkel, exponent, sd = _fill_law(points, water_flow, m_a0, rho0)
    design = Design(water_flow, m_a0, merkel, exponent, power, rho0, idle=idle)
    factor = _median(points.evaporation / solve_cell(u, design).evaporation)
    if factor is None:
        factor = 1.08
        remarks.append("no test point has an evaporation; 1.08 times Merkel's is assumed, as Poppe's method has it")
    _within("evaporation over that of Merkel's method", factor, EVAPORATION)
    design = replace(design, evaporation=factor, kappa=KAPPA)
    result = CommissionedCell(design, solve_cell(u, design).t_out - points.t_out, tuple(remarks), sd)
    if result.rmse > LARGEST_ERROR_K:
        worst = int(np.argmax(np.abs(result.residual)))
        raise CommissioningError(
            f"the best fit leaves {result.rmse:.2f} K RMSE, most at test point {worst + 1} "
            f"({result.residual[worst]:+.2f} K); "
            f"above {LARGEST_ERROR_K} K it describes no clean cell: check that point, its cell and the units"
        )
    return result


def _fill_law(
    points: TestPoints, water_flow: float, m_a0: float, rho0: float
) -> tuple[float, float, tuple[float, float]]:
    """Return Merkel number, exponent and their standard deviations; the exponent has a weak prior of 0.6 +- 0.3 for
    points at a single loading."""

    def misfit(p: Array) -> Array:
        cell = Design(water_flow, m_a0, float(np.exp(p[0])), float(p[1]), 0.0, rho0)
        return np.append((solve_cell(points.inputs, cell).t_out - points.t_out) / 0.1, (p[1] - 0.6) / 0.3)

    low, high = [np.log(0.02), -1.0], [np.log(30.0), 3.0]
    fit = least_squares(misfit, [np.log(1.5), 0.6], bounds=(low, high), loss="soft_l1")
    found = fit.x
    merkel, exponent = float(np.exp(found[0])), float(found[1])
    _within("Merkel number at design", merkel, MERKEL)
    _within("exponent of the fill", exponent, EXPONENT)
    # Errors of a test point are those of its thermometers and of the method; they vary by more than 0.1 K where the
    # fit says.
    scale = max(float(np.sqrt(np.mean(misfit(found)[:-1] ** 2))), 1.0)
    information = fit.jac.T @ fit.jac
    if np.linalg.matrix_rank(information) < len(found):
        raise CommissioningError(
            "has test points whose outlet does not tell the Merkel number; check the units of flows and temperatures"
        )
    sd = scale * np.sqrt(np.diag(np.linalg.inv(information)))
    return merkel, exponent, (float(sd[0]), float(sd[1]))


def _fan_law(power: Array, speed: Array, density: Array, remarks: list[str]) -> tuple[float, float]:
    """Return the shaft's power at full speed, which follows the cube of the speed, and the losses at any speed, kW."""
    there = np.isfinite(power) & (power > 0.0) & (speed > 0.0)
    if not there.any():
        remarks.append("no test point has a fan power; the air flow will rest on the outlet alone")
        return 0.0, 0.0
    cube = speed[there] ** 3 * density[there]
    if np.ptp(np.log(speed[there])) < 0.15:
        remarks.append("the fan had one speed at all test points; its power is taken with the cube of the speed")
        return float(np.median(power[there] / cube)), 0.0
    shaft, idle = nnls(np.column_stack([cube, np.ones(len(cube))]) / power[there][:, None], np.ones(len(cube)))[0]
    _within("fan's power at rest over that at full speed", float(idle / max(shaft, 1e-9)), (0.0, MOST_IDLE))
    return float(shaft), float(idle)


def _median(values: Array) -> float | None:
    there = values[np.isfinite(values)]
    return float(np.median(there)) if len(there) else None


def _within(name: str, value: float, bounds: tuple[float, float]) -> None:
    if not bounds[0] <= value <= bounds[1]:
        raise CommissioningError(
            f"the {name} comes out as {value:.3g}; cooling towers have {bounds[0]:g} to {bounds[1]:g}: check the "
            f"units and the "
            "cell of the test points"
        )
