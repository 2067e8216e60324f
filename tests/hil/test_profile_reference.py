"""The page of profiles: its examples are read, and it names the keys that the readers take."""

from __future__ import annotations

import re

import pytest
from pydantic_core import PydanticUndefined

from hil.profile.load_profile import ProfileError, read_profile, write_profile
from hil.profile.scenario import Scenario, System, build, read_scenario
from hil.run.session.request import RunRequest, prepare
from tests.hil.reference_pages import FOLDER, page

PAGE = page("profile-file")
PAGES = ("rig-file", "twin-file", "profile-file", "effects-file")
NO_KEYS = {"path"}
"""Set by the reader: where the file lies."""


@pytest.mark.parametrize(("section", "model"), [("Scenario", Scenario), ("[[system]]", System)])
def test_every_key_is_named_with_its_default_and_no_other(section, model):
    rows = PAGE.keys(section)
    fields = {key: field for key, field in model.model_fields.items() if key not in NO_KEYS}
    assert set(rows) == set(fields)
    texts = {(): "`[]`", (1,): "`[1]`", None: "none", PydanticUndefined: "must be given"}
    for key, field in fields.items():
        value = field.default
        shown = "`{}`" if value == {} else f'`"{value}"`' if isinstance(value, str) else texts[value]
        assert rows[key]["Default"] == shown, key


@pytest.mark.parametrize("twin", [None, page("twin-file").code["toml"][0]])
def test_the_examples_run_on_the_example_of_the_rig_file(tmp_path, twin):
    rig, scenario, load = tmp_path / "rig.toml", tmp_path / "day.toml", tmp_path / "load.csv"
    rig.write_text(page("rig-file").code["toml"][0], encoding="utf-8")
    load.write_text(PAGE.code["csv"][0], encoding="utf-8")
    scenario.write_text(PAGE.code["toml"][0], encoding="utf-8")
    named = tmp_path / "twin.toml" if twin else None
    if named is not None:
        named.write_text(twin, encoding="utf-8")
    notes = prepare(RunRequest(load, rig, named, tmp_path)).notes
    assert all("steps are ramps at 50 W/s" in note for note in notes)
    for repeat in read_scenario(scenario).repeats:
        write_profile(build(read_scenario(scenario), repeat), load)
        ready = prepare(RunRequest(load, rig, named, tmp_path))
        assert ready.profile.duration_s == 7200.0 * repeat and ready.profile.columns == ("heater_power_W",)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("0,200", "5,200"),
        ("900,350", "0,350"),
        ("900,350", "900,"),
        ("heater_power_W", "heater_power"),
        ("time_s", "time"),
        ("900,350", "# here\n900,350"),
    ],
)
def test_what_the_page_does_not_allow_of_a_profile_is_refused(tmp_path, old, new):
    path = tmp_path / "load.csv"
    text = PAGE.code["csv"][0]
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ProfileError):
        read_profile(path)


@pytest.mark.parametrize("name", PAGES)
def test_links_lead_to_a_heading(name):
    text = (FOLDER / f"{name}.md").read_text(encoding="utf-8")
    links = re.findall(r"\]\((?:([a-z-]+)\.md)?(?:#([^)]*))?\)", text)
    assert {other for other, _ in links} == {*PAGES, ""} - {name}
    for other, anchor in links:
        slugs = {re.sub(r"[^\w -]", "", title).lower().replace(" ", "-") for title in page(other or name).rows}
        assert not anchor or anchor in slugs, f"{name}: {other}#{anchor}"
