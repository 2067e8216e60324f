"""Numbers and hosts of a rig file are taken as they are meant, or refused with the remedy."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from drivers.rig_file.reader import RigFileError, load_rig
from drivers.signals.units import canonical_unit

RIG = """\
[rig]
name = "one"

[bus.plc]
transport = "modbus_tcp"
host = "10.0.0.7"

[[point]]
name = "T_oil"
bus = "plc"
unit = "degC"
table = "input"
address = 12
scale = 0.1
plausible = [0, 90]
"""


def loaded(tmp_path: Path, old: str, new: str):
    assert old in RIG
    path = tmp_path / "rig.toml"
    path.write_text(RIG.replace(old, new), encoding="utf-8")
    return load_rig(path)


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("address = 12", 'address = "12"', 13, "must be a number, got '12' in quotes; take the quotes out"),
        ("scale = 0.1", 'scale = "1e-1"', 14, "must be a number, got '1e-1' in quotes"),
        ("[0, 90]", '[0, "90"]', 15, "must be a number, got '90' in quotes"),
        ("address = 12", "address = true", 13, "must be a number, got true"),
        ("10.0.0.7", "10.0.0.7:1502", 6, 'write host = "10.0.0.7" and port = 1502'),
        ("10.0.0.7", "http://chiller/", 6, "is a web address; give the name or the address alone"),
        ("10.0.0.7", "chiller ", 6, "has blanks"),
        ("10.0.0.7", "10.0.0.300", 6, "is no address: IPv4 has four numbers from 0 to 255"),
        ("10.0.0.7", "[fd00::7]:502", 6, 'write host = "fd00::7" and port = 502'),
    ],
)
def test_a_quoted_number_and_a_host_that_is_more_are_refused_with_the_line(tmp_path, old, new, line, said):
    with pytest.raises(RigFileError, match=rf"line {line}: .*{re.escape(said)}"):
        loaded(tmp_path, old, new)


@pytest.mark.parametrize("host", ["localhost", "chiller-2.lab.example", "fd00::7", "[::1]", "192.168.7.20"])
def test_names_and_addresses_are_hosts(tmp_path, host):
    assert loaded(tmp_path, "10.0.0.7", host).bus["plc"].host == host


@pytest.mark.parametrize(
    ("unit", "said"),
    [
        ("KW", "did you mean kW?"),
        ("GW", "1 GW is 1e+09 W; convert the values and write W"),
        ("mPa", "1 mPa is 0.001 Pa"),
        ("Mpa", "did you mean MPa?"),
        ("kvar", "1 kvar is 1000 var"),
        ("tr/min", "did you mean rpm?"),
        ("degF", "convert the values to degC"),
        ("kg/h", "the known ones are W, kW"),
    ],
)
def test_a_hint_for_a_unit_never_changes_the_size_of_a_value(unit, said):
    with pytest.raises(ValueError, match=re.escape(f"unit {unit!r} is not known; {said}")):
        canonical_unit(unit)
