"""Equation of a law in words and symbols, as the log of a twin, its picture and a page show it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from twin.elements.law import Law
from twin.elements.law_actuator import LawActuator
from twin.elements.law_conductance import LawConductance
from twin.elements.law_flow import LawFlow
from twin.elements.law_fluid import LawFluid
from twin.elements.law_heat import LawHeat
from twin.elements.law_input import LawInput
from twin.elements.law_reading import LawReading
from twin.network import Network


@dataclass(frozen=True)
class LawEquation:
    """A law in words (site, driver, form and time course) and in symbols (with numbers and units)."""

    words: str
    symbols: str

    def __str__(self) -> str:
        return f"{self.words}: {self.symbols}"


def law_equations(network: Network) -> dict[str, LawEquation]:
    """Return the equations of a network's laws by the names of their elements, in file order."""
    return {e.name: law_equation(network, e) for e in network.elements if isinstance(e, Law)}


def law_equation(network: Network, law: Law) -> LawEquation:
    """Return the equation of a law with the values that it has in a network."""

    def value(name: str) -> float:
        return network.parameters[f"{law.name}.{name}"].value

    def shown(name: str) -> str:
        p = network.parameters[f"{law.name}.{name}"]
        return f"{p.value:.4g}" if p.unit == "1" else f"{p.value:.4g} {p.unit}"

    x = _driver(law)
    site, symbol = _site(law, shown)
    when = _course(law, shown)
    how = _form_in_words(law, x, shown)
    words = f"{site}, {how}" + (f", {when}" if when else "")
    return LawEquation(words, f"{symbol} = {_form(law, x, value, shown)}" + (f", {when}" if when else ""))


def _driver(law: Law) -> str:
    x = f"T({law.of})" if law.of else law.driver
    less = f"T({law.minus})" if law.minus else law.minus_input
    return f"{x} - {less}" if less else x


def _site(law: Law, shown: Callable[[str], str]) -> tuple[str, str]:
    """Return the site of a law in words, and the symbol of its value."""
    if isinstance(law, LawHeat):
        if law.source:
            return f"heat from {law.source} into {law.node}", f"Q({law.source} to {law.node})"
        return f"heat into {law.node}", f"Q({law.node})"
    if isinstance(law, LawFluid):
        return f"fluid of {shown('temperature')} into {law.node}", f"m({law.node})"
    if isinstance(law, LawConductance):
        other = law.to or law.ambient
        return f"conductance between {law.node} and {other}", f"G({law.node}, {other})"
    if isinstance(law, LawFlow):
        if law.change_in == "share":
            return f"relative change of the flow {law.flow}", f"dq/q({law.flow})"
        return f"change of the flow {law.flow}", f"dq({law.flow})"
    if isinstance(law, LawReading):
        return f"change of the reading of {law.sensor}", f"d({law.sensor})"
    if isinstance(law, LawInput):
        return f"error of the thermometer of {law.column}", f"d({law.column})"
    assert isinstance(law, LawActuator)
    return f"relative change of the output of {law.column}", f"dP/P({law.column})"


def _form_in_words(law: Law, x: str, shown: Callable[[str], str]) -> str:
    if law.form == "constant":
        return "constant"
    return {
        "linear": f"in proportion to {x}",
        "power": f"in proportion to a power of {x}",
        "saturating": f"saturating with {x}",
        "dead_band": f"in proportion to {x} beyond a dead band",
        "threshold": f"switched by {x}",
        "memory": f"following {x} with a time constant",
        "rate": f"in proportion to the rate of change of {x}",
    }[law.form]


def _form(law: Law, x: str, value: Callable[[str], float], shown: Callable[[str], str]) -> str:
    """Return the form as an expression with its numbers."""
    strength = shown(law.strength)
    if law.by_amount:
        return f"{strength} / {shown('decay_s')}"
    if law.form == "constant":
        return strength
    if law.form == "threshold":
        return f"{strength} from {x} = {shown('on')} until {x} = {shown('off')}, else 0"
    if law.form == "rate":
        return f"{strength} * ({x} - z) / {shown('lag_s')}, {shown('lag_s')} dz/dt = {x} - z"
    from_reference = f" - ({shown('reference')})" if value("reference") < 0.0 else f" - {shown('reference')}"
    less = from_reference if value("reference") else ""
    if law.form == "memory":
        return f"{strength} * (z{less}), {shown('lag_s')} dz/dt = {x} - z"
    y = f"({x}{less})" if less or " - " in x else x
    if law.form == "linear":
        return f"{strength} * {y}"
    if law.form == "dead_band":
        return f"{strength} * (y - clip(y, -{shown('width')}, {shown('width')})), y = {x}{less}"
    r = f"r = {y} / {shown('scale')}"
    if law.form == "power":
        return f"{strength} * sign(r) |r|^{shown('exponent')}, {r}"
    return f"{strength} * sign(r) (1 - exp(-|r|)), {r}"


def _course(law: Law, shown: Callable[[str], str]) -> str:
    """Return the time course in words, "" for one that is always 1."""
    if law.course == "always":
        return ""
    start = shown("start_s")
    if law.course == "step":
        return f"from t = {start} on"
    if law.course == "interval":
        return f"from t = {start} to t = {shown('end_s')}"
    if law.course == "ramp":
        return f"growing from t = {start} to its whole size at t = {shown('end_s')}"
    if law.course == "settling":
        return f"growing from t = {start} on with the time constant {shown('settle_s')}"
    if law.course == "periodic":
        return f"on for {shown('duty')} of every {shown('period_s')} from t = {start} on"
    return f"decaying from t = {start} on with the time constant {shown('decay_s')}"
