"""Block: named inputs, outputs, states and parameters, and in Python what they become."""

from __future__ import annotations

import difflib
import functools
import inspect
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.arrays import vector
from twodof.blocks.expressions.expr import KINDS, Expr, as_expr, const, leaf, to_real, tracing
from twodof.blocks.expressions.graph import leaves, walk
from twodof.blocks.expressions.numbers import Integer, Vector
from twodof.errors import DiagramError, ParameterError, listed, outside, shown

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")
MAX_WIDTH = 1_000_000
MAX_PORTS = 1000  # inputs, outputs, states or parameters of one block
MAX_STEPS = 100_000_000
_RANGES = {"int32": (-(2**31), 2**31 - 1), "uint32": (0, 2**32 - 1)}

Values = Mapping[str, Any]


def check_name(name: object, where: str) -> str:
    """`name` if it is a legal name (a letter, then letters, digits and _, 63 at most); else DiagramError."""
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise DiagramError(
            f"{shown(name)} is no name", where, "use a letter, then up to 62 letters, digits or _ (ASCII)"
        )
    return name


def check_steps(steps: object, where: str) -> int:
    """`steps` if it is a number of steps that one call may run, 0 to MAX_STEPS; else DiagramError."""
    if isinstance(steps, (bool, np.bool_)) or not isinstance(steps, (int, np.integer)) or not 0 <= steps <= MAX_STEPS:
        raise DiagramError(f"{steps!r:.40} steps", where, f"run 0 to {MAX_STEPS} steps in one call")
    return int(steps)


def _check_shape(kind: str, width: int | None, name: str, unit: str) -> None:
    check_name(name, "block")
    if not isinstance(unit, str):
        raise DiagramError(f"the unit {shown(unit)} is no text", name, 'write it as "m/s", or "" for none')
    if kind not in KINDS:
        raise DiagramError(f"unknown type {shown(kind)}", name, f"use one of {', '.join(KINDS)}")
    if width is not None and not (type(width) is int and 1 <= width <= MAX_WIDTH):
        raise DiagramError(f"width {shown(width)} is not in 1..{MAX_WIDTH}", name, "use None for a scalar")


@dataclass(frozen=True)
class Port:
    """An input, output or derived parameter: scalar if `width` is None, else an array. `unit` "" is not compared."""

    name: str
    kind: str = "real"
    width: int | None = None
    unit: str = ""

    def __post_init__(self) -> None:
        _check_shape(self.kind, self.width, self.name, self.unit)


@dataclass(frozen=True)
class State:
    """A state. `initial` is a number, a sequence of `width` numbers, or the name of a parameter of the block.

    A discrete state changes by `update`, a continuous one (real only) by `derivative` and `project`.
    """

    name: str
    initial: Any = 0
    kind: str = "real"
    width: int | None = None
    unit: str = ""
    continuous: bool = False

    def __post_init__(self) -> None:
        _check_shape(self.kind, self.width, self.name, self.unit)
        if self.continuous and self.kind != "real":
            raise DiagramError(f"a continuous state of type {self.kind}", self.name, "continuous states are real")
        if not isinstance(self.initial, str):
            _declared(self.initial, self.kind, self.width, self.name)


@dataclass(frozen=True)
class Param:
    """A parameter: default `value` (a sequence if `width` is given), bounds `low` and `high` (inclusive), unit, text.

    Raises DiagramError for a default that is not of its kind or not within the bounds, and for bounds that are none. A
    parameter that is not `tunable` is fixed once the diagram runs (it may still be set before).
    """

    name: str
    value: Any = 0.0
    kind: str = "real"
    width: int | None = None
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    text: str = ""
    tunable: bool = True

    def __post_init__(self) -> None:
        _check_shape(self.kind, self.width, self.name, self.unit)
        given = _declared(self.value, self.kind, self.width, self.name)
        _check_limits(self)
        free = self.kind == "bool" or (self.low == -math.inf and self.high == math.inf)
        for value in () if free else given:
            if not self.low <= value <= self.high:
                raise DiagramError(f"the default {value} is outside [{self.low}, {self.high}]", self.name, "change one")


def _declared(value: Any, kind: str, width: int | None, name: str) -> list[Any]:
    """The numbers of a declared value, as given. Raises DiagramError for one that is not of its kind."""
    try:
        numeric(value, kind, width, name)
    except OverflowError:
        raise DiagramError(f"{shown(value)} is no real number", name, "make it smaller") from None
    given = value.tolist() if isinstance(value, np.ndarray) else value
    scalars = [*given] if isinstance(given, (list, tuple)) else [given]
    plain = [one.value if isinstance(one, Integer) else one for one in scalars]
    if kind in _RANGES:  # an integer that is computed wraps around, one that is written down is a slip of the pen
        low, high = _RANGES[kind]
        for one in plain:
            if not fits(one, kind):
                raise DiagramError(f"{one} is no {kind}", name, f"write a whole number from {low} to {high}")
    return plain


def fits(value: int, kind: str) -> bool:
    """Whether a whole number, or a bool, is one of `kind` as it is, without wrapping around."""
    low, high = _RANGES.get(kind, (0, 1))
    return low <= value <= high


def _check_limits(declared: Param) -> None:
    """Raise DiagramError for bounds that are none."""
    for bound in (declared.low, declared.high):
        if isinstance(bound, (bool, np.bool_)) or not isinstance(bound, (int, float, np.number)) or math.isnan(bound):
            raise DiagramError(
                f"the bound {shown(bound)} is no number", declared.name, "leave it out, or give a number"
            )
        if declared.kind in _RANGES and math.isfinite(bound) and bound != int(bound):
            raise DiagramError(f"the bound {bound} of whole numbers is not whole", declared.name, "round it")
    if declared.low > declared.high:
        raise DiagramError(
            f"no value is within [{declared.low}, {declared.high}]", declared.name, "exchange the bounds"
        )


def narrowed(outer: Param, inner: Param, path: str) -> Param:
    """`outer` within the bounds of `inner` too, the parameter at `path` that is bound to it.

    Raises DiagramError if the default of `outer` lies outside.
    """
    low, high = max(outer.low, inner.low), min(outer.high, inner.high)
    for value in np.ravel(np.asarray(outer.value)):
        if outer.kind != "bool" and not low <= value <= high:
            raise DiagramError(
                f"it is bound to {outer.name!r}, whose default {value} is outside [{low}, {high}]", path, "change it"
            )
    return replace(outer, low=low, high=high)


class Namespace:
    """What a block's methods read: attributes by name, a live view of `values`. An unknown name is an error."""

    what: ClassVar[str] = "name"

    def __init__(self, values: dict[str, Any]) -> None:
        self.__dict__ = values

    def __getattr__(self, name: str) -> Any:
        known = ", ".join(self.__dict__) or "none"
        raise DiagramError(f"there is no {self.what} {name!r}", "", f"there are: {known}")

    def __getitem__(self, name: str) -> Any:
        return getattr(self, name)


class Inputs(Namespace):
    """The inputs of a block."""

    what = "input"


class States(Namespace):
    """The states of a block."""

    what = "state"


class Parameters(Namespace):
    """The parameters of a block, given and derived."""

    what = "parameter"


class Clock:
    """Time as a block sees it: `tick` (uint32 base tick), `dt` [s] of the block, `base_dt` [s] of the tick."""

    def __init__(self, tick: Any, dt: Any, base_dt: Any) -> None:
        self.tick = tick
        self.dt = dt
        self.base_dt = base_dt

    @property
    def time(self) -> Any:
        """Seconds since the start, tick * base_dt (in float32 exact to 2^24 ticks: count ticks where that matters)."""
        return to_real(self.tick) * self.base_dt


class Block:
    """Subclass this: set `inputs`, `outputs`, `states`, `params`, `derived` (class attributes, or in `__init__`).

    `u`, `x`, `p` are the inputs, states and parameters by attribute, `t` is a `Clock`. Each method returns a mapping
    from names to values; a method with one name to give may return the bare value. See docs/explanation/language.md.
    """

    inputs: Sequence[Port] = ()
    outputs: Sequence[Port] = ()
    states: Sequence[State] = ()
    params: Sequence[Param] = ()
    derived: Sequence[Port] = ()
    crossing: bool = False  # may read a signal of another rate
    config: dict[str, Any]
    type_name: ClassVar[str] = ""  # set by `library_block`: how JSON names the class

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if "__init__" in cls.__dict__:
            type.__setattr__(cls, "__init__", _recording_config(cls.__init__))

    def prepare(self, p: Any, t: Clock) -> Any:
        """The derived parameters; runs when a parameter changes. `t.tick` may not be used here."""
        return {}

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """The outputs at this tick."""
        return {}

    def edges(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """For outputs that change once inside the step: name -> (fraction of the step in [0, 1), value after it)."""
        return {}

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """The discrete states of the next tick; a state that is not named keeps its value."""
        return {}

    def derivative(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """The time derivative of each continuous state."""
        return {}

    def project(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Jumps of continuous states after the integration: `x` is integrated, `u` is that of the step's start."""
        return {}

    @functools.cached_property
    def trace(self) -> Trace:
        """What the methods record; made once. Raises DiagramError if they break the language's rules."""
        return _trace(self)


REGISTRY: dict[str, type[Block]] = {}


def library_block(type_name: str) -> Callable[[type[Block]], type[Block]]:
    """Class decorator: a block of the library, which JSON names by `type_name` and its constructor's arguments."""

    def register(cls: type[Block]) -> type[Block]:
        if type_name in REGISTRY:
            raise DiagramError(f"the type {type_name!r} is registered twice", cls.__name__, "choose another name")
        cls.type_name = type_name
        REGISTRY[type_name] = cls
        return cls

    return register


def _recording_config(init: Callable[..., None]) -> Callable[..., None]:
    signature = inspect.signature(init)

    @functools.wraps(init)
    def wrapped(self: Block, *args: Any, **kwargs: Any) -> None:
        if "config" not in self.__dict__:  # the outermost constructor is the one to record
            bound = signature.bind(self, *args, **kwargs)
            bound.apply_defaults()
            self.config = {k: _plain(v) for k, v in list(bound.arguments.items())[1:]}
        init(self, *args, **kwargs)

    return wrapped


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return value


@dataclass(frozen=True)
class Trace:
    """The expressions of a block, over the leaves `input`, `state`, `param` (by name), `tick` and `dt`.

    `feedthrough[port]` are the inputs that an output (or its edge) depends on in the same tick.
    """

    outputs: dict[str, Expr]
    edges: dict[str, tuple[Expr, Expr]]
    update: dict[str, Expr]
    derivative: dict[str, Expr]
    project: dict[str, Expr]
    prepare: dict[str, Expr]
    feedthrough: dict[str, frozenset[str]]
    uses_tick: frozenset[str]  # outputs that depend on the tick


SECTIONS = ("prepare", "output", "edges", "update", "derivative", "project")


def trace_clock(tick: bool = True) -> Clock:
    """The clock that tracing sees."""
    return Clock(
        leaf("tick", "tick", "uint32") if tick else None,
        leaf("dt", "dt", "real"),
        leaf("dt", "base_dt", "real"),
    )


def _leaves(op: str, declared: Sequence[Any]) -> dict[str, Expr]:
    return {d.name: leaf(op, d.name, d.kind, d.width) for d in declared}


def _trace(block: Block) -> Trace:
    name = type(block).__name__
    check_declarations(block, name)
    with tracing(name):
        u = Inputs(_leaves("input", block.inputs))
        x = States(_leaves("state", block.states))
        given = _leaves("param", block.params)
        p = Parameters(given | _leaves("param", block.derived))
        t = trace_clock()
        discrete = [s for s in block.states if not s.continuous]
        continuous = [s for s in block.states if s.continuous]
        prepare = returned(name, "prepare", block.prepare(Parameters(dict(given)), trace_clock(False)), block.derived)
        outputs = returned(name, "output", block.output(u, x, p, t), block.outputs)
        update = returned(name, "update", block.update(u, x, p, t), discrete, partial=True)
        derivative = returned(name, "derivative", block.derivative(u, x, p, t), continuous)
        project = returned(name, "project", block.project(u, x, p, t), continuous, partial=True)
        edges = {}
        for port, (fraction, after) in dict(block.edges(u, x, p, t)).items():
            if port not in outputs or outputs[port].width is not None:
                raise DiagramError(
                    f"edges names {port!r}, which is no scalar output", name, "name an output of the block"
                )
            edges[port] = (as_expr(fraction, "real"), as_expr(after, outputs[port].kind))
    needs = {o: [e, *edges.get(o, ())] for o, e in outputs.items()}
    return Trace(
        outputs,
        edges,
        update,
        derivative,
        project,
        prepare,
        {o: frozenset(leaves(roots, "input")) for o, roots in needs.items()},
        frozenset(o for o, roots in needs.items() if any(n.op == "tick" for n in walk(roots))),
    )


def check_declarations(block: Block, name: str) -> None:
    """Raise DiagramError if two inputs, outputs, states or parameters share a name or a default does not fit."""
    kinds: list[tuple[str, list[Any]]] = [
        ("input", [*block.inputs]),
        ("output", [*block.outputs]),
        ("state", [*block.states]),
        ("parameter", [*block.params, *block.derived]),
    ]
    for what, declared in kinds:
        if len(declared) > MAX_PORTS:
            raise DiagramError(f"{len(declared)} {what}s", name, f"a block has at most {MAX_PORTS}; use arrays")
        seen: set[str] = set()
        for d in declared:
            if d.name in seen:
                raise DiagramError(f"two {what}s are named {d.name!r}", name, "names are unique within a block")
            seen.add(d.name)
    parameters: list[Any] = [*block.params, *block.derived]
    by_name = {p.name: p for p in parameters}
    for s in block.states:
        if isinstance(s.initial, str):
            source = by_name.get(s.initial)
            if source is None or (source.kind, source.width) != (s.kind, s.width):
                raise DiagramError(
                    f"state {s.name!r} starts from {shown(s.initial)}, which is no such parameter",
                    name,
                    "name a parameter of the same type and width",
                )


def numeric(value: Any, kind: str, width: int | None, where: str) -> Any:
    """`value` as a number of the current precision (or a Vector of `width` of them; one number fills an array).

    Raises DiagramError if it is of another type or length.
    """
    if isinstance(value, np.ndarray):
        value = value.tolist()
    elif isinstance(value, np.generic) and not isinstance(value, np.bool_):
        value = value.item()
    try:
        if kind == "bool" and type(value) is int and value in (0, 1):
            value = bool(value)
        if width is None:
            return numbers.cast(value, kind)
        if isinstance(value, (list, tuple)):
            if len(value) != width:
                raise DiagramError(f"{len(value)} values for an array of {width}", where, f"give {width} values")
            return Vector(numeric(v, kind, None, where) for v in value)
        return Vector([numbers.cast(value, kind)] * width)
    except DiagramError as error:
        raise DiagramError(error.what, where, error.remedy) from error


def check_bounds(declared: Param, value: Any, path: str) -> None:
    """Raise ParameterError if a number of `value`, as given (neither rounded nor wrapped), is out of bounds."""
    for given in value if isinstance(value, (list, tuple, np.ndarray)) else (value,):
        number = given.value if isinstance(given, Integer) else given
        if not declared.low <= number <= declared.high:
            raise ParameterError(
                outside(number, declared.low, declared.high, declared.unit),
                path,
                "choose a value within the bounds",
            )


def unknown_parameter(path: object, known: Iterable[str]) -> ParameterError:
    """The error for a parameter `path` that is not there; it lists up to 40 of the `known` ones, the nearest first."""
    names = sorted(known)
    nearest = difflib.get_close_matches(str(path)[:200], names, n=5)
    listed = [*nearest, *(name for name in names if name not in nearest)]
    more = f" and {len(listed) - 40} more" if len(listed) > 40 else ""
    return ParameterError(
        f"there is no parameter {path!r:.120}", "", f"there are: {', '.join(listed[:40]) or 'none'}{more}"
    )


def names_given(name: str, method: str, result: Any, declared: Sequence[Any], partial: bool = False) -> dict[str, Any]:
    """What a block's method returned as a mapping, with its names checked against those declared."""
    if not isinstance(result, Mapping):
        if len(declared) != 1:
            raise DiagramError(
                f"{method} returns one bare value for {len(declared)} names", name, "return a dict by name"
            )
        result = {declared[0].name: result}
    known = {d.name for d in declared}
    for n in result:
        if n not in known:
            raise DiagramError(
                f"{method} gives {shown(n)}, which is not declared",
                name,
                f"it may give: {listed(sorted(known))}",
            )
    if not partial:
        for n in known:
            if n not in result:
                raise DiagramError(f"{method} does not give {n!r}", name, "give each declared name a value")
    return dict(result)


def returned(name: str, method: str, result: Any, declared: Sequence[Any], partial: bool = False) -> dict[str, Expr]:
    """What a traced method returned, as Exprs of the declared types, in the order of declaration."""
    by_name = names_given(name, method, result, declared, partial)
    return {d.name: _fit(by_name[d.name], d, f"{name}.{method}: {d.name}") for d in declared if d.name in by_name}


def _fit(value: Any, declared: Any, where: str) -> Expr:
    if declared.width is not None and isinstance(value, (list, tuple, Vector)):
        value = vector([as_expr(v, declared.kind) if not isinstance(v, Expr) else v for v in value])
    if isinstance(value, Expr):
        fitted = value
    elif declared.width is not None:
        raise DiagramError(f"a scalar is given for an array of {declared.width}", where, "give a list")
    elif isinstance(value, Integer) and value.kind == declared.kind:
        fitted = const(value, declared.kind)
    else:
        fitted = as_expr(value, declared.kind)
    if (fitted.kind, fitted.width) != (declared.kind, declared.width):
        raise DiagramError(
            f"a {_shape(fitted.kind, fitted.width)} is given for a {_shape(declared.kind, declared.width)}",
            where,
            "convert it, or declare the name with that type",
        )
    return fitted


def _shape(kind: str, width: int | None) -> str:
    return kind if width is None else f"{kind}[{width}]"
