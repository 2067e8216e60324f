"""Profiles: reading with plain errors, holding values, validating before anything moves."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hil.profile.load_profile import Profile, ProfileError, SetpointLimit, read_profile, validate, write_profile

LOADS = Path(__file__).parents[2] / "profiles" / "loads"
HEADER = "time_s,heater_power_W,pump_speed_pct,fan_speed_pct\n"
GOOD = HEADER + "0,600,100,70\n600,700,100,85\n1200,700,100,85\n"
SHORT = HEADER + "0,600,100,70\n300,600,100,70\n"
LIMITS = {
    "heater_power_W": SetpointLimit(0, 1000, 50, "W"),
    "pump_speed_pct": SetpointLimit(60, 100, None, "%"),
    "fan_speed_pct": SetpointLimit(0, 100, 5, "%"),
}


def _write(tmp_path: Path, content: str | bytes) -> Path:
    path = tmp_path / "load.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def test_a_profile_is_read_with_its_lines_and_hash(tmp_path: Path) -> None:
    profile = read_profile(_write(tmp_path, "# by hand\n\n" + GOOD))
    assert profile.name == "load"
    assert profile.columns == ("heater_power_W", "pump_speed_pct", "fan_speed_pct")
    assert profile.duration_s == 1200
    assert profile.values.shape == (3, 3)
    assert profile.lines == (4, 5, 6)
    assert len(profile.sha256) == 64
    assert profile.notes == ()


@pytest.mark.parametrize(
    ("content", "place", "remedy"),
    [
        ("", "load.csv is empty", "write a header"),
        ("# only a comment\n", "load.csv is empty", "write a header"),
        (HEADER, "has 0 rows", "at least two"),
        (HEADER + "0,1,2,3\n", "has 1 rows", "last one's time is the end"),
        ("time_s,heater_power\n0,1\n9,1\n", "line 1: column 'heater_power' has no unit suffix", "heater_power_W"),
        ("time_s,heater\n0,1\n9,1\n", "line 1: column 'heater' has no unit suffix", "add one of"),
        ("time_s,fan_speed_percent\n0,1\n9,1\n", "'_percent', which is no unit suffix", "fan_speed_pct?"),
        ("time_s,heater_power_BTU\n0,1\n9,1\n", "'_BTU', which is no known unit suffix", "use one of _W"),
        ("t,heater_power_W\n0,1\n9,1\n", "line 1 begins with column 't'", "must be time_s"),
        ("time_s\n0\n9\n", "line 1 names no set-point", "add a column"),
        ("time_s,heater_power_W,\n0,1,\n9,1,\n", "line 1 leaves column 3 without a name", "delete the column"),
        ("time_s,fan_speed_pct,fan_speed_pct\n0,1,1\n", "line 1 names column 'fan_speed_pct' twice", "keep one"),
        (HEADER + "0,1,2,3\n5,1,2,3\n5,1,2,3\n", "line 4 is at 5 s, not after 5 s of line 3", "sort the rows"),
        (HEADER + "0,1,2,3\n5,1,2,3\n4,1,2,3\n", "line 4 is at 4 s", "times must increase"),
        (HEADER + "10,1,2,3\n20,1,2,3\n", "line 2 starts at 10 s", "must be at time_s 0"),
        (HEADER + "0,1,2,3\n5,1,,3\n", "line 3 leaves pump_speed_pct blank", "write the value"),
        (HEADER + "0,1,2,3\n5,1,2\n", "line 3 leaves fan_speed_pct blank", "write the value"),
        (HEADER + "0,1,2,3\n5,nan,2,3\n", "line 3 has nan for heater_power_W", "write the value"),
        (HEADER + "0,1,2,3\n5,1,inf,3\n", "line 3 has inf for pump_speed_pct", "write the value"),
        (HEADER + "0,1,2,3\n5,full,2,3\n", "line 3 has 'full' for heater_power_W", "write a plain number"),
        (HEADER + '0,1,2,3\n5,"1,5",2,3\n', "line 3 has '1,5' for heater_power_W", "decimal point"),
        (HEADER + "0,1,2,3\n5,1,5,2,3\n", "line 3 has 5 fields where the header has 4", "decimal point"),
        (HEADER + '0,1,2,3\n5,"1,2,3\n', "line 3 has an unfinished quote", "need no quotes"),
        (HEADER + "0,1,2,3\n# pause\n5,1,2,3\n", "line 3 is a comment between rows", "above the header"),
        (GOOD.replace(",", ";"), "line 1 separates columns by semicolons", "commas between columns and decimal points"),
        (GOOD.replace(",", "\t"), "line 1 separates columns by tabs", "commas between columns"),
        (HEADER + "0," + "1" * 3000 + ",2,3\n", "line 2 is 3006 characters long", "no" + "t a table"),
        (GOOD.encode("utf-16"), "line 1 is not plain text", "UTF-8"),
        (GOOD.encode() + b"# \xb0C\n", "line 5 holds a character that is not UTF-8", "save the file as UTF-8"),
    ],
)
def test_a_bad_profile_is_refused_in_one_sentence_with_place_and_remedy(
    tmp_path: Path, content: str | bytes, place: str, remedy: str
) -> None:
    path = _write(tmp_path, content)
    with pytest.raises(ProfileError) as caught:
        read_profile(path)
    sentence = str(caught.value)
    assert sentence.startswith(str(path))
    assert place in sentence
    assert remedy in sentence
    assert "\n" not in sentence


def test_a_missing_profile_is_named(tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match=r"nowhere\.csv cannot be read \(No such file or directory\); give the path"):
        read_profile(tmp_path / "nowhere.csv")


def test_a_byte_order_mark_and_windows_line_ends_are_read_and_noted(tmp_path: Path) -> None:
    path = _write(tmp_path, b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").encode())
    profile = read_profile(path)
    assert (profile.values == read_profile(_write(tmp_path, GOOD)).values).all()
    notes = validate(profile, LIMITS, period_s=1.0)
    assert any("byte-order mark" in note for note in notes)
    assert any("CRLF" in note for note in notes)


def test_a_unitless_set_point_is_admitted_where_the_rig_has_it(tmp_path: Path) -> None:
    path = _write(tmp_path, "time_s,heater_power_W,bypass_valve\n0,600,1\n900,600,1\n")
    assert read_profile(path, unitless=("bypass_valve",)).columns[1] == "bypass_valve"
    with pytest.raises(ProfileError, match="'bypass_valve' has no unit suffix"):
        read_profile(path)


def test_a_profile_built_in_memory_is_checked() -> None:
    with pytest.raises(ProfileError, match="do not fit"):
        Profile("p", np.array([0.0, 1.0]), ("a_W",), np.zeros((3, 1)))
    with pytest.raises(ProfileError, match="rise from 0"):
        Profile("p", np.array([0.0, 0.0]), ("a_W",), np.zeros((2, 1)))


numbers = st.floats(allow_nan=False, allow_infinity=False, width=64)


@st.composite
def profiles(draw: st.DrawFn) -> Profile:
    """Profiles of 2 to 12 rows whose times lie a microsecond or more apart, as `EARLY_S` assumes."""
    steps = draw(st.lists(st.floats(1e-3, 1e5), min_size=1, max_size=11))
    k = draw(st.integers(1, 4))
    rows = draw(st.lists(st.lists(numbers, min_size=k, max_size=k), min_size=len(steps) + 1, max_size=len(steps) + 1))
    columns = ("heater_power_W", "pump_speed_pct", "fan_speed_pct", "flow_L_per_min")[:k]
    return Profile("drawn", np.concatenate([[0.0], np.cumsum(steps)]), columns, np.array(rows))


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(profile=profiles())
def test_what_is_written_reads_back_exactly(tmp_path: Path, profile: Profile) -> None:
    path = tmp_path / "drawn.csv"
    write_profile(profile, path, comments=["drawn"])
    again = read_profile(path)
    assert again.columns == profile.columns
    assert np.array_equal(again.time_s, profile.time_s)
    assert np.array_equal(again.values, profile.values)
    assert list(tmp_path.iterdir()) == [path]


@settings(max_examples=60, deadline=None)
@given(profile=profiles(), times=st.lists(st.floats(-10, 1.2e6), min_size=1, max_size=30))
def test_at_and_sample_hold_the_last_row_reached(profile: Profile, times: list[float]) -> None:
    times += profile.time_s.tolist()
    sampled = profile.sample(np.array(times))
    for index, t in enumerate(times):
        expected = tuple(profile.values[0].tolist())
        for start, row in zip(profile.time_s, profile.values.tolist(), strict=True):
            if start <= t + 1e-6:
                expected = tuple(row)
        assert profile.at(t) == expected
        assert tuple(sampled[index].tolist()) == expected


def test_a_tick_that_rounds_below_a_breakpoint_still_reaches_it() -> None:
    late = math.nextafter(0.3, 0.0)
    profile = Profile("p", np.array([0.0, 0.3, 200.0]), ("a_W",), np.array([[1.0], [2.0], [2.0]]))
    assert profile.at(late) == (2.0,)


@pytest.mark.parametrize("name", ["battle_10h", "battle_40h", "commissioning_10h"])
def test_shipped_profiles_run_on_a_rig_with_ordinary_limits(name: str) -> None:
    profile = read_profile(LOADS / f"{name}.csv")
    notes = validate(profile, LIMITS, period_s=1.0)
    assert profile.duration_s == 3600 * float(name.rpartition("_")[2].removesuffix("h"))
    assert any("fan_speed_pct" in note and "ramps at 5 %/s" in note for note in notes)


def _problems(tmp_path: Path, content: str, **options: float) -> list[str]:
    with pytest.raises(ProfileError) as caught:
        validate(read_profile(_write(tmp_path, content)), LIMITS, **{"period_s": 1.0, **options})
    return str(caught.value).split("\n")


def test_an_unknown_set_point_is_refused_with_the_nearest_one(tmp_path: Path) -> None:
    (problem,) = _problems(tmp_path, GOOD.replace("fan_speed_pct", "fans_speed_pct"))
    assert "load.csv moves 'fans_speed_pct', which is no set-point of this rig; did you mean fan_speed_pct?" in problem


def test_an_unlike_set_point_is_refused_with_what_the_rig_takes(tmp_path: Path) -> None:
    (problem,) = _problems(tmp_path, "time_s,heater_power_W,xyzzy_rpm\n0,600,1\n900,600,1\n")
    assert "'xyzzy_rpm'" in problem
    assert "the rig takes heater_power_W, pump_speed_pct" in problem


def test_a_unit_that_the_rig_does_not_take_is_refused(tmp_path: Path) -> None:
    (problem,) = _problems(tmp_path, "time_s,heater_power_kW\n0,0.6\n900,0.6\n")
    assert "gives heater_power in kW but the rig takes W; convert the column to heater_power_W" in problem


def test_a_value_outside_a_limit_is_refused_with_its_line(tmp_path: Path) -> None:
    low, high = _problems(tmp_path, HEADER + "0,600,40,70\n600,1200,100,70\n900,1300,100,70\n")
    assert "line 3 (and 1 more rows) sets heater_power_W to 1200 W, above the upper limit 1000 W" in low
    assert "line 2 sets pump_speed_pct to 40 %, below the lower limit 60 %; change the value" in high


def test_a_step_too_steep_for_its_plateau_is_refused_with_its_line(tmp_path: Path) -> None:
    (problem,) = _problems(tmp_path, HEADER + "0,600,100,55\n600,600,100,100\n604,600,100,55\n900,600,100,55\n")
    assert "line 3 moves fan_speed_pct from 55 to 100 %, which takes 9 s at 5 %/s but is held for only 4 s" in problem
    assert "hold it longer" in problem


def test_a_ramp_may_pass_breakpoints_of_other_set_points(tmp_path: Path) -> None:
    content = HEADER + "0,600,100,55\n600,600,100,100\n604,620,100,100\n900,620,100,100\n"
    notes = validate(read_profile(_write(tmp_path, content)), LIMITS, period_s=1.0)
    assert "fan_speed_pct: 1 step is a ramp at 5 %/s, the longest 9 s at line 3" in notes


def test_a_profile_shorter_than_a_window_is_refused(tmp_path: Path) -> None:
    (problem,) = _problems(tmp_path, SHORT)
    assert "lasts 300 s, less than one calibration window of 600 s; extend its last row, repeat it" in problem
    assert problem.endswith("or run it without a twin (hil run --no-twin)")
    validate(read_profile(_write(tmp_path, SHORT)), LIMITS, min_duration_s=0.0, period_s=1.0)


def test_a_row_between_two_ticks_is_refused(tmp_path: Path) -> None:
    (problem,) = _problems(tmp_path, HEADER + "0,600,100,70\n600.2,610,100,70\n600.8,600,100,70\n1200,600,100,70\n")
    assert "line 3 is replaced before the next tick of 1 s; hold each row for at least one tick" in problem


def test_a_profile_without_heater_power_is_refused_and_without_fan_noted(tmp_path: Path) -> None:
    (problem,) = _problems(tmp_path, "time_s,pump_speed_pct\n0,100\n900,100\n")
    assert "has no column heater_power_W; add it" in problem
    notes = validate(
        read_profile(_write(tmp_path, "time_s,heater_power_W,pump_speed_pct\n0,600,100\n900,600,100\n")),
        LIMITS,
        period_s=1.0,
    )
    assert any(note.startswith("fan_speed_pct is not in") and "stays at its start value" in note for note in notes)


def test_new_values_in_the_last_row_are_noted(tmp_path: Path) -> None:
    profile = read_profile(_write(tmp_path, HEADER + "0,600,100,70\n900,700,100,70\n"))
    assert any("line 3 is the end of" in note for note in validate(profile, LIMITS, period_s=1.0))


def test_all_problems_are_told_together(tmp_path: Path) -> None:
    problems = _problems(tmp_path, "time_s,heater_power_kW,fan_speed_pct\n0,0.6,120\n300,0.6,120\n")
    assert len(problems) == 3
    assert all("load.csv" in problem for problem in problems)


@pytest.mark.parametrize(
    ("cell", "remedy"),
    [
        ('"2,500"', "write 2500 for the thousands, or 2.500 for the fraction"),
        ('"1,250,000"', "write 1250000 for the thousands"),
        ("1 500", "write 1500 for the thousands"),
        ('"70,5"', "use a decimal point instead of the comma"),
        ('"0,500"', "use a decimal point instead of the comma"),
        ("many", "write a plain number"),
    ],
)
def test_a_number_with_a_comma_gets_the_remedy_of_what_it_may_mean(tmp_path: Path, cell: str, remedy: str) -> None:
    with pytest.raises(
        ProfileError, match=r"load.csv line 2 has .* for heater_power_W, which is not a number"
    ) as refusal:
        read_profile(_write(tmp_path, f"time_s,heater_power_W\n0,{cell}\n900,700\n"))
    assert str(refusal.value).endswith(f"; {remedy}")


def test_percentages_that_look_like_fractions_of_one_are_refused_unless_the_limit_is_as_low(tmp_path: Path) -> None:
    limits = {"heater_power_W": LIMITS["heater_power_W"], "valve_pct": SetpointLimit(0, 100, None, "%")}
    text = "time_s,heater_power_W,valve_pct\n0,100,{}\n600,100,{}\n1200,100,0\n"
    fractions = read_profile(_write(tmp_path, text.format("0.4", "1")))
    with pytest.raises(ProfileError, match=r"line 3 sets valve_pct to at most 1 %: is it a fraction of 1\? Write 80"):
        validate(fractions, limits, period_s=1.0)
    validate(fractions, limits | {"valve_pct": SetpointLimit(0, 1, None, "%")}, period_s=1.0)
    for first, second in ((0, 0), (1, 5)):  # closed, and a valve that opens further
        validate(read_profile(_write(tmp_path, text.format(first, second))), limits, period_s=1.0)


def test_a_set_point_that_is_named_itself_is_referred_to_its_readback(tmp_path):
    path = tmp_path / "load.csv"
    path.write_text("time_s,heater_1_pct\n0,10\n600,20\n", encoding="utf-8")
    limits = {"P1_pct": SetpointLimit(0, 100, None, "%", setpoint="heater_1_pct")}
    with pytest.raises(ProfileError) as caught:
        validate(read_profile(path), limits | {"heater_2_pct": SetpointLimit(0, 100, None, "%")}, period_s=1.0)
    assert "names the set-point 'heater_1_pct' itself; call the column P1_pct, its readback" in str(caught.value)
    assert "P1_pct; add it" not in str(caught.value)
