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
    while s != ((tip + 1) & (SLOTS - 1)) and H[v + s * 2 * LANES] > y:
        s = (s - 1) & (SLOTS - 1)
    while ((s + 1) & (SLOTS - 1)) != tip and H[v + ((s + 1) & (SLOTS - 1)) * 2 * LANES] < y:
        s = (s + 1) & (SLOTS - 1)
    return s


@nb.njit('void(f8[::1], f8[::1], i8, i8, i8, i8, i8, i8, i8, i8, f8)', cache=True, error_model='numpy')
def look_apart(H, W, v, w, now, flow, far, out, s, tip, ahead):
    """Water that comes out `ahead` seconds from now, into row `out`: every lane looks for its own slot."""
    for l in range(LANES):
        y = W[now + l] + ahead * W[flow + l] - W[far + l]
        own = seek(H, v + l, s, y, tip)
        r = (y - H[v + own * 2 * LANES + l]) * H[v + (own * 2 + 1) * LANES + l]
        at = w + own * 3 * LANES + l
        W[out + l] = H[at] + r * (H[at + LANES] + r * H[at + 2 * LANES])
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
        """Offset in H of flow g: per slot the volume at which it begins, and one over its width."""
        return 2 * g * SLOTS * self.lanes

    def _w(self, p: int) -> int:
        """Offset in H of delay p: per slot the coefficients of 1, r and r^2."""
        return (2 * len(self.flows) + 3 * p) * SLOTS * self.lanes

    def _volume(self, g: int, slot: str, part: int = 0) -> str:
        return f"H[{slot} * {2 * self.lanes} + {self._v(g) + part * self.lanes} + l]"

    def _water(self, p: int, slot: str, part: int = 0) -> str:
        return f"H[{slot} * {3 * self.lanes} + {self._w(p) + part * self.lanes} + l]"

    def head(self) -> list[str]:
        return [f"H = np.zeros({(2 * len(self.flows) + 3 * len(self.delays)) * SLOTS * self.lanes})"]

    def enter(self) -> list[str]:
        """Fill the lines: with what `past` holds, or with the water at rest."""
        k, rest, load = self.kernel, list[str](), list[str]()
        row = 0
        lines: list[str] = []
        for g in self.flows:
            rest += [f"{self._volume(g, 'e')} = (e - SLOTS + 1) * {NEVER!r}"]
            rest += [f"{self._volume(g, 'e', 1)} = {1.0 / NEVER!r}"]
            load += [f"{self._volume(g, 'e')} = past[b, {row} + e, l]"]
            width = f"past[b, {row} + after, l] - past[b, {row} + e, l]"
            load += [f"{self._volume(g, 'e', 1)} = 1.0 / max({width}, 1e-12)"]
            row += SLOTS
            lines += [f"since{g} = 0", f"if past.shape[0] > 0: since{g} = int(past[b, {row}, 0])"]
            lines += [f"tip{g} = SLOTS - 1", f"i{g} = SLOTS - 1 if since{g} == 0 else SLOTS - 2"]
            lines += [f"j{g} = (i{g} + 1) & (SLOTS - 1)"]
            row += 1
            for p, delay in enumerate(self.delays):
                if delay.line == g:
                    a, m = f"past[b, {row} + e, l]", f"past[b, {row + SLOTS} + e, l]"
                    values = (a, m, f"past[b, {row} + after, l] - {a} - {m}")
                    rest += [f"{self._water(p, 'e', n)} = {v}" for n, v in enumerate((delay.start, "0.0", "0.0"))]
                    load += [f"{self._water(p, 'e', n)} = {v}" for n, v in enumerate(values)]
                    row += 2 * SLOTS
                    lines.append(f"s{p} = SLOTS - 2")
        load = ["after = min(e + 1, SLOTS - 1)", *load]
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
        for p in range(len(self.delays)):
            fresh += self._look(p, "start", (("Ds", "0.0"),))
            out += self._look(p, "later", (("Dm", "h2"), ("De", "h")))
        return ["if fresh:", *_in(fresh), "    fresh = False", *out]

    def _look(self, p: int, name: str, targets: tuple[tuple[str, str], ...]) -> list[str]:
        """Look-ups of one delay: slots from lane 0, then one loop over lanes, or each lane for itself."""
        k, g = self.kernel, self.delays[p].line
        row = {n: k.row(n) * self.lanes for n in (f"v{g}", f"q{g}", f"far{p}")}
        lines, apart, body, slots = list[str](), list[str](), list[str](), list[str]()
        for n, (target, ahead) in enumerate(targets):
            y = f"W[{row[f'v{g}']}] + {ahead} * W[{row[f'q{g}']}] - W[{row[f'far{p}']}]"
            lines.append(f"s{p} = seek(H, {self._v(g)}, s{p}, {y}, tip{g})")
            slots.append(f"t{p}{n}")
            lines.append(f"t{p}{n} = s{p}")
            places = f"{self._v(g)}, {self._w(p)}, {row[f'v{g}']}, {row[f'q{g}']}, {row[f'far{p}']}"
            to = k.row(f"{target}{p}") * self.lanes
            apart.append(f"look_apart(H, W, {places}, {to}, s{p}, tip{g}, {ahead})")
            s = f"t{n}"
            parts = [self._water(p, s, part) for part in range(3)]
            body += [
                f"r = (v{g} + ahead{n} * q{g} - far{p} - {self._volume(g, s)}) * {self._volume(g, s, 1)}",
                f"W[{to} + l] = {parts[0]} + r * ({parts[1]} + r * {parts[2]})",
            ]
        # Few places in H to a function, and rows of W at literal offsets: more, and the compiler gives up proving
        # that they do not overlap.
        names = [f"t{n}" for n in range(len(targets))], [f"ahead{n}" for n in range(len(targets))]
        k.define(
            f"{name}{p}", "f8[::1], f8[::1]" + ", i8" * len(targets) + ", f8" * len(targets),
            ", ".join(["H", "W", *names[0], *names[1]]), [*map(_positive, names[0]), *k.loop(body)],
        )  # fmt: skip
        call = f"{name}{p}(H, W, {', '.join([*slots, *(ahead for _, ahead in targets)])})"
        return [*lines, f"if tight{g}:", f"    {call}", "else:", *_in(apart)]

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
        k, out = self.kernel, list[str]()
        for g in self.flows:
            body = [
                f"v{g} = v{g} + q{g} * h",
                f"{k.at(f'v{g}')} = v{g}",
                f"{self._volume(g, 'j')} = v{g}",
                f"{self._volume(g, 'i', 1)} = 1.0 / max(v{g} - {self._volume(g, 'i')}, 1e-12)",
            ]
            k.define(
                f"move{g}", "f8[::1], f8[::1], i8, i8, f8", "H, W, i, j, h", [*map(_positive, "ij"), *k.loop(body)]
            )
            out.append(f"move{g}(H, W, i{g}, j{g}, h)")
            for p, delay in enumerate(self.delays):
                if delay.line == g:
                    # A slot that one step fills keeps the slope at its start, any other is a straight line.
                    body = [
                        f"rise = wn{p} - {self._water(p, 'i')}",
                        f"slope = whole * ws{p} + (1.0 - whole) * rise",
                        f"{self._water(p, 'i', 1)} = slope",
                        f"{self._water(p, 'i', 2)} = rise - slope",
                        f"{self._water(p, 'j')} = wn{p}",
                    ]
                    k.define(
                        f"note{p}",
                        "f8[::1], f8[::1], i8, i8, f8",
                        "H, W, i, j, whole",
                        [*map(_positive, "ij"), *k.loop(body)],
                    )
                    out.append(f"note{p}(H, W, i{g}, j{g}, 1.0 if since{g} == 0 else 0.0)")
            volume = [f"H[{s}{g} * {2 * self.lanes} + {self._v(g)}]" for s in "ji"]
            out += [
                f"since{g} += 1",
                f"tip{g} = j{g}",
                f"if {volume[0]} - {volume[1]} >= closing{g}:",
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
            body.append(f"future[b, {row} + e, l] = {self._volume(g, slot)} - v{g}")
            extra.append(f"future[b, {row + SLOTS}, l] = since{g}")
            row += SLOTS + 1
            for p, delay in enumerate(self.delays):
                if delay.line == g:
                    body += [
                        f"future[b, {row} + e, l] = {self._water(p, slot)}",
                        f"future[b, {row + SLOTS} + e, l] = {self._water(p, slot, 1)}",
                    ]
                    row += 2 * SLOTS
        lines = ["if future.shape[0] > 0:", "    for e in range(SLOTS):", *_in(k.loop(body), 2)]
        return lines + _in(k.loop(extra))


def delay_lines(system: System, kernel: _Kernel) -> DelayLines:
    return DelayLines(system, kernel)


def _positive(slot: str) -> str:
    """Tells the compiler that an index is not negative: no wrapping round, so the loop over lanes has one stride."""
    return f"{slot} = {slot} & (SLOTS - 1)"


def _in(lines: list[str], depth: int = 1) -> list[str]:
    return ["    " * depth + line for line in lines]
