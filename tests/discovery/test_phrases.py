"""Sizes as an operator reads them."""

import pytest

from tests.discovery.conftest import Bench
from twin.discovery.effects.catalogue import catalogue
from twin.discovery.effects.phrases import agreeing, amount, is_plural
from twin.discovery.effects.statement import disturbance_statement


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


@pytest.mark.parametrize(
    ("name", "plural"),
    [
        ("modules", True),
        ("heat_sinks", True),
        ("power modules", True),
        ("tank", False),
        ("heater_1", False),
        ("modules_2", False),
        ("T_modules_C", False),
        ("glass", False),
        ("bus", False),
        ("chassis", False),
        ("off_gas", False),
        ("BMS", False),
        ("", False),
    ],
)
def test_a_name_is_plural_by_its_last_word(name: str, plural: bool) -> None:
    assert is_plural(name) is plural


@pytest.mark.parametrize(
    ("says", "of_several"),
    [
        ("gives off {value}", "give off {value}"),
        ("loses heat", "lose heat"),
        ("exchanges heat", "exchange heat"),
        ("has a mass beside it that follows", "have a mass beside them that follows"),
        ("is bypassed by {value}", "are bypassed by {value}"),
        ("passes {value}", "pass {value}"),
        ("gets its water later", "get their water later"),
        ("reads", "read"),
    ],
)
def test_several_things_take_the_verb_of_a_plural(says: str, of_several: str) -> None:
    assert agreeing("modules", says) == of_several
    assert agreeing("tank", says) == says


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (44.0, "W", "modules give off 44 W that the twin does not model"),
        (-44.0, "W", "modules take up 44 W that the twin does not model"),
        (0.12, "of the nominal flow", "modules have 12 % of the nominal flow more than the twin models"),
    ],
)
def test_a_disturbance_of_several_things_is_told_of_them_all(value: float, unit: str, text: str) -> None:
    assert disturbance_statement("modules", value, unit) == text
    assert disturbance_statement("modules", 1.0, "W", (-2.0, 3.0), average=True).startswith("modules give off between")


def test_a_gain_that_the_twin_has_is_named_beside_its_change(brisk: Bench) -> None:
    """A heater at a fifth of its command delivers less than its command, also where the twin had still less."""
    own = brisk.with_element("drive", {"kind": "actuator", "column": "heater_power_W", "gain": {"value": 0.06}})
    says = {c.says for c in catalogue(own) if c.kind == "actuator" and "drive.gain" in c.changes}
    assert says == {"delivers {share} more of its command than the 6 % that the twin has"}
    new = {c.says for c in catalogue(brisk.network) if c.kind == "actuator" and "more than its command" in c.says}
    assert new == {"delivers {share} more than its command"}
