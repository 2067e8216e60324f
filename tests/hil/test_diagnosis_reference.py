"""`docs/reference/diagnosis-file.md` against the documents that a diagnosis writes."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest

from hil.diagnosis.healthy_record import HealthyRecord
from hil.diagnosis.session import DiagnosisRequest, PreparedDiagnosis, described
from tests.docs.fences import PROJECT
from tests.hil.made_diagnosis import made
from tests.hil.reference_pages import page
from twin.discovery.diagnosis import Diagnosis, Elsewhere, Lead, SensorError
from twin.discovery.evidence.priors import KINDS
from twin.discovery.places.empirical import Empirical
from twin.discovery.planning import experiment
from twin.network import Network
from twin.twinfile import load

PAGE = page("diagnosis-file")
FILES = {"record", "twin", "revision", "healthy", "seconds", "provenance"}
"""Keys that the command adds to the document of a diagnosis."""


def _loop() -> Network:
    return load(PROJECT / "profiles" / "twins" / "loop.toml")


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    errors = {"T_tank_C": (1.0, 0.1)}
    curve = Empirical("tank", "pump_speed", (0.0, 1.0), (0.0, 5.0), _loop(), errors, "a curve")
    further = Elsewhere("other.csv", {"T_tank_C": SensorError(1.0, 1.0, 0.1, 0.05)}, "over")
    lead = Lead("segment", "the misfit is here", "", 0.0, 60.0, "s", 0.9, 0.1)
    full: Diagnosis = dataclasses.replace(made(), elsewhere=(further,), leads=(lead,), empirical=curve)
    return full.document()


def test_every_key_at_the_top_is_listed_and_no_other(document: dict[str, Any]) -> None:
    assert set(PAGE.keys("Top of the file")) == set(document) | FILES


@pytest.mark.parametrize(
    ("section", "key"),
    [
        ("effects", "effects"),
        ("other explanations", "alternatives"),
        ("further_records", "further_records"),
        ("tunables_moved", "tunables_moved"),
        ("ladder", "ladder"),
        ("left_out", "left_out"),
    ],
)
def test_keys_of_each_table(document: dict[str, Any], section: str, key: str) -> None:
    assert set(PAGE.keys(section)) == set(document[key][0])


def test_keys_of_errors_leads_and_curves(document: dict[str, Any]) -> None:
    assert set(PAGE.keys("error")) == set(document["error"]["sensors"]["T_tank_C"])
    assert set(document["error"]) == {"held_out_s", "sensors"}
    assert set(PAGE.keys("empirical")) == set(document["empirical"])
    row = PAGE.keys("Top of the file")["leads"]["Meaning"]
    assert [name for name in document["leads"][0] if f"`{name}`" not in row] == []
    assert set(document["indistinguishable"][0]) == set(PAGE.keys("other explanations")) - {"why_not"}


def test_keys_of_an_experiment() -> None:
    """The page names the keys that the planner writes, with and without an experiment."""
    impossible = experiment._impossible((), "no input separates them")
    assert set(impossible) < set(PAGE.keys("next_experiment"))
    source = Path(experiment.__file__).read_text(encoding="utf-8")
    written = source.partition('"possible": True')[2].partition("}\n")[0]
    assert [key for key in PAGE.keys("next_experiment") if f'"{key}": ' not in '"possible": True' + written] == []


def test_keys_that_the_command_adds() -> None:
    twin = _loop()
    request = DiagnosisRequest(record=Path("record.csv"), twin=Path("twin.toml"))
    ready = PreparedDiagnosis(request, twin, twin, None, None, HealthyRecord(None))
    assert FILES - {"provenance"} == set(described(ready, None, 0.0))


def test_every_kind_of_effect_is_explained() -> None:
    kinds = {row["Kind"].strip("`") for row in PAGE.rows["Kinds of effects"]}
    assert kinds == {*KINDS, "unknown"}
