"""Read and write planning: protocol limits, whole values, nothing read twice, nothing written unasked."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.modbus.read_plan import Block, ReadPlan, plan_reads, plan_writes
from drivers.rig_file.bus_sections import Hole
from drivers.rig_file.model import Point


def point(address: int, kind: str = "uint16", table: str = "input") -> Point:
    return Point(name=f"p{address}", bus="b", unit="1", table=table, address=address, type=kind)


@st.composite
def point_maps(draw: st.DrawFn) -> list[Point]:
    points, address = [], 0
    for _ in range(draw(st.integers(1, 60))):
        address += draw(st.integers(0, 40))
        kind = draw(st.sampled_from(["uint16", "float32", "float64"]))
        points.append(point(address, kind, draw(st.sampled_from(["input", "holding"]))))
        address += points[-1].width
    return draw(st.permutations(points))


@given(points=point_maps(), max_read=st.integers(4, 125), max_gap=st.integers(0, 20))
def test_every_point_is_read_once_and_whole_within_the_limit(points, max_read, max_gap):
    blocks = plan_reads(points, max_read=max_read, max_gap=max_gap)
    assert sorted(p.name for block in blocks for p in block.points) == sorted(p.name for p in points)
    for block in blocks:
        assert 1 <= block.count <= max_read
        covered = set()
        for p in block.points:
            assert p.table == block.table
            assert block.address <= p.address
            assert p.address + p.width <= block.address + block.count
            covered |= set(range(p.address, p.address + p.width))
        holes = [a for a in range(block.address, block.address + block.count) if a not in covered]
        runs = "".join("x" if a in holes else " " for a in range(block.address, block.address + block.count)).split()
        assert all(len(run) <= max_gap for run in runs)


@given(points=point_maps())
def test_neighbouring_blocks_could_not_have_been_joined(points):
    blocks = plan_reads(points, max_read=125, max_gap=8)
    for first, second in zip(blocks, blocks[1:], strict=False):
        if first.table == second.table:
            gap = second.address - (first.address + first.count)
            head = second.points[0]
            joined = head.address + head.width - first.address
            assert gap > 8 or joined > 125


@given(points=point_maps())
def test_a_write_covers_no_register_that_was_not_asked_for(points):
    for block in plan_writes(points):
        assert block.count == sum(p.width for p in block.points) <= 123


# Every table, bit fields and holes -----------------------------------------------------------------------------------

TABLES = ("coil", "discrete", "holding", "input")


@st.composite
def whole_maps(draw: st.DrawFn) -> tuple[list[Point], list[Hole]]:
    """Points of all tables and types, bit fields that share registers, and holes between them."""
    points: list[Point] = []
    holes: list[Hole] = []
    for table in TABLES:
        address = draw(st.integers(0, 50))
        for _ in range(draw(st.integers(0, 12))):
            gap = draw(st.integers(0, 12))
            if gap >= 2 and draw(st.booleans()):
                holes.append(Hole(table=table, first=address + 1, last=address + draw(st.integers(1, gap - 1))))
            address += gap
            name = f"p{len(points)}"
            where = {"name": name, "bus": "b", "unit": "1", "table": table, "address": address}
            if table in ("coil", "discrete"):
                points.append(Point(**where))
                address += 1
                continue
            kind = draw(st.sampled_from(["uint16", "int32", "float64", "fields", "string"]))
            if kind == "fields":
                points += [Point(**where | {"name": f"{name}_{b}"}, bits=(b, b + 1)) for b in (0, 4, 14)]
            elif kind == "string":
                points.append(Point(**where, type="string", length=draw(st.integers(1, 9))))
            else:
                points.append(Point(**where, type=kind))
            address += points[-1].width
    return draw(st.permutations(points)), holes


def check(blocks: list[Block], points: list[Point], holes: list[Hole]) -> None:
    assert sorted(p.name for b in blocks for p in b.points) == sorted(p.name for p in points)
    for block in blocks:
        end = block.address + block.count
        assert all(p.table == block.table for p in block.points)
        assert min(p.address for p in block.points) == block.address
        assert max(p.address + p.width for p in block.points) == end
        for hole in holes:
            assert hole.table != block.table or hole.last < block.address or end <= hole.first


@given(layout=whole_maps(), most=st.integers(9, 125), gap=st.integers(0, 124), bits=st.integers(1, 2000))
def test_whatever_the_map_every_point_is_covered_once_within_limits_and_no_hole_is_touched(layout, most, gap, bits):
    points, holes = layout
    blocks = plan_reads(points, max_read=most, max_gap=gap, max_read_bits=bits, holes=holes)
    check(blocks, points, holes)
    for block in blocks:
        assert block.count <= (bits if block.table in ("coil", "discrete") else most)


@given(layout=whole_maps(), refusals=st.lists(st.integers(0, 10**6), max_size=40))
def test_what_is_refused_is_split_until_single_values_are_left_and_nothing_is_lost(layout, refusals):
    points, holes = layout
    plan = ReadPlan(plan_reads(points, holes=holes, max_gap=50))
    for pick in refusals:
        if not plan.blocks:
            break
        block = plan.blocks[pick % len(plan.blocks)]
        parts = plan.refuse(block, 0.0)
        assert parts or len({p.address for p in block.points}) == 1
        assert sum(part.count for part in parts) < block.count or block.unused == 0
        check(plan.blocks + list(plan.refused), points, holes)
    assert plan.due(29.0) == plan.blocks
    check(plan.due(30.0), points, holes)
    assert not plan.refused
    plan.forget()
    assert plan.blocks == list(plan.planned)


def test_a_refused_block_is_asked_for_at_its_gaps_first_then_in_halves():
    points = [point(a) for a in (0, 1, 2, 3, 7)]
    plan = ReadPlan(plan_reads(points))
    first, second = plan.refuse(plan.blocks[0], 0.0)
    assert [(b.address, b.count) for b in (first, second)] == [(0, 4), (7, 1)]
    assert [(b.address, b.count) for b in plan.refuse(first, 0.0)] == [(0, 2), (2, 2)]
    assert plan.refuse(second, 0.0) == []
    assert [str(block) for block in plan.refused] == ["input 7"]


def test_limits_of_the_specification_are_met_exactly():
    assert [b.count for b in plan_reads(point(a) for a in range(126))] == [125, 1]
    coils = [point(a, "bool", "coil") for a in range(2001)]
    assert [b.count for b in plan_reads(coils)] == [2000, 1]
    assert [b.count for b in plan_writes(coils)] == [1968, 33]
    assert [b.count for b in plan_writes(point(a, table="holding") for a in range(124))] == [123, 1]


@pytest.mark.parametrize(
    ("kind", "table", "count", "code"),
    [
        ("uint16", "holding", 1, 6),
        ("uint16", "holding", 2, 16),
        ("float32", "holding", 1, 16),
        ("float64", "holding", 1, 16),
        ("bool", "coil", 1, 5),
        ("bool", "coil", 2, 15),
    ],
)
def test_only_single_registers_and_bits_are_written_by_the_single_functions(kind, table, count, code):
    width = 2 if kind == "float32" else 4 if kind == "float64" else 1
    (block,) = plan_writes(point(10 + a * width, kind, table) for a in range(count))
    assert block.write_code == code


@pytest.mark.parametrize(("kind", "table", "code"), [("uint16", "holding", 16), ("bool", "coil", 15)])
def test_a_device_with_write_multiple_gets_single_values_by_the_functions_for_several(kind, table, code):
    (block,) = plan_writes([point(10, kind, table)], multiple=True)
    assert (block.count, block.write_code) == (1, code)


def test_bytes_of_a_request_and_its_reply():
    assert plan_reads([point(0, "float32")])[0].read_bytes == (5, 6)
    assert plan_reads([point(a, "bool", "coil") for a in range(9)])[0].read_bytes == (5, 4)
