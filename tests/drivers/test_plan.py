"""Read and write planning: protocol limits, whole values, nothing read twice, nothing written unasked."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from drivers.plan import plan_reads, plan_writes
from drivers.rigfile import Point


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
