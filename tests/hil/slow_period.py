"""The shipped virtual rig with a longer period, for tests of hours of its record.

A run of it takes fewer ticks, and its record has fewer rows. Tests of single ticks take the shipped file.
"""

from __future__ import annotations

from pathlib import Path

RIGS = Path(__file__).resolve().parents[2] / "profiles" / "rigs"


def slow_period_rig(folder: Path, period_s: float) -> Path:
    """Write the rig file with another period, s, into `folder`; return its path."""
    text = (RIGS / "virtual.toml").read_text(encoding="utf-8")
    for old, new in (
        ("period_s = 1.0", f"period_s = {period_s}"),
        # Limits that are counted in periods.
        ("abort_after_s = 5.0", f"abort_after_s = {5.0 * period_s}"),
        ("timeout_s = 10.0", f"timeout_s = {10.0 * period_s}"),
        ('"thermocouples.dbc"', f'"{RIGS}/thermocouples.dbc"'),
        ('"../twins/', f'"{RIGS.parent}/twins/'),
    ):
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path = folder / "slow.toml"
    path.write_text(text.replace("[[point]]\n", f"[[point]]\nstale_after_s = {3.0 * period_s}\n"), encoding="utf-8")
    return path
