"""Delay lines in the kernel: what the water was when it went in, looked up by the volume that followed it.

Each flow counts the volume v that it has moved, each delay remembers its water at the ends of slots of that volume:
slot s reaches from v_s to v_(s+1), with the water w_s + r (m_s + r (w_(s+1) - w_s - m_s)) at the share r of it. As
long as one step fills a slot, m is the slope at its start and the error is of third order in the step; slower
flows fill a slot in several steps and are taken as straight lines.

The outlet at v is the water at v - volume. Where one step moves more than the volume, it is that at v minus what
the step moves, and only the share `late` of the water is delayed (see `twin.elements.base.Delay`). So a look-up
never needs the step under way, and the outlet over a step is a known quadratic in time.

Lanes whose flows and volumes are nearly the same (the differences of a Jacobian, the common case of one pipe for
all particles) share the slot and stay vectorised; others look for theirs one by one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.affine import Form
from twin.assembly import System

if TYPE_CHECKING:
    from twin.codegen import _Kernel

SLOTS = 64
"""Slots of a delay line, a power of two; the longest pipe of a flow never needs more than SLOTS - 4."""
NEVER = 1.0e6
"""Volume of a slot of water that was there from the beginning, L."""

DELAY_FUNCTIONS = '''
@nb.njit('i8(f8[::1], i8, i8, f8, i8)', cache=True)
def seek(H, v, s, y, tip):
    """Slot that holds volume y, from slot s on; boundaries older than tip + 1 are gone."""
    while s != ((tip + 1) & (SLOTS - 1)) and H[v + s * LANES] > y:
        s = (s - 1) & (SLOTS - 1)
    while ((s + 1) & (SLOTS - 1)) != tip and H[v + ((s + 1) & (SLOTS - 1)) * LANES] < y:
        s = (s + 1) & (SLOTS - 1)
    return s


@nb.njit('i8(f8[::1], f8[::1], i8, i8, i8, i8, i8, i8, i8, i8, f8, b1)', cache=True, fastmath=FAST, error_model='numpy')
def look(H, W, v, w, now, flow, far, out, s, tip, ahead, tight):
    """Water that comes out `ahead` seconds from now, for all lanes, into row `out`; the slot of lane 0."""
    s = seek(H, v, s, W[now] + ahead * W[flow] - W[far], tip)
    if tight:
        here, then, width = v + s * LANES, w + ((s + 1) & (SLOTS - 1)) * LANES, v + (SLOTS + s) * LANES
        first, slope = w + s * LANES, w + (SLOTS + s) * LANES
        for l in range(LANES):
            r = (W[now + l] + ahead * W[flow + l] - W[far + l] - H[here + l]) * H[width + l]
            a, m = H[first + l], H[slope + l]
            W[out + l] = a + r * (m + r * (H[then + l] - a - m))
        return s
    for l in range(LANES):
        y = W[now + l] + ahead * W[flow + l] - W[far + l]
        own = seek(H, v + l, s, y, tip)
        r = (y - H[v + own * LANES + l]) * H[v + (SLOTS + own) * LANES + l]
        a, m = H[w + own * LANES + l], H[w + (SLOTS + own) * LANES + l]
        W[out + l] = a + r * (m + r * (H[w + ((own + 1) & (SLOTS - 1)) * LANES + l] - a - m))
    return s


@nb.njit('void(f8[::1], f8[::1], i8, i8, i8, i8, i8, f8)', cache=True, fastmath=FAST, error_model='numpy')
def move(H, W, v, now, flow, i, j, h):
    """Volume at the end of a step, from boundary i to boundary j."""
    for l in range(LANES):
        y = W[now + l] + W[flow + l] * h
        W[now + l] = y
        H[v + j * LANES + l] = y
        H[v + (SLOTS + i) * LANES + l] = 1.0 / max(y - H[v + i * LANES + l], 1e-12)


@nb.njit('void(f8[::1], f8[::1], i8, i8, i8, i8, i8, b1)', cache=True, fastmath=FAST, error_model='numpy')
def note(H, W, w, water, slope, i, j, whole):
    """Water at boundary j; a slot that one step fills keeps its slope, any other is a straight line."""
    for l in range(LANES):
        H[w + j * LANES + l] = W[water + l]
    if whole:
        for l in range(LANES):
            H[w + (SLOTS + i) * LANES + l] = W[slope + l]
    else:
        for l in range(LANES):
            H[w + (SLOTS + i) * LANES + l] = W[water + l] - H[w + i * LANES + l]
'''


def memory_rows(system: System) -> int:
    """Rows of what the delay lines of a system remember."""
    return (SLOTS + 1) * len(system.flows) + 2 * SLOTS * len(system.delays)


class DelayLines:
    """Source lines of a kernel's delay lines. Flow g keeps its volumes, delay p its water, in array H."""

    def __init__(self, system: System, kernel: _Kernel) -> None:
        self.system, self.kernel, self.lanes = system, kernel, kernel.lanes
        self.flows, self.delays = range(len(system.flows)), system.delays
        for g in self.flows:
            kernel.row(f"v{g}")
            kernel.row(f"q{g}")
        for p, delay in enumerate(self.delays):
            for name in (f"far{p}", f"Ds{p}", f"Dm{p}", f"De{p}", f"wn{p}", f"ws{p}", delay.late):
                kernel.row(name)

    def _v(self, g: int) -> int:
        """Offset in H of the volumes of flow g; one over the widths of the slots follow."""
        return 2 * g * SLOTS * self.lanes

    def _w(self, p: int) -> int:
        """Offset in H of the water of delay p; its slopes follow."""
        return 2 * (len(self.flows) + p) * SLOTS * self.lanes

    def _in_slot(self, offset: int, slot: str) -> str:
        return f"H[{offset} + {slot} * {self.lanes} + l]"

    def head(self) -> list[str]:
        return [f"H = np.zeros({2 * (len(self.flows) + len(self.delays)) * SLOTS * self.lanes})"]

    def enter(self) -> list[str]:
        """Fill the lines: with what `past` holds, or with the water at rest."""
        k, rest, load = self.kernel, list[str](), list[str]()
        row = 0
        lines: list[str] = []
        for g in self.flows:
            v = self._v(g)
            rest += [f"{self._in_slot(v, 'e')} = (e - SLOTS + 1) * {NEVER!r}"]
            rest += [f"{self._in_slot(v + SLOTS * self.lanes, 'e')} = {1.0 / NEVER!r}"]
            load += [f"{self._in_slot(v, 'e')} = past[b, {row} + e, l]"]
            width = f"past[b, {row} + min(e + 1, SLOTS - 1), l] - past[b, {row} + e, l]"
            load += [f"{self._in_slot(v + SLOTS * self.lanes, 'e')} = 1.0 / max({width}, 1e-12)"]
            row += SLOTS
            lines += [f"since{g} = 0", f"if past.shape[0] > 0: since{g} = int(past[b, {row}, 0])"]
            lines += [f"tip{g} = SLOTS - 1", f"i{g} = SLOTS - 1 if since{g} == 0 else SLOTS - 2"]
            lines += [f"j{g} = (i{g} + 1) & (SLOTS - 1)"]
            row += 1
            for p, delay in enumerate(self.delays):
                if delay.line == g:
                    w = self._w(p)
                    rest += [f"{self._in_slot(w, 'e')} = {delay.start}"]
                    rest += [f"{self._in_slot(w + SLOTS * self.lanes, 'e')} = 0.0"]
                    load += [f"{self._in_slot(w, 'e')} = past[b, {row} + e, l]"]
                    load += [f"{self._in_slot(w + SLOTS * self.lanes, 'e')} = past[b, {row + SLOTS} + e, l]"]
                    row += 2 * SLOTS
                    lines.append(f"s{p} = SLOTS - 2")
        lines += ["if past.shape[0] > 0:", "    for e in range(SLOTS):", *_in(k.loop(load), 2)]
        lines += ["else:", "    for e in range(SLOTS):", *_in(k.loop(rest), 2)]
        return lines + k.loop([f"{k.at(f'v{g}')} = 0.0" for g in self.flows])

    def refresh(self) -> list[str]:
        """Reach of each delay for the flow and step of this interval, and whether lanes may share a slot."""
        k, body, out = self.kernel, list[str](), list[str]()
        for g in self.flows:
            body += [f"q{g} = {self.system.flows[g]}", f"{k.at(f'q{g}')} = q{g}"]
        for p, delay in enumerate(self.delays):
            far = f"far{p}"
            body += [
                f"{far} = max({delay.volume}, q{delay.line} * h)",
                f"{k.at(far)} = {far}",
                f"{k.at(delay.late)} = ({delay.volume}) / max({far}, 1e-12)",
            ]
        out += k.loop(body)
        for g in self.flows:
            out += [f"closing{g} = 0.0", f"tight{g} = True"]
            own = [p for p, d in enumerate(self.delays) if d.line == g]
            # Slots are counted in the volume of lane 0; a lane with less flow needs more of that for its pipe.
            slower = f"W[{k.row(f'q{g}') * self.lanes}] / max({k.at(f'q{g}')}, 1e-12)"
            slower = f"max({slower}, 1.0) / (SLOTS - 4)"
            widest = [f"closing{g} = max(closing{g}, {k.at(f'far{p}')} * {slower})" for p in own]
            out += [f"for l in range({self.lanes}):", *_in(widest)]
            first = {name: f"W[{k.row(name) * self.lanes}]" for name in (f"q{g}", *(f"far{p}" for p in own))}
            apart = [f"abs({k.at(f'far{p}')} - {first[f'far{p}']}) > 0.05 * closing{g}" for p in own]
            apart.append(f"abs({k.at(f'q{g}')} - {first[f'q{g}']}) > 1e-3 * {first[f'q{g}']}")
            out += [f"for l in range({self.lanes}):", f"    if {' or '.join(apart)}: tight{g} = False"]
        return out

    def look(self) -> list[str]:
        """Outlets at the start, the middle and the end of the step."""
        out, fresh = list[str](), list[str]()
        for p, delay in enumerate(self.delays):
            g, row = delay.line, {n: self.kernel.row(n) * self.lanes for n in (f"v{delay.line}", f"q{delay.line}")}

            def call(
                target: str, ahead: str, p: int = p, g: int = g, at: tuple[int, int] = (row[f"v{g}"], row[f"q{g}"])
            ) -> str:
                far, to = (self.kernel.row(n) * self.lanes for n in (f"far{p}", f"{target}{p}"))
                places = f"{self._v(g)}, {self._w(p)}, {at[0]}, {at[1]}, {far}, {to}"
                return f"s{p} = look(H, W, {places}, s{p}, tip{g}, {ahead}, tight{g})"

            fresh.append(call("Ds", "0.0"))
            out += [call("Dm", "h2"), call("De", "h")]
        return ["if fresh:", *_in(fresh), "    fresh = False", *out]

    def polynomials(self) -> list[str]:
        """Outlets over the step as Ds + Da r + Db r^2."""
        out = []
        for p in range(len(self.delays)):
            out += [f"Da{p} = 4.0 * Dm{p} - 3.0 * Ds{p} - De{p}", f"Db{p} = 2.0 * (Ds{p} + De{p} - 2.0 * Dm{p})"]
        return out

    def water(self, new: dict[str, str]) -> list[str]:
        """Water that enters at the end of the step, and its slope at the start; `new` names the temperatures there."""
        from twin.codegen import ordered, renamed

        k, out = self.kernel, list[str]()
        start = {f"x{j}": f"e{j}" for j in range(k.k)} | k.starts_of_delays("Da")
        for p in range(len(self.delays)):
            form = self.system.waters[p]
            out += [
                f"{k.at(f'wn{p}')} = {renamed(ordered(form), new)}",
                f"{k.at(f'ws{p}')} = {renamed(ordered(Form(form.slopes)), start)}",
                f"{k.at(f'Ds{p}')} = De{p}",
            ]
        return out

    def advance(self) -> list[str]:
        """Remember what has entered, and close slots that are wide enough."""
        out = []
        rows = {name: row * self.lanes for name, row in self.kernel.rows.items()}
        for g in self.flows:
            v = self._v(g)
            out.append(f"move(H, W, {v}, {rows[f'v{g}']}, {rows[f'q{g}']}, i{g}, j{g}, h)")
            for p, delay in enumerate(self.delays):
                if delay.line == g:
                    out.append(
                        f"note(H, W, {self._w(p)}, {rows[f'wn{p}']}, {rows[f'ws{p}']}, i{g}, j{g}, since{g} == 0)"
                    )
            width = f"H[{v} + j{g} * {self.lanes}] - H[{v} + i{g} * {self.lanes}]"
            out += [
                f"since{g} += 1",
                f"tip{g} = j{g}",
                f"if {width} >= closing{g}:",
                f"    i{g} = j{g}",
                f"    since{g} = 0",
                f"j{g} = (i{g} + 1) & (SLOTS - 1)",
            ]
        return out

    def leave(self) -> list[str]:
        """Hand the lines on, oldest slot first, volumes counted from now."""
        k, body, extra = self.kernel, list[str](), list[str]()
        row = 0
        for g in self.flows:
            slot = f"((tip{g} + 1 + e) & (SLOTS - 1))"
            body.append(f"future[b, {row} + e, l] = {self._in_slot(self._v(g), slot)} - v{g}")
            extra.append(f"future[b, {row + SLOTS}, l] = since{g}")
            row += SLOTS + 1
            for p, delay in enumerate(self.delays):
                if delay.line == g:
                    w = self._w(p)
                    body.append(f"future[b, {row} + e, l] = {self._in_slot(w, slot)}")
                    body.append(f"future[b, {row + SLOTS} + e, l] = {self._in_slot(w + SLOTS * self.lanes, slot)}")
                    row += 2 * SLOTS
        lines = ["if future.shape[0] > 0:", "    for e in range(SLOTS):", *_in(k.loop(body), 2)]
        return lines + _in(k.loop(extra))


def delay_lines(system: System, kernel: _Kernel) -> DelayLines:
    return DelayLines(system, kernel)


def _in(lines: list[str], depth: int = 1) -> list[str]:
    return ["    " * depth + line for line in lines]
