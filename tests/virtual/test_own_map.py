"""Rig files that describe the virtual rig itself, and those that do not."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.rig_file.reader import load_rig
from drivers.virtual.own_map import is_own_rig

SHIPPED = Path(__file__).resolve().parents[2] / "profiles" / "rigs" / "virtual.toml"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('order = "CDAB"', 'order = "ABCD"'),
        ("scale = 0.01", "scale = 0.1"),
        ("address = 11", "address = 12"),
        ('transport = "modbus_tcp"', 'transport = "modbus_rtu_tcp"'),
        ("device_id = 1", "device_id = 2"),
    ],
)
def test_another_map_or_wire_is_another_rig(tmp_path: Path, old: str, new: str) -> None:
    text = SHIPPED.read_text().replace("thermocouples.dbc", str(SHIPPED.parent / "thermocouples.dbc"))
    path = tmp_path / "rig.toml"
    path.write_text(text)
    assert is_own_rig(load_rig(path))
    assert old in text
    path.write_text(text.replace(old, new, 1))
    assert not is_own_rig(load_rig(path))
