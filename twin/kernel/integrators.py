"""Source text of one substep: a Taylor series for networks that are affine in the temperatures, else Runge-Kutta; a
linearly implicit method where samples are far apart against the fastest volume.

The inputs are constant in a substep, so x' = A x + b(t) with b constant or, behind pipes, quadratic in time. The terms

    e_1 = h f(x, Ds),   e_2 = h/2 (A e_1 + E Da),   e_3 = h/3 (A e_2 + E Db),   e_i = h/i A e_(i-1)

sum up to the exact solution; outlets of delays are Ds + Da r + Db r^2 at the share r of the step. A large network runs
its terms beyond the third in a loop, in pairs, and as many as the stiffest lane needs.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

from twin.kernel.delays import DelayLines
from twin.kernel.source_text import KernelText, renamed
from twin.network.affine import ONE, ZERO, AffineForm, add, multiply, names_in
from twin.network.assembly import FEW_STATES, NetworkEquations

ORDER, STEP_LIMIT = 5, 0.2
"""Order of the series of a small network, and the largest step * rate for it; also the limit for Runge-Kutta."""
STABLE, DECAYED = 2.0, 24.0
"""Largest step * (norm of the rates) of the same, with a margin to 2.78, and the substeps beyond which it counts."""
MOST_STEPS = 1.0e6
"""Largest number of substeps in one sample interval."""
IMPLICIT_STEPS = 16.0
"""Substeps of the linearly implicit method: of a mode of any speed, at most 2.2e-4 of a jump is left at the end of the
interval beyond the exact share (maximum over z < 0 of |R(z / N)^N - exp z|)."""
REST_LIMIT = 2.0
"""Largest substep * (declared bound on the rate of what is not affine). The first stage then overshoots what a linear
law would end at by at most a quarter, 2 / (1 + 2 gamma); without a limit it is by 1 / gamma, too far for a fourth
power."""
APART_K = 0.01
"""Difference of temperature, K, over which a slope is taken: small against those over which a law bends."""
GAMMA = 1.0 - 0.5**0.5
"""Coefficient with which ROS2 is L-stable and its errors are least."""
PAIRS = ((0.3, 1), (0.67, 2), (1.14, 3), (1.67, 4))
"""Step * rate -> pairs of terms beyond the third, for a large network."""


class Integrator:
    """Lines of the substeps of one kernel.

    An error decays like the mode that it is of, while the inputs are constant. Of a mode that decays by exp(-x) in a
    sample interval, N steps of order p leave the share x^(p + 1) exp(-x) / ((p + 1)! N^p) of a jump at its end. For
    p = 4 that is at most 0.175 / N^4, however fast the mode is: with N = `DECAYED` below a millionth. More steps are
    needed for stability alone, which both methods keep up to a step of 2.78 over the spectral radius (Hairer & Wanner,
    Solving ODEs II, sec. IV.2). What comes out of a delay is not constant in an interval, so networks with delays keep
    `STEP_LIMIT`.

    Attributes
    ----------
    limit
        Largest substep * (bound on a state's own rate).
    stable
        Largest substep * (norm of the rates) in an interval of more than `DECAYED` substeps.
    paired
        True if terms run in a loop.
    """

    def __init__(self, system: NetworkEquations, text: KernelText, delays: DelayLines | None) -> None:
        self.system, self.text, self.delays = system, text, delays
        self.count = len(self.system.states)
        self.paired = self.system.linear and self.count > FEW_STATES
        self.limit = PAIRS[-1][0] if self.paired else STEP_LIMIT
        self.stable = self.limit if self.paired or delays else STABLE
        self.constants = list(dict.fromkeys(f.constant for f in self.system.lag_terms))
        if self.paired:
            for j in range(self.count):
                text.row(f"e{j}")
                text.row(f"n{j}")
                text.row(f"m{j}")

    @property
    def bounds(self) -> tuple[tuple[tuple[str, str], ...], tuple[str, ...]] | None:
        """Return names with expressions, and in these rates whose largest, `norm_of_all`, bounds steps; or None."""
        return self.system.norm if self.stable > self.limit else None

    @property
    def cut(self) -> list[str]:
        """Return the line that shortens an interval of too many substeps.

        Its inputs have then been constant for so many time constants that more of the same changes nothing. Without the
        cut a gap of months would take minutes.
        """
        return ["dt = min(dt, LONGEST / limit)"]

    @property
    def steps(self) -> str:
        """Return the expression of the substeps that an interval needs, not rounded."""
        return "dt * limit * PER_STEP" if self.bounds is None else "substeps(dt * limit, dt * norm_of_all)"

    def factorise(self) -> list[str]:
        """Return the lines that prepare a step after all coefficients are renewed; none for explicit methods."""
        return []

    def refresh(self) -> list[str]:
        """Return the weights of the lags for the step: the response of a lag to a quadratic in time is known in
        closed form.
        """
        k, body = self.text, list[str]()
        for g, constant in enumerate(self.constants):
            lane = bool(names_in(constant) & k.rows.keys())
            lines = [
                f"ratio = ({constant}) / max(h, 1e-12)",
                f"decay{g} = exp(-1.0 / max(ratio, 1e-12))",
                f"hold{g} = ratio * (1.0 - decay{g})",
                f"bend{g} = 2.0 * ratio * (hold{g} - 1.0)",
            ]
            if lane:
                names = [f"{n}{g}" for n in ("decay", "hold", "bend")]
                for name in names:
                    k.row(name)
                body += k.loop([*lines, *(f"{k.at(name)} = {name}" for name in names)])
            else:
                body += lines
        return body

    def substep(self) -> list[str]:
        """Return the lines, loops over lanes included, that take the state from the start x to the end n of a step
        of h.
        """
        k, delays, count = self.text, self.delays, range(self.count)
        outlets = delays.outlets() if delays else []
        end = [*self._lags(), *self._waters(), *self._store("x", "n")]
        if self.paired:
            begin = [*self._first_terms(), *self._sums(["e1_", "e2_", "e3_"]), *self._store("e", "e3_")]
            begin += [*self._store("n", "n"), *self._store("m", "m")]
            more = [*self._term(self._names("e"), "a_", "ha"), *self._term(self._names("a_"), "b_", "hb")]
            more += [*self._store("e", "b_"), *(f"{k.at(f'n{j}')} = n{j} + a_{j} + b_{j}" for j in count)]
            more += [f"{k.at(f'm{j}')} = m{j} + qa * a_{j} + qb * b_{j}" for j in count]
            pair = ["ha, hb = h / (2.0 * pair + 4.0), h / (2.0 * pair + 5.0)"]
            pair += ["qa, qb = 1.0 / (2.0 * pair + 5.0), 1.0 / (2.0 * pair + 6.0)"]
            pair += k.outlined("two_terms", more, always=True)
            lines = [*k.outlined("begin_step", begin, always=True), "for pair in range(pairs):"]
            lines += [f"    {line}" for line in pair]
            return lines + k.outlined("end_step", [*outlets, *end], always=True)
        if not self.system.linear:
            lines = [*outlets, *self._runge_kutta()]
        elif delays:
            lines = [*outlets, *self._first_terms()]
            for i in range(4, ORDER + 1):
                lines += self._term(self._names(f"e{i - 1}_"), f"e{i}_", f"h{i}")
            lines += self._sums([f"e{i}_" for i in range(1, ORDER + 1)])
        else:
            lines = self._horner()
        return k.outlined("advance", [*lines, *end])

    def _names(self, letter: str) -> list[str]:
        return [f"{letter}{j}" for j in range(self.count)]

    def _store(self, row: str, name: str) -> list[str]:
        return [f"{self.text.at(f'{row}{j}')} = {name}{j}" for j in range(self.count)]

    def _sums(self, terms: list[str]) -> list[str]:
        """Return the series n and its mean m over the step."""
        lines = []
        for j in range(self.count):
            lines.append(f"n{j} = " + " + ".join([f"x{j}", *(f"{t}{j}" for t in terms)]))
            shares = (f"{t}{j} * {1.0 / (i + 2)!r}" for i, t in enumerate(terms))
            lines.append(f"m{j} = " + " + ".join([f"x{j}", *shares]))
        return lines

    def _three(self, forms: list[AffineForm], suffix: str) -> tuple[list[str], list[tuple[str, str, str]]]:
        """Return lines, and per form its values at the start and the end of the step and its mean."""
        lines: list[str] = []
        found = []
        if forms and self.delays:
            lines += [f"Dq{p} = Ds{p} + 0.5 * Da{p} + {1.0 / 3.0!r} * Db{p}" for p in range(len(self.system.delays))]
        for y, outlets, tail in (("x", "Ds", "b"), ("n", "De", "n"), ("m", "Dq", "m")):
            names, more = self._chained(self._names(y), outlets, f"_{suffix}{tail}", forms)
            lines += more
            found.append([renamed(form.text(), names) for form in forms])
        return lines, list(zip(*found, strict=True))

    def _lags(self) -> list[str]:
        """Return the lines of the lags, which follow the quadratic through start and end that has the right mean."""
        k = self.text
        lines, values = self._three([f.of for f in self.system.lag_terms], "l")
        for j, ((start, end, mean), f) in enumerate(zip(values, self.system.lag_terms, strict=True)):
            g = self.constants.index(f.constant)
            lines += [
                f"t0 = {start}",
                f"t1 = ({end}) - t0",
                f"t2 = 6.0 * (({mean}) - t0) - 2.0 * t1",
                f"f{j} = t0 + t1 + bend{g} * (t1 - t2) - hold{g} * t2 + decay{g} * (f{j} - t0)",
                f"{k.at(f'f{j}')} = f{j}",
            ]
        return lines

    def _waters(self) -> list[str]:
        """Return the lines of the water that enters delays: at the start, slope over the step, at the end."""
        k = self.text
        lines, values = self._three(list(self.system.inlet_forms), "w")
        for p, (start, end, mean) in enumerate(values):
            lines += [
                f"wb{p} = {start}",
                f"wn{p} = {end}",
                f"{k.at(f'ws{p}')} = 6.0 * ({mean}) - 4.0 * wb{p} - 2.0 * wn{p}",
                f"{k.at(f'wb{p}')} = wb{p}",
                f"{k.at(f'wn{p}')} = wn{p}",
            ]
        return lines

    def _chained(
        self, y: list[str], outlets: str, suffix: str, forms: Iterable[AffineForm], offsets: bool = True
    ) -> tuple[dict[str, str], list[str]]:
        """Return names of all that the forms need at temperatures `y`, and lines for the locals among it."""
        system = self.system
        names = {f"x{j}": y[j] for j in range(self.count)}
        names |= {f"D{p}": f"{outlets}{p}" if outlets else ZERO for p in range(len(system.delays))}
        wanted = set().union(*(form.slopes.keys() for form in forms))
        for name, form in reversed(system.chain.items()):
            if name in wanted:
                wanted |= form.slopes.keys()
        lines = []
        for name, form in system.chain.items():
            if name in wanted:
                names[name] = f"{name}{suffix}"
                lines.append(f"{names[name]} = {self._expression(form, names, offsets)}")
        return names, lines

    def _expression(self, form: AffineForm, names: Mapping[str, str], offsets: bool) -> str:
        slopes = {v: t for v, t in form.slopes.items() if names[v] != ZERO}
        return renamed(AffineForm(slopes, form.offset if offsets else ZERO).text(), names)

    def _rates(self, y: list[str], outlets: str, stage: str, offsets: bool = True) -> list[str]:
        """Return the rates k0, k1, .. of a stage at temperatures `y`, with delay outlets named `outlets` + index."""
        system = self.system
        names, lines = self._chained(y, outlets, f"_{stage}", [form for form, _ in system.slopes], offsets)
        staged = {name: f"{name}_{stage}" for name in system.nonaffine_locals}
        lines += [f"{staged[n]} = {renamed(t, {**names, **staged})}" for n, t in system.nonaffine_locals.items()]
        for j, (form, rest) in enumerate(system.slopes):
            text = self._expression(form, names, offsets)
            if rest != ZERO:
                text = add(text, renamed(rest, {**names, **staged}))
            lines.append(f"k{j}{stage} = {text}")
        return lines

    def _term(self, y: list[str], to: str, step: str, outlets: str = "", offsets: bool = False) -> list[str]:
        """Return one term of the series from the one before."""
        lines = self._rates(y, outlets, to, offsets)
        return lines + [f"{to}{j} = {step} * k{j}{to}" for j in range(self.count)]

    def _first_terms(self) -> list[str]:
        lines = self._term(self._names("x"), "e1_", "h", "Ds", offsets=True)
        lines += self._term(self._names("e1_"), "e2_", "h2", "Da")
        return lines + self._term(self._names("e2_"), "e3_", "h3", "Db")

    def _horner(self) -> list[str]:
        """Return the Taylor series for a right-hand side that is constant in the step, as Horner's scheme of exp.

        x_i = x + h/(s + 1 - i) f(x_(i-1)), i = 1 .. s, of order s.
        """
        k, y, lines = range(self.count), self._names("x"), list[str]()
        for i in range(ORDER, 0, -1):
            last = i == 1
            lines += self._rates(y, "D", f"s{i}")
            if i == ORDER and self.system.lag_terms:
                lines += [f"e{j} = h * k{j}s{i}" for j in k]
            y = [f"n{j}" if last else f"y{j}s{i}" for j in k]
            lines += [f"{y[j]} = x{j} + {'h' if last else f'h{i}'} * k{j}s{i}" for j in k]
        if self.system.lag_terms:
            lines += [f"m{j} = {1.0 / 3.0!r} * (2.0 * x{j} + n{j}) + {1.0 / 6.0!r} * e{j}" for j in k]
        return lines

    def _runge_kutta(self) -> list[str]:
        """Return the classical fourth-order method (Runge-Kutta)."""
        k, x = range(self.count), self._names("x")
        lines = self._rates(x, "Ds", "a")
        stages = (("a", "b", "h2", "Dm"), ("b", "c", "h2", "Dm"), ("c", "d", "h", "De"))
        for last, here, share, outlets in stages:
            lines += [f"y{j}{here} = x{j} + {share} * k{j}{last}" for j in k]
            lines += self._rates([f"y{j}{here}" for j in k], outlets, here)
        lines += [f"n{j} = x{j} + h6 * (k{j}a + 2.0 * (k{j}b + k{j}c) + k{j}d)" for j in k]
        return lines + [f"m{j} = x{j} + h6 * (k{j}a + k{j}b + k{j}c)" for j in k]


class LinearlyImplicit(Integrator):
    """Lines of the substeps of a kernel of a stiff network, in which the fastest volume no longer sets the step.

    The second-order Rosenbrock method ROS2 in the form of a W-method: its order holds for any matrix J in place of the
    Jacobian, and it is L-stable with the exact one (Verwer, Spee, Blom and Hundsdorfer, SIAM J. Sci. Comput. 20 (1999)
    1456, with Steihaug and Wolfbrandt, Math. Comp. 33 (1979) 521):

        (I - gamma h J) k1 = f(x),   (I - gamma h J) k2 = f(x + h k1) - 2 k1,   n = x + h (3/2 k1 + 1/2 k2)

    J is the matrix of what is affine in the temperatures; of the rest it has the slope of each state's rate by the
    state itself. It is factorised without pivots, with the fill-in that the network's structure makes: in each step, or
    for affine networks when a coefficient in it changes. The substeps of an interval are `IMPLICIT_STEPS`, so that
    readings are smooth in the parameters, or more where what is not affine is fast itself.
    """

    def __init__(self, system: NetworkEquations, text: KernelText, delays: DelayLines | None) -> None:
        super().__init__(system, text, delays)
        self.paired, self.limit = False, STEP_LIMIT
        self.stable = self.limit

    @property
    def bounds(self) -> tuple[tuple[tuple[str, str], ...], tuple[str, ...]] | None:
        """Return the declared bounds on the rates of what is not affine, or None."""
        rest = (self.system.rest_bound(j) for j, (_, rest) in enumerate(self.system.slopes) if rest != ZERO)
        return None if self.system.linear else ((), tuple(dict.fromkeys(rest)))

    @property
    def cut(self) -> list[str]:
        """Return the line that shortens an interval of too many substeps; none of an affine network is too long."""
        longest = f"{MOST_STEPS * REST_LIMIT!r} / max(norm_of_all, 1e-30)"
        return [] if self.system.linear else [f"dt = min(dt, {longest})"]

    @property
    def steps(self) -> str:
        """Return the expression of the substeps that an interval needs, not rounded."""
        if self.bounds is None:
            return repr(IMPLICIT_STEPS)
        return f"max({IMPLICIT_STEPS}, dt * norm_of_all * {1.0 / REST_LIMIT!r})"

    def factorise(self) -> list[str]:
        """Return the lines that prepare a step: the factors of an affine network."""
        lines = [f"gh = {GAMMA!r} * h"]
        return [*lines, *self.text.outlined("factorise", self._factors())] if self.system.linear else lines

    def _factors(self) -> list[str]:
        """Return the lines that factorise I - gamma h J, into rows of their own."""
        lines, entries = self._matrix()
        k = self.text
        names = {(i, j): f"lu{i}_{j}" for i, j in entries}
        lines += [
            f"{names[i, j]} = {'1.0 - ' if i == j else '-'}gh * ({text})" for (i, j), text in sorted(entries.items())
        ]
        self._order, self._filled = _elimination(self.count, set(entries))
        done: set[int] = set()
        for p in self._order:
            done.add(p)
            lines.append(f"inverse{p} = 1.0 / {names[p, p]}")
            lines.append(f"{k.at(f'inverse{p}')} = inverse{p}")
            row = [j for j in range(self.count) if j not in done and (p, j) in self._filled]
            for i in (i for i in range(self.count) if i not in done and (i, p) in self._filled):
                lines.append(f"lu{i}_{p} = {names[i, p]} * inverse{p}")
                lines.append(f"{k.at(f'lu{i}_{p}')} = lu{i}_{p}")
                for j in row:
                    before = f"{names[i, j]} - " if (i, j) in names else "-"
                    names[i, j] = f"lu{i}_{j}"
                    lines.append(f"lu{i}_{j} = {before}lu{i}_{p} * {names[p, j]}")
            lines += [f"{k.at(f'lu{p}_{j}')} = {names[p, j]}" for j in row]
        return lines

    def substep(self) -> list[str]:
        """Return the lines, loops over lanes included, that take the state from the start x to the end n of a step
        of h.
        """
        k = range(self.count)
        lines = [] if self.system.linear else self._factors()
        lines += self.delays.outlets() if self.delays else []
        lines += self._rates(self._names("x"), "Ds", "a")
        lines += [f"ra{j} = k{j}a" for j in k] + self._solved("ra")
        lines += [f"y{j}b = x{j} + h * ra{j}" for j in k]
        lines += self._rates([f"y{j}b" for j in k], "De", "b")
        lines += [f"rb{j} = k{j}b - 2.0 * ra{j}" for j in k] + self._solved("rb")
        lines += [f"n{j} = x{j} + h * (1.5 * ra{j} + 0.5 * rb{j})" for j in k]
        lines += [f"m{j} = 0.5 * (x{j} + n{j})" for j in k]
        return self.text.outlined("advance", [*lines, *self._lags(), *self._waters(), *self._store("x", "n")])

    def _matrix(self) -> tuple[list[str], dict[tuple[int, int], str]]:
        """Return lines, and the entries of J that are not always 0, with all on the diagonal."""
        system, lines = self.system, self._own_slopes()
        entries: dict[tuple[int, int], str] = {}
        for j in range(self.count):
            known = {f"x{j}": ONE}
            for name, form in system.chain.items():
                text = _derivative(form, known)
                if text != ZERO:
                    known[name] = f"{name}_d{j}"
                    lines.append(f"{known[name]} = {text}")
            for i, (form, rest) in enumerate(system.slopes):
                text = _derivative(form, known)
                if i == j and rest != ZERO:
                    text = add(text, f"min(own{j}, 0.0)")
                if text != ZERO or i == j:
                    entries[i, j] = text
        return lines, entries

    def _own_slopes(self) -> list[str]:
        """Return the lines with the derivative of what is not affine in each state's rate by the state itself.

        Water behind a delay, which does not depend on the state, counts as 0 degC: the order holds for any slope.
        """
        rest = {j: text for j, (_, text) in enumerate(self.system.slopes) if text != ZERO}
        lines = list[str]()
        for j in (None, *rest) if rest else ():
            stage = "at_x" if j is None else f"at_{j}"
            names = {f"x{k}": f"(x{k} + {APART_K})" if k == j else f"x{k}" for k in range(self.count)}
            names |= {f"D{p}": ZERO for p in range(len(self.system.delays))}
            staged = {name: f"{name}_{stage}" for name in self.system.nonaffine_locals}
            known = {**names, **staged}
            lines += [f"{staged[n]} = {renamed(t, known)}" for n, t in self.system.nonaffine_locals.items()]
            if j is None:
                lines += [f"rest{k} = {renamed(text, known)}" for k, text in rest.items()]
            else:
                lines.append(f"own{j} = ({renamed(rest[j], known)} - rest{j}) * {1.0 / APART_K!r}")
        return lines

    def _solved(self, name: str) -> list[str]:
        """Return the lines that solve the factorised system for the right side in the names `name` + index."""
        lines, done = list[str](), set[int]()
        for p in self._order:
            done.add(p)
            later = (i for i in range(self.count) if i not in done and (i, p) in self._filled)
            lines += [f"{name}{i} = {name}{i} - lu{i}_{p} * {name}{p}" for i in later]
        for p in reversed(self._order):
            beyond = (j for j in range(self.count) if j not in done and (p, j) in self._filled)
            known = "".join(f" - lu{p}_{j} * {name}{j}" for j in beyond)
            done.discard(p)
            lines.append(f"{name}{p} = ({name}{p}{known}) * inverse{p}")
        return lines


def _derivative(form: AffineForm, known: Mapping[str, str]) -> str:
    """Return the derivative of a form by a variable, whose derivatives of the form's variables are known or 0."""
    total = ZERO
    for name, slope in form.slopes.items():
        if name in known:
            total = add(total, multiply(slope, known[name]))
    return total


def _elimination(count: int, entries: set[tuple[int, int]]) -> tuple[list[int], set[tuple[int, int]]]:
    """Return an order of elimination with little fill-in (Markowitz), and the entries (row, column) with it."""
    filled, left, order = set(entries), set(range(count)), list[int]()
    while left:
        inner = [(i, j) for i, j in filled if i != j and i in left and j in left]
        rows, columns = Counter(i for i, _ in inner), Counter(j for _, j in inner)
        _, p = min((rows[k] * columns[k], k) for k in left)
        left.discard(p)
        order.append(p)
        filled |= {(i, j) for i in left for j in left if (i, p) in filled and (p, j) in filled}
    return order, filled
