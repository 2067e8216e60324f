"""Delay lines in the kernel: what the water was when it went in, looked up by the volume that followed it.

Each flow counts the volume v that it has moved, each delay remembers its water in slots of that volume: a + r (m + r b)
at the share r of a slot. As long as one step fills a slot, a, m and b are the water at its start, its slope there and
what is missing to the water at its end, and the error is of third order in the step; where slower flows fill a slot in
several steps, it has the water at both ends and the mean of what has gone in. Jumps lie between slots, or lose shape.

The outlet at v is the water at v - volume. Where one step moves more than the volume, it is that at v minus what
the step moves, and only the share `late` of the water is delayed (see `twin.elements.base.Delay`). So a look-up
never needs the step under way. The outlet over a step runs through parts of slots; the kernel takes the quadratic in
time that has the same mean and first two moments, so a jump in the middle of a step does what it should to whatever
is slow beside the step, and no heat is lost on the way.

Where all lanes share flow and volumes the volumes are counted once and the weights of a look-up are scalars; where
they do not, every lane has its own, and all lanes go through the slots that any of them needs.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from twin.assembly import System

if TYPE_CHECKING:
    from twin.codegen import _Kernel

SLOTS = 64
"""Slots of a delay line, a power of two; the longest pipe of a flow never needs more than SLOTS - 4."""
NEVER = 1.0e6
"""Volume of a slot of water that was there from the beginning, L."""
PARTS = 3
"""Coefficients of a slot's water."""

_FILL = '''
@nb.njit('void(f8[:,::1], f8[:,:,::1], i8, i8, i8)', cache=True)
def fill_volumes(V, past, b, line, row):
    """Volumes of a flow at which its slots begin, counted from now; at rest all but the last slots are far away."""
    for e in range(SLOTS):
        for l in range(V.shape[1]):
            V[line + e, l] = past[b, row + e, l] if past.shape[0] > 0 else (e - SLOTS + 1) * NEVER


@nb.njit('void(f8[:,::1], f8[:,::1], f8[:,:,::1], i8, i8, i8, i8)', cache=True)
def fill_water(H, R, past, b, line, row, water):
    """Water of a delay, slot by slot; at rest that in row `water`."""
    for e in range(SLOTS):
        for part in range(3):
            for l in range(LANES):
                rest = R[water, l] if part == 0 else 0.0
                H[3 * (line + e) + part, l] = past[b, row + part * SLOTS + e, l] if past.shape[0] > 0 else rest


@nb.njit('void(f8[:,::1], f8[:,:,::1], i8, i8, i8, i8, i8)', cache=True)
def hand_volumes(V, future, b, line, row, tip, since):
    """What `fill_volumes` takes up, oldest slot first, counted from the newest boundary; steps since a slot closed."""
    many = V.shape[1] > 1
    for l in range(LANES):
        own = l if many else 0
        for e in range(SLOTS):
            future[b, row + e, l] = V[line + ((tip + 1 + e) & (SLOTS - 1)), own] - V[line + tip, own]
        future[b, row + SLOTS, l] = since


@nb.njit('void(f8[:,::1], f8[:,:,::1], i8, i8, i8, i8)', cache=True)
def hand_water(H, future, b, line, row, tip):
    """What `fill_water` takes up."""
    for e in range(SLOTS):
        for part in range(3):
            for l in range(LANES):
                future[b, row + part * SLOTS + e, l] = H[3 * (line + ((tip + 1 + e) & (SLOTS - 1))) + part, l]
'''
_ALIKE = '''
@nb.njit('void(f8[:,::1], f8[:,::1], i8, i8, i8, f8)', cache=True, fastmath=FAST, error_model='numpy')
def note(H, R, i, water, steps, share):
    """Fill slot i. R: rows of the water that enters at the start, of its slope there, of the water at the end; the
    share of the slot's volume that this step is."""
    i = 3 * i
    if steps == 0:
        for l in range(LANES):  # one row to a loop: few rows to prove apart, and it stays vectorised
            H[i, l] = R[water, l]
        for l in range(LANES):
            H[i + 1, l] = R[water + 1, l]
        for l in range(LANES):
            H[i + 2, l] = R[water + 2, l] - R[water, l] - R[water + 1, l]
    else:
        for l in range(LANES):
            new = 2.0 / 3.0 * R[water, l] + 1.0 / 6.0 * R[water + 1, l] + 1.0 / 3.0 * R[water + 2, l]
            mean = H[i, l] + 0.5 * H[i + 1, l] + 1.0 / 3.0 * H[i + 2, l]
            mean += share * (new - mean)
            H[i + 1, l] = 6.0 * mean - 4.0 * H[i, l] - 2.0 * R[water + 2, l]
            H[i + 2, l] = R[water + 2, l] - H[i, l] - H[i + 1, l]


@nb.njit(
    'i8(f8[:,::1], f8[:,::1], f8[:,::1], i8, i8, i8, f8, f8, i8, i8)', cache=True, fastmath=FAST, error_model='numpy'
)
def look(V, H, R, flow, line, s, y, span, tip, out):
    """Quadratic in time of the water from volume y to y + span, into rows from `out` on; the slot that holds y."""
    while s != ((tip + 1) & (SLOTS - 1)) and V[flow + s, 0] > y:
        s = (s - 1) & (SLOTS - 1)
    while ((s + 1) & (SLOTS - 1)) != tip and V[flow + ((s + 1) & (SLOTS - 1)), 0] <= y:
        s = (s + 1) & (SLOTS - 1)
    cursor, low, high, keep = s, 0.0, 0.0, 0.0
    while high < 1.0:
        after = (s + 1) & (SLOTS - 1)
        begin, end = V[flow + s, 0], V[flow + after, 0]
        one = 1.0 / max(end - begin, 1e-12)
        high = 1.0 if after == tip else min(max((end - y) / span, low), 1.0)
        c = min(max((y + low * span - begin) * one, 0.0), 1.0)
        d = min(max((y + high * span - begin) * one, 0.0), 1.0) - c
        w = high - low
        # Integrals over the part of 1, t, t^2 times r^0, r, r^2 with r = c + d t, then of powers of the share.
        cc, cd, dd = c * c, 2.0 * c * d, d * d
        a0, a1, a2 = 1.0, 0.5, 1.0 / 3.0
        m0, m1, m2 = c + d / 2.0, c / 2.0 + d / 3.0, c / 3.0 + d / 4.0
        b0, b1, b2 = cc + cd / 2.0 + dd / 3.0, cc / 2.0 + cd / 3.0 + dd / 4.0, cc / 3.0 + cd / 4.0 + dd / 5.0
        a2 = w * (low * low * a0 + w * (2.0 * low * a1 + w * a2))
        m2 = w * (low * low * m0 + w * (2.0 * low * m1 + w * m2))
        b2 = w * (low * low * b0 + w * (2.0 * low * b1 + w * b2))
        a1, m1, b1 = w * (low * a0 + w * a1), w * (low * m0 + w * m1), w * (low * b0 + w * b1)
        a0, m0, b0 = w * a0, w * m0, w * b0
        ax, mx = 9.0 * a0 - 36.0 * a1 + 30.0 * a2, 9.0 * m0 - 36.0 * m1 + 30.0 * m2
        bx = 9.0 * b0 - 36.0 * b1 + 30.0 * b2
        ay = -36.0 * a0 + 192.0 * a1 - 180.0 * a2
        my = -36.0 * m0 + 192.0 * m1 - 180.0 * m2
        by = -36.0 * b0 + 192.0 * b1 - 180.0 * b2
        az, mz, bz = 30.0 * a0 - 180.0 * (a1 - a2), 30.0 * m0 - 180.0 * (m1 - m2), 30.0 * b0 - 180.0 * (b1 - b2)
        at = 3 * (line + s)
        for l in range(LANES):
            R[out, l] = keep * R[out, l] + (ax * H[at, l] + mx * H[at + 1, l] + bx * H[at + 2, l])
        for l in range(LANES):
            R[out + 1, l] = keep * R[out + 1, l] + (ay * H[at, l] + my * H[at + 1, l] + by * H[at + 2, l])
        for l in range(LANES):
            R[out + 2, l] = keep * R[out + 2, l] + (az * H[at, l] + mz * H[at + 1, l] + bz * H[at + 2, l])
        low, keep, s = high, 1.0, after
    return cursor
'''
_APART = '''
@nb.njit('void(f8[:,::1], f8[:,::1], i8, i8, i8, i8)', cache=True, fastmath=FAST, error_model='numpy')
def note(H, R, i, water, steps, share):
    """Fill slot i. R: rows of the water that enters at the start, of its slope there, of the water at the end; the
    share of the slot's volume that this step is."""
    i = 3 * i
    if steps == 0:
        for l in range(LANES):  # one row to a loop: few rows to prove apart, and it stays vectorised
            H[i, l] = R[water, l]
        for l in range(LANES):
            H[i + 1, l] = R[water + 1, l]
        for l in range(LANES):
            H[i + 2, l] = R[water + 2, l] - R[water, l] - R[water + 1, l]
    else:
        for l in range(LANES):
            new = 2.0 / 3.0 * R[water, l] + 1.0 / 6.0 * R[water + 1, l] + 1.0 / 3.0 * R[water + 2, l]
            mean = H[i, l] + 0.5 * H[i + 1, l] + 1.0 / 3.0 * H[i + 2, l]
            mean += R[share, l] * (new - mean)
            H[i + 1, l] = 6.0 * mean - 4.0 * H[i, l] - 2.0 * R[water + 2, l]
            H[i + 2, l] = R[water + 2, l] - H[i, l] - H[i + 1, l]


@nb.njit('i8(f8[:,::1], f8[:,::1], f8[:,::1], i8, i8, i8, i8, i8, i8)', cache=True, fastmath=FAST, error_model='numpy')
def look(V, H, R, flow, line, s, place, tip, out):
    """Quadratic in time of the water from each lane's volume y = R[place] to y + R[place + 1], into rows from `out` on;
    a slot that no lane's y lies before."""
    while s != ((tip + 1) & (SLOTS - 1)):
        over = 0
        for l in range(LANES):
            over += int(V[flow + s, l] > R[place, l])
        if over == 0:
            break
        s = (s - 1) & (SLOTS - 1)
    while ((s + 1) & (SLOTS - 1)) != tip:
        over, after = 0, (s + 1) & (SLOTS - 1)
        for l in range(LANES):
            over += int(V[flow + after, l] > R[place, l])
        if over > 0:
            break
        s = after
    cursor, first, more = s, 0.0, 1
    while more > 0:
        after = (s + 1) & (SLOTS - 1)
        last = 1.0 if after == tip else 0.0
        at, more = 3 * (line + s), 0
        for l in range(LANES):
            y, span = R[place, l], R[place + 1, l]
            begin, end = V[flow + s, l], V[flow + after, l]
            one = 1.0 / max(end - begin, 1e-12)
            low = first * min(max((begin - y) / span, 0.0), 1.0)
            high = max(min(max((end - y) / span, 0.0), 1.0), last)
            c = min(max((y + low * span - begin) * one, 0.0), 1.0)
            d = min(max((y + high * span - begin) * one, 0.0), 1.0) - c
            w = high - low
            a, m, b = H[at, l], H[at + 1, l], H[at + 2, l]
            a, m, b = a + c * (m + c * b), d * (m + 2.0 * c * b), d * d * b
            m0 = a + m / 2.0 + b / 3.0
            m1 = a / 2.0 + m / 3.0 + b / 4.0
            m2 = a / 3.0 + m / 4.0 + b / 5.0
            m2 = w * (low * low * m0 + w * (2.0 * low * m1 + w * m2))
            m1 = w * (low * m0 + w * m1)
            m0 = w * m0
            R[out, l] = first * R[out, l] + (9.0 * m0 - 36.0 * m1 + 30.0 * m2)
            R[out + 1, l] = first * R[out + 1, l] + (192.0 * m1 - 36.0 * m0 - 180.0 * m2)
            R[out + 2, l] = first * R[out + 2, l] + (30.0 * m0 - 180.0 * (m1 - m2))
            more += int(high < 1.0)
        first, s = 1.0, after
    return cursor
'''


@dataclass(frozen=True)
class Layout:
    """Rows of what delay lines hand on: of each flow's volumes, followed by the steps since a slot was closed; of each
    delay's water, one coefficient after the other."""

    volumes: tuple[int, ...]
    waters: tuple[int, ...]
    rows: int

    @property
    def pushed(self) -> list[int]:
        """Rows that are the same in all lanes where those share flow and volumes."""
        return [row + e for row in self.volumes for e in range(SLOTS + 1)]


def layout(system: System) -> Layout:
    flows, count = len(system.flows), len(system.delays)
    waters = flows * (SLOTS + 1)
    return Layout(
        tuple(g * (SLOTS + 1) for g in range(flows)),
        tuple(waters + p * PARTS * SLOTS for p in range(count)),
        waters + count * PARTS * SLOTS,
    )


def delay_lines(system: System, kernel: _Kernel, alike: bool) -> Delays:
    """`alike`: whether all lanes share flow and volumes, in the past too."""
    return AlikeLines(system, kernel) if alike else LinesApart(system, kernel)


class Delays(ABC):
    """Source lines of a kernel's delay lines.

    V holds the volume at which each slot begins, SLOTS rows for each flow; H the water, 3 SLOTS rows for each delay.
    Rows of the work array that a substep reads: Ds, Da, Db, the outlet over the step; that it writes: wb, ws, wn, the
    water that enters at its start, the slope of that over the step, the water at its end.
    """

    functions: ClassVar[str]
    lanes: int

    def __init__(self, system: System, kernel: _Kernel) -> None:
        self.system, self.kernel = system, kernel
        self.flows, self.delays = range(len(system.flows)), system.delays
        for p in range(len(self.delays)):
            for name in ("Ds", "Da", "Db", "wb", "ws", "wn"):
                kernel.row(f"{name}{p}")
        self._layout = layout(system)

    def head(self) -> list[str]:
        """Arrays, once a call."""
        return [
            f"R = W.reshape(-1, {self.kernel.lanes})",
            f"V = np.zeros(({SLOTS * len(self.flows)}, {self.lanes}))",
            f"H = np.zeros(({PARTS * SLOTS * len(self.delays)}, {self.kernel.lanes}))",
        ]

    def enter(self) -> list[str]:
        """Fill the lines: with what `past` holds, or with the water at rest."""
        k, scalars = self.kernel, list[str]()
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
        """No volume has been moved yet."""

    @abstractmethod
    def refresh(self) -> list[str]:
        """Reach of each delay for the flow and step of this interval, and how much volume closes a slot."""

    @abstractmethod
    def look(self) -> list[str]:
        """Outlets over the step."""

    @abstractmethod
    def move(self, g: int) -> list[str]:
        """Volume at the end of the step, and boundary j of flow g."""

    @abstractmethod
    def share(self, g: int) -> str:
        """Share of the slot's volume that the step is: a number, or its row."""

    def reaches(self, own: Iterable[int]) -> list[str]:
        """Of delays, what the water in them must still know of, and the share of the water that is delayed."""
        out = []
        for p in own:
            delay = self.delays[p]
            out.append(f"far{p} = max({delay.volume}, q{delay.line} * h)")
            out.append(f"{delay.late} = ({delay.volume}) / max(far{p}, 1e-12)")
        return out

    def outlets(self) -> list[str]:
        """Outlets in the middle and at the end of the step, for Runge-Kutta and for what hangs on the end."""
        out = []
        for p in range(len(self.delays)):
            out += [f"Dm{p} = Ds{p} + 0.5 * (Da{p} + 0.5 * Db{p})", f"De{p} = Ds{p} + Da{p} + Db{p}"]
        return out

    def advance(self) -> list[str]:
        """Remember what has entered, and close slots that are wide enough."""
        out = list[str]()
        for g in self.flows:
            out += self.move(g)
            for p, delay in enumerate(self.delays):
                if delay.line == g:
                    rows = f"{self.kernel.row(f'wb{p}')}, since{g}, {self.share(g)}"
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
        return ["if future.shape[0] > 0:", *_in(lines)]


class AlikeLines(Delays):
    """All lanes share flow and volumes."""

    functions = _FILL + _ALIKE

    def __init__(self, system: System, kernel: _Kernel) -> None:
        super().__init__(system, kernel)
        self.lanes = 1

    def begin(self) -> list[str]:
        return [f"v{g} = 0.0" for g in self.flows]

    def refresh(self) -> list[str]:
        body = [f"q{g} = {flow}" for g, flow in enumerate(self.system.flows)] + self.reaches(range(len(self.delays)))
        # With one lane, what belongs to it is a row like any other.
        out = self.kernel.loop(body, own=False) if self.kernel.lanes == 1 else body
        for g in self.flows:
            reaches = ", ".join([*(f"far{p}" for p, d in enumerate(self.delays) if d.line == g), "0.0"])
            out = [*out, f"span{g} = max(q{g} * h, 1e-12)", f"closing{g} = max({reaches}) / (SLOTS - 4)"]
        return out

    def look(self) -> list[str]:
        return [
            f"s{p} = look(V, H, R, {d.line * SLOTS}, {p * SLOTS}, s{p}, v{d.line} - far{p}, span{d.line}, tip{d.line}, "
            f"{self.kernel.row(f'Ds{p}')})"
            for p, d in enumerate(self.delays)
        ]

    def move(self, g: int) -> list[str]:
        width = f"max(v{g} - V[{g * SLOTS} + i{g}, 0], 1e-12)"
        return [f"v{g} += q{g} * h", f"V[{g * SLOTS} + j{g}, 0] = v{g}", f"share{g} = q{g} * h / {width}"]

    def share(self, g: int) -> str:
        return f"share{g}"


class LinesApart(Delays):
    """Every lane has a flow and volumes of its own. A slot is closed for all, by the volume of lane 0."""

    functions = _FILL + _APART

    def __init__(self, system: System, kernel: _Kernel) -> None:
        super().__init__(system, kernel)
        self.lanes = kernel.lanes
        for name in (f"{n}{g}" for n in ("v", "q", "share") for g in self.flows):
            kernel.row(name)
        for p, delay in enumerate(self.delays):
            for name in (f"far{p}", f"place{p}", f"span{p}", delay.late):
                kernel.row(name)

    def begin(self) -> list[str]:
        return self.kernel.loop([f"{self.kernel.at(f'v{g}')} = 0.0" for g in self.flows])

    def refresh(self) -> list[str]:
        k, body, out = self.kernel, list[str](), list[str]()
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
            out += [f"closing{g} = 0.0", f"for l in range({k.lanes}):", *_in(widest)]
        return out

    def look(self) -> list[str]:
        k = self.kernel
        out = k.loop([f"{k.at(f'place{p}')} = v{d.line} - far{p}" for p, d in enumerate(self.delays)])
        for p, d in enumerate(self.delays):
            rows = f"{k.row(f'place{p}')}, tip{d.line}, {k.row(f'Ds{p}')}"
            out.append(f"s{p} = look(V, H, R, {d.line * SLOTS}, {p * SLOTS}, s{p}, {rows})")
        return out

    def move(self, g: int) -> list[str]:
        k = self.kernel
        body = [f"v{g} = v{g} + q{g} * h", f"{k.at(f'v{g}')} = v{g}", f"V[{g * SLOTS} + j{g}, l] = v{g}"]
        width = f"max(v{g} - V[{g * SLOTS} + i{g}, l], 1e-12)"
        return k.loop([*body, f"{k.at(f'share{g}')} = q{g} * h / {width}"])

    def share(self, g: int) -> str:
        return str(self.kernel.row(f"share{g}"))


def _in(lines: list[str], depth: int = 1) -> list[str]:
    return ["    " * depth + line for line in lines]
