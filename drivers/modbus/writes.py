"""Writes of points: blocks, their raw registers, and the values that a device then holds. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from drivers.bus import judge
from drivers.modbus.read_plan import Block, plan_writes
from drivers.rig_file import ModbusBusSection, Point
from drivers.signals import ConfigurationError, decode, encoder

_Put = tuple[str, float, float, Callable[[float], list[int]]]


class Writes:
    """Blocks to write, planned once for each set of point names."""

    def __init__(self, points: Mapping[str, Point], config: ModbusBusSection) -> None:
        self._points = points
        self._config = config
        self._plans: dict[tuple[str, ...], list[tuple[Block, list[_Put]]]] = {}

    def of(self, values: Mapping[str, float]) -> list[tuple[Block, list[int]]]:
        """Return blocks with registers, or bits as 0 and 1; raise ConfigurationError where a value does not fit."""
        names = tuple(values)
        plan = self._plans.get(names)
        if plan is None:
            blocks = plan_writes(
                (self._points[name] for name in names),
                max_write=self._config.max_write,
                max_write_bits=self._config.max_write_bits,
                multiple=self._config.write_multiple,
            )
            plan = [(b, [(p.name, p.offset, p.scale, encoder(p.type, p.order)) for p in b.points]) for b in blocks]
            self._plans[names] = plan
        return [(block, _raw(puts, values)) for block, puts in plan]


def _raw(puts: list[_Put], values: Mapping[str, float]) -> list[int]:
    raw: list[int] = []
    for name, offset, scale, encoded in puts:
        try:
            raw += encoded((values[name] - offset) / scale)
        except ValueError as error:
            raise ConfigurationError(f"{name}: {error}; correct its type or scale") from error
    return raw


def values_of(block: Block, registers: Sequence[int]) -> dict[str, float]:
    """Return the engineering values of a block's points, by name."""
    found: dict[str, float] = {}
    for point in block.points:
        at = (point.address or 0) - block.address
        raw = decode(registers[at : at + point.width], point.type, point.order, point.bits)
        found[point.name], _ = judge(point, raw)
    return found
