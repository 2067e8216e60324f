"""Units of a tag dictionary: factors, spellings, multiples, and those that nobody can know."""

from __future__ import annotations

import pytest

from twin.historian.units import UnitError, unit_of


@pytest.mark.parametrize(
    ("text", "value", "canonical"),
    [
        ("psi", 14.6959, 101.325),
        ("psig", 20.0, 137.895),
        ("inHg", 29.9213, 101.325),
        ("mmHg", 760.0, 101.325),
        ("atm", 1.0, 101.325),
        ("inH2O", 10.0, 2.4909),
        ("kBtu/hr", 1000.0, 293.071),
        ("MBH", 1000.0, 293.071),
        ("TR", 100.0, 351.685),
        ("PS", 100.0, 73.5499),
        ("lb/h", 1e6, 125.998),
        ("lbs/hr", 1e6, 125.998),
        ("kg/h", 3600.0, 1.0),
        ("US gpm", 1000.0, 62.900),
        ("m^3/hr", 3600.0, 997.0),
        ("M3/H", 3600.0, 997.0),
        ("º C", 20.0, 20.0),
        ("deg F", 212.0, 100.0),
        ("0.1 degC", 253.0, 25.3),
        ("0,1 degF", 2120.0, 100.0),
        ("10 kW", 4.5, 45.0),
        ("ft/min", 1000.0, 5.08),
        ("%RH", 55.0, 55.0),
        ("MPA", 0.1, 100.0),
    ],
)
def test_a_unit_is_converted(text: str, value: float, canonical: float) -> None:
    unit = unit_of(text)
    assert unit.scale * value + unit.offset == pytest.approx(canonical, rel=1e-4)


@pytest.mark.parametrize("text", ["mW", "mPa", "Mbar", "MBTU/h", "furlong", "0.1 furlong", "0 degC", "10 0/1"])
def test_a_unit_that_is_not_known_or_has_another_prefix_is_refused(text: str) -> None:
    with pytest.raises(UnitError, match=r"unit '.*' is not known; use one of "):
        unit_of(text)


def test_a_message_lists_the_units_of_the_quantity_alone() -> None:
    with pytest.raises(UnitError) as refused:
        unit_of(" ", ("pressure",))
    assert str(refused.value) == "has no unit; use one of MPa, Pa, bar, hPa, inHg, kPa, mbar, mmHg, psi"
