"""Transport delays in the kernel: plug flow, looked up by the volume that has followed the water.

Each flow counts the volume v that it has moved. Each delay stores its water in slots of that volume:
a + r (m + r b) at the share r of a slot. While one step fills a slot, a and m are the water at its start and its slope
there. b is the difference to the water at its end. The error is then of third order in the step. Slower flows fill a
slot in several steps. It then has the water at both ends and the mean of the water that has gone in. Jumps lie between
slots, or lose their shape.

The outlet at v is the water at v - volume. If one step moves more than the volume, it is that at v minus the volume
moved in the step. Only the share `late` of the water is then delayed (see `twin.elements.fragments.PlugFlowDelay`).
So a look-up never needs the step under way. The outlet over a step runs through parts of slots. The kernel takes the
quadratic in time that has the same mean and first two moments. So a jump in the middle of a step acts correctly on
everything that is slow against the step, and no heat is lost on the way.

If all lanes share flow and volumes, the volumes are counted once and the weights of a look-up are scalars. If they do
not, every lane has its own, and all lanes go through the slots that any of them needs.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from twin.kernel.functions import DELAY_STATE, SEPARATE_FLOW, SHARED_FLOW
from twin.kernel.source_text import KernelText, indent
from twin.network.assembly import NetworkEquations

SLOTS = 64
"""Number of slots of a delay line, a power of two; the longest pipe of a flow never needs more than SLOTS - 4."""
NEVER = 1.0e6
"""Volume of a slot of water that was there from the beginning, L."""
PARTS = 3
"""Number of coefficients of a slot's water."""


@dataclass(frozen=True)
class DelayLayout:
    """Rows of the delay lines in a full state: volumes of each flow, steps since a slot was closed, then each delay's
    water.

    The rows of a delay's water hold one coefficient after the other.
    """

    volumes: tuple[int, ...]
    waters: tuple[int, ...]
    rows: int

    @property
    def pushed(self) -> list[int]:
        """Return the rows that are the same in all lanes where those share flow and volumes."""
        return [row + e for row in self.volumes for e in range(SLOTS + 1)]


def delay_layout(system: NetworkEquations) -> DelayLayout:
    """Return the layout of a system's delay lines."""
    flows, count = len(system.flows), len(system.delays)
    waters = flows * (SLOTS + 1)
    return DelayLayout(
        tuple(g * (SLOTS + 1) for g in range(flows)),
        tuple(waters + p * PARTS * SLOTS for p in range(count)),
        waters + count * PARTS * SLOTS,
    )


def delay_lines(system: NetworkEquations, text: KernelText, same_flow: bool) -> DelayLines:
    """Return the delay lines of a kernel; `same_flow` says that all lanes share flow and volumes, in the past too."""
    return SharedDelayLines(system, text) if same_flow else SeparateDelayLines(system, text)


class DelayLines(ABC):
    """Source lines of a kernel's delay lines.

    V holds the volume at which each slot begins, SLOTS rows for each flow; H the water, 3 SLOTS rows for each delay. A
    substep reads the rows Ds, Da, Db of the work array, the outlet over the step. It writes wb, ws, wn: the water that
    enters at its start, its slope over the step, the water at its end.
    """

    functions: ClassVar[str]
    lanes: int

    def __init__(self, system: NetworkEquations, text: KernelText) -> None:
        self.system, self.text = system, text
        self.flows, self.delays = range(len(system.flows)), system.delays
        for p in range(len(self.delays)):
            for name in ("Ds", "Da", "Db", "wb", "ws", "wn"):
                text.row(f"{name}{p}")
        self._layout = delay_layout(system)

    def head(self) -> list[str]:
        """Return the lines that allocate the arrays, once a call."""
        return [
            f"R = W.reshape(-1, {self.text.lanes})",
            f"V = np.zeros(({SLOTS * len(self.flows)}, {self.lanes}))",
            f"H = np.zeros(({PARTS * SLOTS * len(self.delays)}, {self.text.lanes}))",
        ]

    def enter(self) -> list[str]:
        """Fill the lines with the contents of `past`, or with the water at rest."""
        k, scalars = self.text, list[str]()
        for g in self.flows:
            row = self._layout.volumes[g]
            scalars += [
                f"since{g} = int(past[b, {row + SLOTS}, 0]) if past.shape[0] > 0 else 0",
                f"tip{g} = SLOTS - 1",
                f"i{g} = SLOTS - 1 if since{g} == 0 else SLOTS - 2",
                f"j{g} = (i{g} + 1) & (SLOTS - 1)",
            ]
        scalars += [f"s{p} = SLOTS - 2" for p in range(len(self.delays))]
        scalars += k.loop([f"{k.at(f'wb{p}')} = {delay.start}" for p, delay in enumerate(self.delays)])
        for p in range(len(self.delays)):
            scalars.append(f"fill_water(H, R, past, b, {p * SLOTS}, {self._layout.waters[p]}, {k.row(f'wb{p}')})")
        for g in self.flows:
            scalars.append(f"fill_volumes(V, past, b, {g * SLOTS}, {self._layout.volumes[g]})")
        return [*scalars, *self.begin()]

    @abstractmethod
    def begin(self) -> list[str]:
        """Set the volumes moved so far to zero."""

    @abstractmethod
    def refresh(self) -> list[str]:
        """Return the reach of each delay for this interval's flow and step, and the volume that closes a slot."""

    @abstractmethod
    def look(self) -> list[str]:
        """Return the lines that look up the outlets over the step."""

    @abstractmethod
    def move(self, g: int) -> list[str]:
        """Return the lines that advance the volume of flow g over the step and set boundary j."""

    @abstractmethod
    def share(self, g: int) -> str:
        """Return the step's share of the slot's volume: a number, or its row."""

    def reaches(self, own: Iterable[int]) -> list[str]:
        """Return, per delay, the volume that the look-up must reach back, and the share of the water that is
        delayed.
        """
        out = []
        for p in own:
            delay = self.delays[p]
            out.append(f"far{p} = max({delay.volume}, q{delay.line} * h)")
            out.append(f"{delay.late} = ({delay.volume}) / max(far{p}, 1e-12)")
        return out

    def outlets(self) -> list[str]:
        """Return the outlets in the middle and at the end of the step, for Runge-Kutta and for what depends on the
        end.
        """
        out = []
        for p in range(len(self.delays)):
            out += [f"Dm{p} = Ds{p} + 0.5 * (Da{p} + 0.5 * Db{p})", f"De{p} = Ds{p} + Da{p} + Db{p}"]
        return out

    def advance(self) -> list[str]:
        """Return the lines that store the water that has entered, and close slots that are wide enough."""
        out = list[str]()
        for g in self.flows:
            out += self.move(g)
            for p, delay in enumerate(self.delays):
                if delay.line == g:
                    rows = f"{self.text.row(f'wb{p}')}, since{g}, {self.share(g)}"
                    out.append(f"note(H, R, {p * SLOTS} + i{g}, {rows})")
            out += [
                f"since{g} += 1",
                f"tip{g} = j{g}",
                f"if V[{g * SLOTS} + j{g}, 0] - V[{g * SLOTS} + i{g}, 0] >= closing{g}:",
                f"    i{g} = j{g}",
                f"    since{g} = 0",
                f"j{g} = (i{g} + 1) & (SLOTS - 1)",
            ]
        return out

    def leave(self) -> list[str]:
        """Hand the lines on, oldest slot first, volumes counted from now."""
        lines = list[str]()
        for g in self.flows:
            lines.append(f"hand_volumes(V, future, b, {g * SLOTS}, {self._layout.volumes[g]}, tip{g}, since{g})")
        for p, delay in enumerate(self.delays):
            lines.append(f"hand_water(H, future, b, {p * SLOTS}, {self._layout.waters[p]}, tip{delay.line})")
        return ["if future.shape[0] > 0:", *indent(lines)]


class SharedDelayLines(DelayLines):
    """Delay lines of lanes that all share flow and volumes."""

    functions = DELAY_STATE + SHARED_FLOW

    def __init__(self, system: NetworkEquations, text: KernelText) -> None:
        super().__init__(system, text)
        self.lanes = 1

    def begin(self) -> list[str]:
        return [f"v{g} = 0.0" for g in self.flows]

    def refresh(self) -> list[str]:
        body = [f"q{g} = {flow}" for g, flow in enumerate(self.system.flows)] + self.reaches(range(len(self.delays)))
        # With one lane, the flow's quantities are rows like any other.
        out = self.text.loop(body, own=False) if self.text.lanes == 1 else body
        for g in self.flows:
            reaches = ", ".join([*(f"far{p}" for p, d in enumerate(self.delays) if d.line == g), "0.0"])
            out = [*out, f"span{g} = max(q{g} * h, 1e-12)", f"closing{g} = max({reaches}) / (SLOTS - 4)"]
        return out

    def look(self) -> list[str]:
        return [
            f"s{p} = look(V, H, R, {d.line * SLOTS}, {p * SLOTS}, s{p}, v{d.line} - far{p}, span{d.line}, tip{d.line}, "
            f"{self.text.row(f'Ds{p}')})"
            for p, d in enumerate(self.delays)
        ]

    def move(self, g: int) -> list[str]:
        width = f"max(v{g} - V[{g * SLOTS} + i{g}, 0], 1e-12)"
        return [f"v{g} += q{g} * h", f"V[{g * SLOTS} + j{g}, 0] = v{g}", f"share{g} = q{g} * h / {width}"]

    def share(self, g: int) -> str:
        return f"share{g}"


class SeparateDelayLines(DelayLines):
    """Delay lines of lanes that have a flow and volumes of their own; a slot closes for all, by the volume of lane
    0.
    """

    functions = DELAY_STATE + SEPARATE_FLOW

    def __init__(self, system: NetworkEquations, text: KernelText) -> None:
        super().__init__(system, text)
        self.lanes = text.lanes
        for name in (f"{n}{g}" for n in ("v", "q", "share") for g in self.flows):
            text.row(name)
        for p, delay in enumerate(self.delays):
            for name in (f"far{p}", f"place{p}", f"span{p}", delay.late):
                text.row(name)

    def begin(self) -> list[str]:
        return self.text.loop([f"{self.text.at(f'v{g}')} = 0.0" for g in self.flows])

    def refresh(self) -> list[str]:
        k, body, out = self.text, list[str](), list[str]()
        for g in self.flows:
            body += [f"q{g} = {self.system.flows[g]}", f"{k.at(f'q{g}')} = q{g}"]
        for p, delay in enumerate(self.delays):
            span = f"{k.at(f'span{p}')} = max(q{delay.line} * h, 1e-12)"
            body += [*self.reaches([p]), f"{k.at(f'far{p}')} = far{p}", f"{k.at(delay.late)} = {delay.late}", span]
        out += k.loop(body)
        for g in self.flows:
            # A lane with less flow than lane 0 needs more of that lane's volume for its pipe.
            slower = f"W[{k.row(f'q{g}') * k.lanes}] / max({k.at(f'q{g}')}, 1e-12)"
            slower = f"max({slower}, 1.0) / (SLOTS - 4)"
            own = [k.at(f"far{p}") for p, d in enumerate(self.delays) if d.line == g]
            widest = [f"closing{g} = max(closing{g}, {far} * {slower})" for far in own]
            out += [f"closing{g} = 0.0", f"for l in range({k.lanes}):", *indent(widest)]
        return out

    def look(self) -> list[str]:
        k = self.text
        out = k.loop([f"{k.at(f'place{p}')} = v{d.line} - far{p}" for p, d in enumerate(self.delays)])
        for p, d in enumerate(self.delays):
            rows = f"{k.row(f'place{p}')}, tip{d.line}, {k.row(f'Ds{p}')}"
            out.append(f"s{p} = look(V, H, R, {d.line * SLOTS}, {p * SLOTS}, s{p}, {rows})")
        return out

    def move(self, g: int) -> list[str]:
        k = self.text
        body = [f"v{g} = v{g} + q{g} * h", f"{k.at(f'v{g}')} = v{g}", f"V[{g * SLOTS} + j{g}, l] = v{g}"]
        width = f"max(v{g} - V[{g * SLOTS} + i{g}, l], 1e-12)"
        return k.loop([*body, f"{k.at(f'share{g}')} = q{g} * h / {width}"])

    def share(self, g: int) -> str:
        return str(self.text.row(f"share{g}"))
