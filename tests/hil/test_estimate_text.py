"""Estimates are printed to the digits that their interval supports."""

from __future__ import annotations

import pytest

from hil.files import estimate_text


@pytest.mark.parametrize(
    ("value", "half", "text"),
    [
        (156.3, 120.4, "160 ± 120"),
        (171.7, 25.1, "172 ± 25"),
        (0.4044, 0.334, "0.40 ± 0.33"),
        (-59.71, 1.3, "-59.7 ± 1.3"),
        (1e-3, 2.3e-4, "0.00100 ± 0.00023"),
        (1234567.0, 4321.0, "1234600 ± 4300"),
        (5.0, 0.0, "5 ± 0"),
        (5.0, float("nan"), "5 ± nan"),
    ],
)
def test_an_estimate_has_the_digits_of_its_interval(value: float, half: float, text: str) -> None:
    assert estimate_text(value, half) == text
