"""Sizes as an operator reads them."""

import pytest

from twin.discovery.effects.phrases import amount


@pytest.mark.parametrize(
    ("value", "unit", "said"),
    [
        (0.0123, "K", "0.0123 K"),
        (999.6, "W", "1,000 W"),
        (2000.0, "W", "2,000 W"),
        (-3999.0, "J/K", "-4,000 J/K"),
        (14_230.0, "W", "14.2 kW"),
        (152_340.0, "m2", "152,000 m2"),
        (0.17, "of the nominal flow", "17 % of the nominal flow"),
    ],
)
def test_a_size_has_three_digits_that_count_and_no_exponent(value: float, unit: str, said: str) -> None:
    assert amount(value, unit) == said


def test_an_interval_is_told_in_the_unit_of_its_size() -> None:
    assert amount(14_200.0, "W", 300.0) == "14.2 kW (13.9 to 14.5)"
    assert amount(9_990.0, "W", 50.0) == "9,990 W (9,940 to 10,000)"
