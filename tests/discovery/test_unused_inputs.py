"""What is said of an input that no element uses, where it was ruled out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.discovery.test_a_room import ROOM
from tests.hil.made_diagnosis import effect, made
from twin.discovery.answer.unused_inputs import unused, with_unused
from twin.discovery.diagnosis import Alternative
from twin.network import Network
from twin.revisions import with_elements
from twin.twinfile import parse

INPUTS = np.column_stack([np.linspace(0.0, 9.0, 10)] * 3)
TRIED = "sun, which no element uses, was tried as heat source at room: "


@pytest.fixture(scope="module")
def room() -> Network:
    return parse(ROOM)


def test_sun_that_was_ruled_out_is_told_with_the_reason(room: Network) -> None:
    found = made("effect found")
    assert unused(found, room, INPUTS) == [f"{TRIED}it would explain less than what is listed as other explanations"]
    assert unused(replace(found, alternatives=()), room, INPUTS) == [f"{TRIED}it would explain next to nothing"]
    assert unused(made("adequate"), room, INPUTS) == [f"{TRIED}nothing is left for it to explain"]
    assert unused(found, room, 0.0 * INPUTS) == [f"{TRIED}it does not move in this record"]
    assert with_unused(found, room, INPUTS).notes == (*found.notes, *unused(found, room, INPUTS))


def test_sun_that_is_told_of_or_used_is_not_told_again(room: Network) -> None:
    found = made("effect found")
    listed = replace(found, alternatives=(Alternative("heat_source", "room", "sun", 0.0, "gains 3"),))
    assert unused(listed, room, INPUTS) == []
    assert unused(made("effect found", (replace(effect(), driver="sun"),)), room, INPUTS) == []
    sun = {"kind": "heat_source", "node": "room", "driver": "sun_W_m2", "law": "linear", "gain": 6.0}
    assert unused(found, with_elements(room, {"sun": sun}), INPUTS) == []
