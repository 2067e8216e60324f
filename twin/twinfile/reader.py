"""Reader of a twin file's tables: every error is one plain sentence with its line."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, replace
from typing import Any, NoReturn

from twin.column_names import contradicted_unit, suffix_of, unit_other_than
from twin.elements import KINDS, Element, Parameter, ParameterSpec
from twin.elements.base import STATUSES
from twin.network import (
    InputSpec,
    Network,
    Revision,
    TunableSet,
    TwinFileError,
    WindowRules,
    check_topology,
    did_you_mean,
    digest,
    frozen_mapping,
)
from twin.network.assembly import NetworkEquations
from twin.twinfile.identifiers import LONGEST_SHOWN, name_problem

TOP = ("format", "name", "title", "inputs", "elements", "sets", "windows", "revision")
FORMAT = 1
MOST_NODES = 32


@dataclass(frozen=True)
class TwinReader:
    """A reader of the parsed tables of a twin file, `file`; its `text` locates the line of a mistake."""

    text: str
    file: str

    def fail(self, keys: tuple[str, ...], sentence: str) -> NoReturn:
        """Raise TwinFileError with file, line and key."""
        line = _line_of(self.text, keys)
        where = f"{self.file}, line {line}" if line else self.file
        path = ".".join(key if not name_problem(key) else repr(key[:LONGEST_SHOWN]) for key in keys)
        raise TwinFileError(f"{where}: {path}: {sentence}" if keys else f"{where}: {sentence}")

    def known(self, table: Mapping[str, Any], allowed: Iterable[str], keys: tuple[str, ...]) -> None:
        """Check that a table has no other keys than the allowed ones."""
        allowed = tuple(allowed)
        for key in table:
            if key not in allowed:
                hint = did_you_mean(key, allowed) or f"; known keys: {', '.join(allowed)}"
                self.fail((*keys, key), f"unknown key{hint}")

    def name(self, name: str, keys: tuple[str, ...]) -> str:
        """Return the name, which must be a plain identifier."""
        reason = name_problem(name)
        if reason:
            self.fail(keys, reason)
        return name

    def table(self, value: Any, keys: tuple[str, ...]) -> dict[str, Any]:
        """Return a value that must be a table."""
        if not isinstance(value, dict):
            self.fail(keys, "must be a table")
        return value

    def number(self, value: Any, keys: tuple[str, ...]) -> float:
        """Return a value that must be a finite number."""
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        try:
            found = float(value) if is_number else math.nan
        except OverflowError:
            self.fail(keys, "must be a finite number, and has too many digits")
        if not math.isfinite(found):
            self.fail(keys, f"must be a finite number, not {value!r}")
        return found

    def string(self, value: Any, keys: tuple[str, ...]) -> str:
        """Return a value that must be text."""
        if not isinstance(value, str):
            self.fail(keys, f"must be text in quotes, not {value!r}")
        return value

    def pair(self, value: Any, keys: tuple[str, ...]) -> tuple[float, float]:
        """Return a value that must be a list of two rising numbers."""
        if not isinstance(value, list) or len(value) != 2:
            self.fail(keys, "must be a list of two numbers, [lower, upper]")
        low, high = (self.number(v, keys) for v in value)
        if not low < high:
            self.fail(keys, f"the first number must be below the second, got [{low:g}, {high:g}]")
        return low, high

    def network(self, data: dict[str, Any]) -> Network:
        """Return the network.

        Raises
        ------
        TwinFileError
            The tables are not a network; the message names file, line and remedy.
        """
        self.known(data, TOP, ())
        if data.get("format") != FORMAT:
            self.fail(("format",), f"must be {FORMAT}, got {data.get('format')!r}; this is the format of the file")
        for key in ("name", "inputs", "elements"):
            if key not in data:
                self.fail((), f"the key {key!r} is missing; add it")
        inputs = {column: self.input(column, spec) for column, spec in self.table(data["inputs"], ("inputs",)).items()}
        parameters: dict[str, Parameter] = {}
        elements: list[Element] = []
        for name, spec in self.table(data["elements"], ("elements",)).items():
            element, own = self.element(name, self.table(spec, ("elements", name)), inputs)
            elements.append(element)
            parameters.update({p.id: p for p in own})
        elements.sort(key=lambda e: e.kind != "node")
        parameters = self.share({p.id: p for e in elements for p in parameters.values() if p.element == e.name})
        check_topology(
            tuple(elements), MOST_NODES, lambda name, what: self.fail(("elements", name)[: 1 + bool(name)], what)
        )
        sets = {
            name: self.tunable_set(name, self.table(spec, ("sets", name)), parameters)
            for name, spec in self.table(data.get("sets", {}), ("sets",)).items()
        }
        network = Network(
            name=self.string(data["name"], ("name",)),
            title=self.string(data.get("title", ""), ("title",)),
            elements=tuple(elements),
            parameters=frozen_mapping(parameters),
            inputs=frozen_mapping(inputs),
            sets=frozen_mapping(sets),
            rules=self.windows(self.table(data.get("windows", {}), ("windows",))),
            revision=self.revision(self.table(data.get("revision", {}), ("revision",))),
            digest=digest(self.text),
        )
        try:
            assert NetworkEquations(network, network.ids).slopes
        except ValueError as error:
            self.fail((), f"the elements do not fit together: {error}")
        self.meters(network)
        return network

    def meters(self, network: Network) -> None:
        """Check that every meter reads a quantity that there is, in a unit of its kind."""
        parts = dict(NetworkEquations(network, network.ids).parts) if network.meters else {}
        for meter in network.meters:
            keys = ("elements", meter.name)
            if meter.of not in parts:
                self.fail((*keys, "of"), f"no such element {meter.of!r}{did_you_mean(meter.of, parts)}")
            exports = parts[meter.of].exports
            if meter.quantity not in exports:
                others = ", ".join(exports) or "no quantity that a meter reads"
                self.fail((*keys, "quantity"), f"{meter.of} has no {meter.quantity}; it has {others}")
            unit = exports[meter.quantity].unit
            if meter.factor(unit) is None:
                self.fail(
                    (*keys, "columns"),
                    f"{meter.measured[0]} is in {meter.unit} and the {meter.quantity} of {meter.of} in {unit}; read a "
                    f"column of that unit",
                )

    def input(self, column: str, spec: Any) -> InputSpec:
        """Read one input column."""
        keys = ("inputs", self.name(column, ("inputs", column)))
        table = self.table(spec, keys)
        self.known(table, ("nominal", "lower", "upper", "unit", "source"), keys)
        values = {}
        for key, default in (("nominal", None), ("lower", -math.inf), ("upper", math.inf)):
            if key in table:
                values[key] = self.number(table[key], (*keys, key))
            elif default is None:
                self.fail(keys, "nominal is missing; give the value to assume until the first good sample")
            else:
                values[key] = default
        if not values["lower"] <= values["nominal"] <= values["upper"]:
            self.fail(keys, f"nominal {values['nominal']:g} is outside [{values['lower']:g}, {values['upper']:g}]")
        unit = self.string(table.get("unit", ""), (*keys, "unit"))
        named = contradicted_unit(column, unit)
        if named is not None:
            self.fail(
                keys,
                f"unit {unit!r} contradicts the name, which means {named}; convert nominal and bounds to {named}, or "
                "name the column after its unit",
            )
        return InputSpec(column=column, unit=unit, source=str(table.get("source", "")), **values)

    def element(
        self, name: str, table: dict[str, Any], inputs: Mapping[str, InputSpec]
    ) -> tuple[Element, list[Parameter]]:
        """Read one element and its parameters."""
        keys = ("elements", name)
        self.name(name, keys)
        kind = table.get("kind")
        if not isinstance(kind, str) or kind not in KINDS:
            hint = did_you_mean(str(kind), KINDS) or f"; known kinds: {', '.join(sorted(KINDS))}"
            self.fail((*keys, "kind") if kind is not None else keys, f"unknown kind {kind!r}{hint}")
        cls = KINDS[kind]
        fields: dict[str, Any] = {}
        for key, field in cls.places().items():
            if key in table:
                fields[field.name] = self.place(table[key], field.metadata, (*keys, key), inputs)
            elif not _has_default(field):
                self.fail(keys, f"{key} is missing; give {field.metadata['about']}")
            elif field.metadata["role"] == "input" and field.default and field.default not in inputs:
                self.fail(keys, f"needs the input {field.default!r}; declare it under inputs or set {key}")
        element = cls(name=name, **fields)
        self.units(element, keys, inputs)
        specs = {spec.name: spec for spec in element.parameter_specs()}
        self.known(table, ("kind", *cls.places(), *specs), keys)
        own = [self.parameter(element, spec, table.get(spec.name), keys) for spec in specs.values()]
        problem = element.problem({p.name: p.value for p in own})
        if problem:
            self.fail(keys, problem)
        for column in element.inputs():
            if column not in inputs:
                self.fail(keys, f"needs the input {column!r}; declare it under inputs")
        return element, own

    def units(self, element: Element, keys: tuple[str, ...], inputs: Mapping[str, InputSpec]) -> None:
        """Check that an element's input columns are in the units in which it reads them."""
        for key, field in element.places().items():
            column, wanted = str(getattr(element, field.name)), field.metadata.get("unit", "")
            if not wanted or column not in inputs:
                continue
            other = unit_other_than(column, inputs[column].unit, wanted)
            if other is not None:
                suffix = suffix_of(wanted)
                self.fail(
                    (*keys, key),
                    f"{column!r} is in {other}, and {key} is read in {wanted}; convert the column to {wanted}, and end "
                    f"its name in _{suffix}",
                )

    def place(
        self, value: Any, meta: Mapping[str, Any], keys: tuple[str, ...], inputs: Mapping[str, InputSpec]
    ) -> str | tuple[str, ...]:
        """Read one place of an element: a node, an input column or a choice."""
        if meta["role"] in ("nodes", "columns"):
            if not isinstance(value, list) or not value or not all(isinstance(v, str) for v in value):
                self.fail(keys, f"must be a list of names: {meta['about']}")
            return tuple(self.name(v, keys) for v in value)
        text = self.string(value, keys)
        if meta["role"] == "input" and text not in inputs:
            hint = did_you_mean(text, inputs) or "; declare it under inputs"
            self.fail(keys, f"no such input {text!r}{hint}")
        if meta["role"] == "element":
            self.name(text, keys)
        if meta["role"] == "choice" and text not in meta["choices"]:
            self.fail(keys, f"{text!r} is not one of {', '.join(meta['choices'])}")
        return text

    def parameter(self, element: Element, spec: ParameterSpec, given: Any, keys: tuple[str, ...]) -> Parameter:
        """Read one parameter of an element."""
        keys = (*keys, spec.name)
        table = given if isinstance(given, dict) else {} if given is None else {"value": given}
        if "same_as" in table:
            return self.shared(element, spec, table, keys)
        self.known(table, ("value", "lower", "upper", "unit", "status", "source"), keys)
        if "value" in table:
            value = self.number(table["value"], keys)
        elif spec.default is not None:
            value = spec.default
        else:
            self.fail(keys[:-1], f"{spec.name} is missing; give a value in {spec.unit}")
        unit = self.string(table.get("unit", spec.unit), keys)
        if unit != spec.unit:
            self.fail(keys, f"unit {unit!r} is not {spec.unit!r}; convert the value")
        lower = self.number(table.get("lower", spec.lower), keys)
        upper = self.number(table.get("upper", spec.upper), keys)
        if lower < spec.lower or upper > spec.upper or lower > upper:
            self.fail(
                keys,
                f"bounds [{lower:g}, {upper:g}] {unit} must lie in order inside [{spec.lower:g}, {spec.upper:g}]",
            )
        if not lower <= value <= upper:
            self.fail(keys, f"{value:g} {unit} is outside its bounds [{lower:g}, {upper:g}]; correct one of them")
        status = table.get("status", spec.status)
        if status not in STATUSES:
            self.fail(keys, f"status {status!r} is not one of {', '.join(STATUSES)}")
        return Parameter(
            id=f"{element.name}.{spec.name}",
            element=element.name,
            name=spec.name,
            value=value,
            unit=unit,
            lower=lower,
            upper=upper,
            status=status,
            source=self.string(table.get("source", spec.source), keys),
        )

    def shared(self, element: Element, spec: ParameterSpec, table: dict[str, Any], keys: tuple[str, ...]) -> Parameter:
        """Read a parameter that is the same as another; `share` fills in the other's value."""
        self.known(table, ("same_as", "unit"), keys)
        other = self.string(table["same_as"], keys)
        name, value = f"{element.name}.{spec.name}", spec.default if spec.default is not None else spec.upper
        return Parameter(
            name, element.name, spec.name, value, spec.unit, spec.lower, spec.upper, "fixed", f"same as {other}", other
        )

    def share(self, parameters: dict[str, Parameter]) -> dict[str, Parameter]:
        """Return the parameters with the values of those that they share."""
        for p in parameters.values():
            if not p.same_as:
                continue
            keys = ("elements", p.element, p.name)
            root = parameters.get(p.same_as)
            if root is None:
                self.fail(keys, f"no parameter {p.same_as!r}{did_you_mean(p.same_as, parameters)}")
            if root.same_as or root.unit != p.unit:
                self.fail(keys, f"{p.same_as} must have a value of its own, in {p.unit}")
            parameters[p.id] = replace(p, value=root.value, lower=root.lower, upper=root.upper)
        return parameters

    def tunable_set(self, name: str, table: dict[str, Any], parameters: Mapping[str, Parameter]) -> TunableSet:
        """Read one set of tunables."""
        keys = ("sets", self.name(name, ("sets", name)))
        self.known(table, ("members", "bounds", "source"), keys)
        members = table.get("members")
        if not isinstance(members, list) or not members:
            self.fail(keys, "members is missing; list the parameters of the set")
        ids: list[str] = []
        scale: list[float] = []
        initial: list[tuple[float, float]] = []
        for member in members:
            entry = {"parameter": member} if isinstance(member, str) else self.table(member, keys)
            self.known(entry, ("parameter", "scale", "initial"), keys)
            wanted = entry.get("parameter")
            if not isinstance(wanted, str) or wanted not in parameters:
                self.fail(keys, f"no parameter {wanted!r}{did_you_mean(str(wanted), parameters)}")
            if wanted in ids:
                self.fail(keys, f"{wanted} is listed twice")
            p = parameters[wanted]
            if p.same_as:
                self.fail(keys, f"{wanted} is the same as {p.same_as}; list that one")
            ids.append(wanted)
            scale.append(self.number(entry.get("scale", 1.0), keys))
            if scale[-1] <= 0.0:
                self.fail(keys, f"scale of {wanted} must be positive")
            default = [p.lower / scale[-1], p.upper / scale[-1]]
            initial.append(self.pair(entry.get("initial", default), keys))
        bounds = self.pair(table["bounds"], keys) if "bounds" in table else None
        source = self.string(table.get("source", ""), keys)
        return TunableSet(name, tuple(ids), tuple(scale), tuple(initial), bounds, source)

    def windows(self, table: dict[str, Any]) -> WindowRules:
        """Read the rules of windows."""
        allowed = tuple(WindowRules.__dataclass_fields__)
        self.known(table, allowed, ("windows",))
        values = {key: self.number(value, ("windows", key)) for key, value in table.items()}
        for key, value in values.items():
            if value <= 0.0:
                self.fail(("windows", key), f"must be positive, got {value:g}")
        rules = WindowRules(**values)
        if rules.first_s >= rules.window_s or rules.calibrated_K > rules.large_K:
            self.fail(("windows",), "first_s must be below window_s, and calibrated_K not above large_K")
        return rules

    def revision(self, table: dict[str, Any]) -> Revision:
        """Read the origin of the file."""
        keys = ("revision",)
        self.known(table, Revision.__dataclass_fields__, keys)
        number = table.get("number", 0)
        if isinstance(number, bool) or not isinstance(number, int) or number < 0:
            self.fail((*keys, "number"), f"must be a whole number from 0 on, not {number!r}")
        values: dict[str, Any] = {"number": number}
        for key in ("parent", "made_by", "evidence", "parent_file", "record", "record_file", "checksum"):
            values[key] = self.string(table.get(key, ""), (*keys, key))
        for key in ("notes", "effects"):
            sentences = table.get(key, [])
            if not isinstance(sentences, list) or not all(isinstance(n, str) for n in sentences):
                self.fail((*keys, key), "must be a list of sentences in quotes")
            values[key] = tuple(sentences)
        for key in ("window_s", "held_out_s"):
            values[key] = self.pair(table[key], (*keys, key)) if key in table else None
        for key in ("error_before_K", "error_after_K", "error_fitted_K"):
            errors = self.table(table.get(key, {}), (*keys, key))
            values[key] = frozen_mapping({s: self.number(v, (*keys, key)) for s, v in errors.items()})
        return Revision(**values)


def _has_default(field: Any) -> bool:
    return field.default is not MISSING


_KEY = r"""(?:[A-Za-z0-9_-]+|"(?:[^"\\]|\\.)*"|'[^']*')"""
_KEYS = rf"{_KEY}(?:\s*\.\s*{_KEY})*"
_HEADER = re.compile(rf"\s*\[+\s*({_KEYS})\s*\]+\s*(#.*)?$")
_PAIR = re.compile(rf"\s*({_KEYS})\s*=")


def _line_of(text: str, keys: tuple[str, ...]) -> int | None:
    """Return the line (from 1) of the deepest of `keys` that can be found, or None; good enough to point at."""
    best: int | None = None
    table: tuple[str, ...] = ()
    for number, line in enumerate(text.splitlines(), start=1):
        header = _HEADER.match(line)
        if header:
            path = table = _parts(header.group(1))
        else:
            pair = _PAIR.match(line)
            if not pair:
                continue
            path = (*table, *_parts(pair.group(1)))
        if path == keys:
            return number
        if path == keys[: len(path)] and len(path) == len(keys) - 1:
            best = number
    return best


def _parts(dotted: str) -> tuple[str, ...]:
    """Return the keys in a dotted key as TOML writes it."""
    if '"' not in dotted and "'" not in dotted:
        return tuple(part.strip() for part in dotted.split("."))
    found: list[str] = []
    try:
        rest = tomllib.loads(f"{dotted} = 0")
    except tomllib.TOMLDecodeError:
        return (dotted,)
    while isinstance(rest, dict):
        key, rest = next(iter(rest.items()))
        found.append(key)
    return tuple(found)
