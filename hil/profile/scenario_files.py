"""Files of a scenario: its load profiles and its figure, next to the file."""

from __future__ import annotations

from pathlib import Path

from hil.files import replacing
from hil.profile.load_profile import write_profile
from hil.profile.scenario import build, read_scenario
from hil.profile.scenario_figure import picture


def write_scenario(path: Path) -> list[Path]:
    """Write every profile of the scenario at `path`, and its figure, next to it; return the paths."""
    scenario = read_scenario(path)
    written = []
    for repeat in scenario.repeats:
        profile = build(scenario, repeat)
        target = path.with_name(f"{profile.name}.csv")
        write_profile(profile, target, comments=[f"built from {path.name}: change that file and build again"])
        written.append(target)
    target = path.with_suffix(".svg")
    with replacing(target) as unfinished:
        picture(scenario, unfinished, "svg")
    return [*written, target]
