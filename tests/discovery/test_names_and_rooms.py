"""Elements of a twin have any names, and its room is in any column: candidates and laws find free names there."""

from __future__ import annotations

import re

import pytest

from tests.discovery.conftest import HOUR, NOISE_K, Bench
from tests.twin.conftest import LOOP
from twin.discovery import diagnose
from twin.discovery.effects.catalogue import catalogue, extended
from twin.discovery.effects.laws import Book
from twin.discovery.effects.open_laws.sites import OpenSite, sites_of
from twin.discovery.effects.probe import Probe, free_run
from twin.discovery.records.grid import on_grid
from twin.elements.candidates import free_name
from twin.network import Network
from twin.twinfile import parse

TEXT = LOOP.read_text(encoding="utf-8")


def _with_loss(name: str) -> Network:
    """Return the loop with another name of the loss of its tank."""
    return parse(TEXT.replace("tank_loss", name))


def _sites(network: Network) -> list[OpenSite]:
    record = Bench(network).record(0.5)
    grid = on_grid(network, record.time_s, record.inputs, record.measured)
    _, run, *_ = free_run(Probe(network, ()), grid)
    return sites_of(network, Book(network).laws(grid, run))


@pytest.fixture(scope="module")
def usual() -> dict[str, OpenSite]:
    """Name -> site of the loop as it is shipped."""
    return {site.name: site for site in _sites(parse(TEXT))}


def test_a_free_name_is_that_of_no_element() -> None:
    network = parse(TEXT)
    assert free_name("tank_leak", network.elements) == "tank_leak"
    assert free_name("tank_loss", network.elements) == "tank_loss_2"


@pytest.mark.parametrize("kind", ["heat", "read", "flow", "loss", "solid", "transfer"])
def test_a_site_has_the_same_effect_where_its_name_is_taken(kind: str, usual: dict[str, OpenSite]) -> None:
    name = next(name for name in usual if name.startswith(f"{kind}_"))
    taken = next(iter(usual[name].tables))
    found = {site.name: site for site in _sites(_with_loss(taken))}
    assert found.keys() == usual.keys()
    assert f"{taken}_2" in found[name].tables and taken not in found[name].tables
    laws = {key for key, table in found[name].tables.items() if table["kind"] != "actuator"}
    assert {key.rpartition(".")[0] for key in found[name].changes} == laws


def test_candidates_of_a_catalogue_are_added_beside_elements_of_their_names() -> None:
    usual = catalogue(parse(TEXT))
    for taken in sorted({name for c in usual for name in c.adds})[::4]:
        network = _with_loss(taken)
        every = catalogue(network)
        renamed = [c for c in every if f"{taken}_2" in c.adds]
        assert len(every) == len(usual) and renamed
        for candidate in renamed:
            more = candidate.near() if candidate.near is not None else ()
            more += (candidate.slower(400.0),) if candidate.slower is not None else ()
            more += (candidate.at_level(40.0),) if candidate.at_level is not None else ()
            for one in (candidate, *more):
                bigger = extended(network, one)
                assert all(key in bigger.parameters for key in one.changes)


def test_the_room_is_the_column_that_elements_name() -> None:
    lines = TEXT.replace("T_ambient_C = {", "T_room_C = {").splitlines()
    named = [
        f'{line}\nambient = "T_room_C"' if line in ('kind = "ambient_loss"', 'kind = "radiator"') else line
        for line in lines
    ]
    network = parse("\n".join(named))
    assert parse(TEXT).room == "T_ambient_C"
    assert network.room == "T_room_C"
    usual = {site.name.replace("read_T_ambient_C", "read_T_room_C") for site in _sites(parse(TEXT))}
    assert {site.name for site in _sites(network)} == usual


def test_less_flow_of_the_second_of_two_circuits_is_named_with_that_circuit() -> None:
    """Heater and modules are one circuit, radiator and tank another; they meet in an exchanger."""
    ring = 'path = ["heater", "modules", "radiator", "tank"]'
    second = """
[elements.circuit2]
kind = "flow"
path = ["radiator", "tank"]
pump = "pump_speed_pct"
nominal = 3.0
factor = { value = 1.0, lower = 0.5, upper = 1.6, status = "boundary" }
"""
    meets = 'resistance = { value = 5.0, lower = 0.01, upper = 1000.0, source = "R_pm,r" }'
    assert ring in TEXT and meets in TEXT
    lines = [x for x in TEXT.splitlines() if not x.startswith(("effectiveness_radiator", "effectiveness_tank"))]
    text = "\n".join(lines).replace(ring, 'path = ["heater", "modules"]').replace(meets, "resistance = 0.01") + second
    network = parse(re.sub(r"circuit\.(effectiveness_(?:radiator|tank))", r"circuit2.\1", text))
    assert {c.where for c in catalogue(network) if c.kind == "flow" and c.driver == "constant"} >= {"loop", "circuit2"}
    network = network.with_values({f"{s.name}.sigma": NOISE_K for s in network.sensors} | {"tank.capacitance": 3.0e4})
    bench = Bench(network, HOUR)
    less = bench.record(14.0, changed=bench.with_values(circuit2__factor=0.6), onset_h=5.0)
    found = diagnose(network, less, bench.record(10.0, seed=7))
    # Of two volumes in a ring, water that passes by one of them is the same.
    told = {(e.kind, e.where) for e in (*found.effects, *found.indistinguishable)}
    assert ("flow", "circuit2") in told <= {("flow", "circuit2"), ("flow", "radiator"), ("flow", "tank")}
