"""Scenarios: named ship systems whose losses become the heat load of a rig.

A scenario is a TOML file of systems with an electrical load, a schedule and the fraction of the load that ends as
heat. Only water-cooled systems heat the loop; air-cooled ones are carried electrically and shown apart. `build`
turns it into a `Profile`, `scenario_figure` draws it, and `scenario_files` writes both next to the file
(`hil profile build`).
"""

from __future__ import annotations

import itertools
import re
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from drivers.rig_file import line_of, mistake, parse_toml, read_regular
from drivers.signals import split_column
from hil.profile.load_profile import Profile


class ScenarioError(ValueError):
    """Error in reading or building a scenario; one sentence in each line, with the file and the remedy."""


_LONGEST_H = 1e6
"""Longest duration, h; a century is shorter."""


def _seconds(time: object) -> int:
    if isinstance(time, str) and (match := re.fullmatch(r"(\d+):([0-5]\d)(?::([0-5]\d))?", time)):
        hours, minutes, seconds = (int(part or 0) for part in match.groups())
        return 3600 * hours + 60 * minutes + seconds
    if isinstance(time, int | float) and not isinstance(time, bool) and 0 <= time <= _LONGEST_H:
        return round(3600 * time)
    raise ValueError(f"{time!r} is no time; write hours and minutes as '1:45', or hours as 1.75")


def _from_zero(steps: tuple[tuple[int, float], ...]) -> tuple[tuple[int, float], ...]:
    times = [time for time, _ in steps]
    if not times or times[0] != 0:
        raise ValueError("does not begin at 0:00; add the value that holds from the start")
    for earlier, later in itertools.pairwise(times):
        if later <= earlier:
            raise ValueError(f"{clock(later)} comes after {clock(earlier)}; sort the steps by time, each time once")
    return steps


def _apart(windows: tuple[tuple[int, int], ...]) -> tuple[tuple[int, int], ...]:
    last = -1
    for start, end in windows:
        if end <= start or start <= last:
            raise ValueError(
                f"window {clock(start)} to {clock(end)} is empty, touches or precedes the one before; "
                "sort the windows and keep them apart"
            )
        last = end
    return windows


Seconds = Annotated[int, BeforeValidator(_seconds)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Steps = Annotated[tuple[tuple[Seconds, float], ...], AfterValidator(_from_zero)]


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class System(_Strict):
    """Consumer: `load_kW` at full load, of which `heat_fraction` ends as heat in the loop (water) or room (air).
    `throttle` gives (s, fraction of the load) steps, `windows` the (s, s) spans in which the system is on; with neither
    the load is constant.

    `throttle` gives (s, fraction of the load) steps, `windows` the (s, s) spans in which the system is on; with
    neither the load is constant.
    """

    name: Annotated[str, Field(min_length=1)]
    cooling: Literal["water", "air"]
    load_kW: Annotated[float, Field(gt=0)]
    heat_fraction: Annotated[float, Field(gt=0, le=1)]
    throttle: Annotated[tuple[tuple[Seconds, Fraction], ...], AfterValidator(_from_zero)] | None = None
    windows: Annotated[tuple[tuple[Seconds, Seconds], ...], AfterValidator(_apart)] | None = None

    @model_validator(mode="after")
    def _one_schedule(self) -> System:
        if self.throttle is not None and self.windows is not None:
            raise ValueError("has both throttle and windows; keep one, or split it into two systems")
        return self

    def steps(self) -> list[tuple[int, float]]:
        """Return the load's (s, fraction) steps from 0 on."""
        if self.throttle is not None:
            return list(self.throttle)
        if self.windows is None:
            return [(0, 1.0)]
        edges = [edge for start, end in self.windows for edge in ((start, 1.0), (end, 0.0))]
        return edges if edges and edges[0][0] == 0 else [(0, 0.0), *edges]


class Scenario(_Strict):
    """Ship systems over `duration` s, and the allowed range of the loop's heat."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9_]+$")]
    title: str = ""
    duration: Seconds
    converters: Annotated[int, Field(gt=0)]
    heat_per_converter_W: tuple[float, float]
    heat_column: str = "heater_power_W"
    repeats: tuple[Annotated[int, Field(gt=0)], ...] = (1,)
    system: Annotated[tuple[System, ...], Field(min_length=1)]
    setpoints: dict[str, Steps] = {}
    path: Path = Path("scenario.toml")

    @model_validator(mode="after")
    def _consistent(self) -> Scenario:
        names = [system.name for system in self.system]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"names system '{name}' twice; give each its own name")
        if not any(system.cooling == "water" for system in self.system):
            raise ValueError("has no water-cooled system, so nothing heats the loop; set cooling = 'water' for one")
        for system in self.system:
            self._ends_in_time(f"system '{system.name}'", system.steps())
        for column, steps in self.setpoints.items():
            self._ends_in_time(f"setpoints.{column}", list(steps))
        for column in (self.heat_column, *self.setpoints):
            if split_column(column) is None:
                raise ValueError(f"names set-point '{column}' without a unit; write it as in heater_power_W")
        return self

    def _ends_in_time(self, place: str, steps: list[tuple[int, float]]) -> None:
        if steps[-1][0] > self.duration:
            raise ValueError(
                f"{place} changes at {clock(steps[-1][0])}, after the end at {clock(self.duration)}; "
                "lengthen the duration or drop the step"
            )

    @property
    def heat_range_W(self) -> tuple[float, float]:
        """Return least and most heat of all converters together into the loop, W."""
        low, high = self.heat_per_converter_W
        return self.converters * low, self.converters * high


def clock(seconds: float) -> str:
    """Format `seconds` as h:mm, with :ss only if it is not a whole minute."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}" + (f":{rest:02d}" if rest else "")


def read_scenario(path: Path) -> Scenario:
    """Read the scenario in the TOML file at `path`; raise ScenarioError with a sentence for every problem."""
    try:
        text = read_regular(path).decode("utf-8")
        document = parse_toml(text)
    except OSError as error:
        raise ScenarioError(f"{path} cannot be read ({error.strerror}); give the path of a scenario") from error
    except ValueError as error:
        raise ScenarioError(f"{path} is not valid TOML: {error}") from error
    try:
        return Scenario(**{**document, "path": path})
    except ValidationError as error:
        systems = document.get("system", [])
        raise ScenarioError(
            "\n".join(_sentence(path, text, systems, part["loc"], mistake(part)) for part in error.errors())
        ) from error
    except TypeError as error:
        raise ScenarioError(f"{path} has a key that no scenario has ({error})") from error


def _sentence(path: Path, text: str, systems: object, location: tuple[int | str, ...], message: str) -> str:
    place = f"{path} line {line_of(text, location)}" if location else str(path)
    rest = list(location)
    if len(rest) > 1 and rest[0] == "system" and isinstance(rest[1], int) and isinstance(systems, list):
        entry = systems[rest[1]]
        name = entry.get("name", f"number {rest[1] + 1}") if isinstance(entry, dict) else f"number {rest[1] + 1}"
        place += f", system '{name}'"
        rest = rest[2:]
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in rest).lstrip(".")
    return f"{place}{', ' + key if key else ''}: {message}"


def _held(steps: list[tuple[int, float]], edges: NDArray[np.int64]) -> NDArray[np.float64]:
    times, values = zip(*steps, strict=True)
    return np.array(values, dtype=np.float64)[np.searchsorted(times, edges, side="right") - 1]


def dissipation(scenario: Scenario) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the times of all load changes and the dissipation of each system from then on.

    Returns times `(m,)` in s from 0 to the end, and heat `(systems, m)` in W in the order of `scenario.system`.
    """
    steps = [system.steps() for system in scenario.system]
    edges = np.unique([0, scenario.duration, *(time for one in steps for time, _ in one)])
    power = [1000.0 * system.load_kW * system.heat_fraction for system in scenario.system]
    return edges, np.array([full * _held(one, edges) for full, one in zip(power, steps, strict=True)])


def build(scenario: Scenario, repeat: int = 4) -> Profile:
    """Build the profile of `scenario`, `repeat` times over; raise ScenarioError if the heat leaves its range."""
    if repeat < 1:
        raise ScenarioError(f"{scenario.path} cannot be repeated {repeat} times; repeat it at least once")
    times, heat = dissipation(scenario)
    cooled = [index for index, system in enumerate(scenario.system) if system.cooling == "water"]
    loop = np.round(heat[cooled].sum(axis=0), 1)
    _in_range(scenario, times[:-1], loop[:-1], heat)
    edges = np.unique([*times, *(time for steps in scenario.setpoints.values() for time, _ in steps)])[:-1]
    columns = (scenario.heat_column, *scenario.setpoints)
    values = np.column_stack(
        [
            loop[np.searchsorted(times, edges, side="right") - 1],
            *(_held(list(steps), edges) for steps in scenario.setpoints.values()),
        ]
    )
    time_s = np.concatenate([edges + cycle * scenario.duration for cycle in range(repeat)]).astype(np.float64)
    values = np.tile(values, (repeat, 1))
    moves = np.concatenate([[True], (np.diff(values, axis=0) != 0).any(axis=1)])
    end = repeat * scenario.duration
    hours = f"{end / 3600:g}".replace(".", "_")
    return Profile(
        f"{scenario.name}_{hours}h",
        np.append(time_s[moves], end),
        columns,
        np.vstack([values[moves], values[-1]]),
    )


def _in_range(
    scenario: Scenario, times: NDArray[np.int64], loop: NDArray[np.float64], heat: NDArray[np.float64]
) -> None:
    low, high = scenario.heat_range_W
    wrong = np.flatnonzero((loop < low) | (loop > high))
    if not len(wrong):
        return
    sentences = []
    for index in wrong:
        parts = ", ".join(
            f"{system.name} {heat[number, index]:.0f} W"
            for number, system in enumerate(scenario.system)
            if system.cooling == "water" and heat[number, index] > 0
        )
        word, bound, remedy = ("below", low, "raise") if loop[index] < low else ("above", high, "lower")
        sentences.append(
            f"{scenario.path} heats the loop with {loop[index]:.0f} W at {clock(times[index])} ({parts or 'all off'}), "
            f"{word} the {bound:.0f} W of its {scenario.converters} converters; {remedy} a load there"
        )
    raise ScenarioError("\n".join(sentences))
