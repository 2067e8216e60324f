"""Networks other than the shipped four-volume loop, for measurements of the kernel."""

from __future__ import annotations

from pathlib import Path

from hil.bench.peers import Absent
from twin import Network, TwinFileError, load, parse
from twin.elements import KINDS

TWINS = Path(__file__).resolve().parents[3] / "profiles" / "twins"

RADIATION = """
[elements.bench_radiation]
kind = "radiation"
node = "tank"
ambient = "T_ambient_C"
area = 1.5
"""


def nonlinear() -> Network:
    """Return the loop with radiation from the tank; raise Absent if this version has no such element."""
    if "radiation" not in KINDS:
        raise Absent("nonlinear network: this version has no element 'radiation'")
    text = (TWINS / "loop.toml").read_text(encoding="utf-8")
    try:
        return parse(text + RADIATION, "loop with radiation")
    except TwinFileError as error:
        raise Absent(f"nonlinear network: {error}") from None


def nine_volumes() -> Network:
    """Return the loop of six separate modules; raise Absent if it is not shipped."""
    path = TWINS / "loop_six.toml"
    if not path.is_file():
        raise Absent("six modules one by one: no profiles/twins/loop_six.toml")
    return load(path)
