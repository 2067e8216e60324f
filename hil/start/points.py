"""Questions about the points of an imported register table: heartbeat, limits, safe values, read-backs, roles."""

from __future__ import annotations

import difflib
import json
from collections.abc import Generator, Iterable
from typing import TYPE_CHECKING

from hil.start.questions import NONE, Question, limits, number, one_of

if TYPE_CHECKING:
    from drivers.rig_file import Point, Rig

Asked = Generator[Question, str, None]
"""Questions, each of which gets its answer."""
_LIMITS = {"W": "0, 1000", "%": "0, 100"}
"""Limits of a set-point by its unit, as `hil init` assumes them."""
_ROLES_IN = {"W": ("heater_power",), "%": ("pump_speed", "fan_speed"), "L/min": ("flow",)}
_LIKE = 0.6
"""Ratio of difflib from which a name counts as similar (its own default)."""
_RAMP_S = {"W": 10.0}
_OTHER_RAMP_S = 5.0
"""Seconds from the lower to the upper limit, as `hil init` assumes them."""
_READBACK_TOLERANCE = 0.02
"""Share of the limits' span, as `hil init` assumes it."""


def point_questions(rig: Rig, settings: list[str]) -> Asked:
    """Yield the questions about a rig's points; append the keys that follow from the answers to `settings`.

    Parameters
    ----------
    rig
        Rig of the import, without roles and limits.
    settings
        Options `--set` of `hil init`, which are appended.
    """
    written = [point for point in rig.point if point.access != "r" and point.kind == "measured"]
    read = [point for point in rig.point if point.access == "r" and point.kind == "measured"]
    beat: set[str] = set()
    yield from _heartbeat(written, read, settings, beat)
    driven = [point for point in written if point.name not in beat]
    spans: dict[str, tuple[float, float]] = {}
    readbacks: dict[str, str] = {}
    for point in driven:
        yield from _setpoint(point, read, settings, spans, readbacks)
    names: dict[str, str] = {}
    taken: set[str] = {point.name for point in rig.point}
    for point in (point for point in read if point.name not in beat):
        yield from _role(point, taken, names, settings)
    for setpoint, readback in readbacks.items():
        settings.append(f"{setpoint}.readback={names.get(readback, readback)}")
        low, high = spans[setpoint]
        settings.append(
            f"{readback}.plausible={[round(low - 0.01 * (high - low), 6), round(high + 0.2 * (high - low), 6)]}"
        )
    warm = [point for point in read if point.unit == "degC" and point.name not in beat]
    if warm:
        trip = float((yield Question("trip_C", "Temperature that ends a run, degC", "75", number(-50.0, 1000.0))))
        for point in warm:
            settings.append(f"{point.name}.plausible={[-10.0, max(95.0, trip + 20.0)]}")
            settings.append(f"{point.name}.alarm={[-5.0, trip]}")


def _heartbeat(written: list[Point], read: list[Point], settings: list[str], beat: set[str]) -> Asked:
    texts = {
        "point": ("Point that the rig watches and that must change every tick (heartbeat)", ("heart", "beat")),
        "counter": ("Point of the rig that must advance (counter)", ("counter",)),
        "arm": ("Point that lets outputs go live when 1 is written (arm)", ("arm",)),
        "watchdog": ("Point for the time-out of the rig's own watchdog, in s", ("watchdog",)),
    }
    for key, (text, words) in texts.items():
        from_ = [point.name for point in (read if key == "counter" else written) if point.name not in beat]
        if not from_ or (key != "point" and not beat):
            continue
        default = next((name for name in from_ if any(word in name.lower() for word in words)), NONE)
        name = yield Question(f"heartbeat.{key}", _with(text, from_), default, one_of(*from_, NONE))
        if name != NONE:
            beat.add(name)
            settings += [f"heartbeat.{key}={name}", f"{name}.kind=status"]


def _setpoint(
    point: Point,
    read: list[Point],
    settings: list[str],
    spans: dict[str, tuple[float, float]],
    readbacks: dict[str, str],
) -> Asked:
    name, unit = point.name, point.unit
    text = f"{name}: limits in {unit} as LOW, HIGH; {NONE} if no profile may drive it"
    span = yield Question(f"limits.{name}", text, _LIMITS.get(unit), limits)
    if span == NONE:
        return
    low, high = (float(end) for end in span.split(","))
    spans[name] = low, high
    is_cooling = unit == "%"
    text = f"{name}: safe value in {unit}, set on every way out of a run"
    safe = yield Question(f"safe.{name}", text, f"{high if is_cooling else low:g}", number(low, high))
    ramp = (high - low) / _RAMP_S.get(unit, _OTHER_RAMP_S)
    text = f"{name}: fastest change, {unit}/s"
    rate = yield Question(f"rate.{name}", text, f"{ramp:g}", number(1e-6, 1e6))
    settings += [f"{name}.limits={[low, high]}", f"{name}.safe_value={float(safe)}", f"{name}.max_rate={float(rate)}"]
    settings.append(f"{name}.safe_order={int(is_cooling)}")
    same = [other.name for other in read if other.unit == unit and other.name not in readbacks.values()]
    if same:
        default = (difflib.get_close_matches(name.removesuffix("_set"), same, 1, _LIKE) or [NONE])[0]
        back = yield Question(
            f"readback.{name}", _with(f"{name}: point that measures it (read-back)", same), default, one_of(*same, NONE)
        )
        if back != NONE:
            readbacks[name] = back
            settings.append(f"{name}.readback_tolerance={_READBACK_TOLERANCE * (high - low):g}")
            settings.append(f"{name}.readback_within_s=60.0")


def _role(point: Point, taken: set[str], names: dict[str, str], settings: list[str]) -> Asked:
    from drivers.signals import ROLES

    warm = tuple(role for role in ROLES if role.startswith("T_"))
    fitting = warm if point.unit == "degC" else _ROLES_IN.get(point.unit, ())
    free = [role for role in fitting if role == point.name or role not in taken]
    if not free:
        return
    default = point.name if point.name in free else NONE
    text = _with(f"{point.name} ({point.unit}): role, which becomes its name", free)
    role = yield Question(f"role.{point.name}", text, default, one_of(*free, NONE))
    if role != NONE:
        taken.add(role)
        settings.append(f"{point.name}.role={role}")
        if role != point.name:
            names[point.name] = role
            settings.append(f"{point.name}.name={role}")


def _with(text: str, choices: Iterable[str]) -> str:
    return f"{text}: {', '.join(choices)} or {NONE}"


def quoted(settings: list[str]) -> list[str]:
    """Return settings as options of `hil init`; texts are in quotation marks of TOML where they need them."""
    words = []
    for text in settings:
        place, _, value = text.partition("=")
        is_word = (
            value.replace("_", "").isalnum()
            and value not in ("true", "false", "inf", "nan")
            and not value[:1].isdigit()
        )
        plain = is_word or value[:1] in "-[0123456789"
        words += ["--set", text if plain else f"{place}={json.dumps(value)}"]
    return words
