"""Pictures of networks: everything named, and every shipped twin can be drawn."""

from pathlib import Path

import pytest

from tests.twin.conftest import ROOT
from twin.drawing import draw
from twin.elements.node import Node
from twin.twinfile import load

TWINS = sorted((ROOT / "profiles" / "twins").glob("*.toml"))


@pytest.mark.parametrize("twin", TWINS, ids=lambda p: p.stem)
def test_every_shipped_twin_is_drawn(twin: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import matplotlib

    # text as text, so that the names can be looked for
    monkeypatch.setitem(matplotlib.rcParams, "svg.fonttype", "none")
    network = load(twin)
    text = draw(network, tmp_path / "picture.svg").read_text(encoding="utf-8")
    for element in network.elements:
        if element.kind not in ("flow", "actuator"):
            assert element.name in text, element.name
    assert sum(isinstance(e, Node) for e in network.elements) == len(network.nodes)
    for column in network.input_columns:
        assert column in text


def test_a_picture_of_pixels(loop, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    assert draw(loop, tmp_path / "loop.png").read_bytes().startswith(b"\x89PNG")
