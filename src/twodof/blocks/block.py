"""Block: named inputs, outputs, states and parameters, and in Python what they become."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar

from twodof.blocks.declarations import Param, Port, State, shape
from twodof.blocks.expressions.arrays import vector
from twodof.blocks.expressions.expr import Expr, as_expr, leaf, to_real, tracing
from twodof.blocks.expressions.graph import leaves, walk
from twodof.blocks.expressions.numbers import Vector
from twodof.blocks.plain_data import plain_data
from twodof.errors import DiagramError, listed, shown

MAX_PORTS = 1000  # inputs, outputs, states or parameters of one block

Values = Mapping[str, Any]


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
            type.__setattr__(cls, "__init__", _recording_config(cls, cls.__init__))

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


def _recording_config(cls: type[Block], init: Callable[..., None]) -> Callable[..., None]:
    """`init` of `cls`, which keeps the arguments as `config`. A class of the library sees plain data only.

    Whatever is wrong with an argument there is a DiagramError that names the block.
    """
    signature = inspect.signature(init)

    @functools.wraps(init)
    def wrapped(self: Block, *args: Any, **kwargs: Any) -> None:
        outermost = "config" not in self.__dict__  # its arguments are those to record
        if "type_name" not in cls.__dict__:
            if outermost:
                bound = signature.bind(self, *args, **kwargs)
                bound.apply_defaults()
                self.config = dict(list(bound.arguments.items())[1:])
            init(self, *args, **kwargs)
            return
        with _arguments_of(type(self).__name__):
            try:
                bound = signature.bind(self, *args, **kwargs)
            except TypeError as error:
                takes = listed(list(signature.parameters)[1:])
                raise DiagramError(f"it {error}", "", f"its arguments: {takes}") from error
            bound.apply_defaults()
            given = {name: plain_data(value, name) for name, value in list(bound.arguments.items())[1:]}
            if outermost:
                self.config = given
            bound.arguments.update(given)
            init(*bound.args, **bound.kwargs)

    return wrapped


@contextmanager
def _arguments_of(block: str) -> Iterator[None]:
    """Let what the enclosed constructor refuses, or stumbles over, name the block, and the argument where it can."""
    try:
        yield
    except DiagramError as error:
        where = error.where if error.where.partition(".")[0] == block else f"{block}.{error.where}".rstrip(".")
        raise DiagramError(error.what, where, error.remedy) from error
    except (TypeError, ValueError, ArithmeticError, LookupError) as error:
        raise DiagramError(f"it cannot be made: {error!s:.200}", block, "see docs/reference/blocks.md") from error


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


def leaves_of(op: str, declared: Sequence[Any]) -> dict[str, Expr]:
    """The leaves of kind `op` for what is declared, by name."""
    return {d.name: leaf(op, d.name, d.kind, d.width) for d in declared}


def _trace(block: Block) -> Trace:
    name = type(block).__name__
    check_declarations(block, name)
    with tracing(name):
        u = Inputs(leaves_of("input", block.inputs))
        x = States(leaves_of("state", block.states))
        given = leaves_of("param", block.params)
        p = Parameters(given | leaves_of("param", block.derived))
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
                    f"edges names {port!r}, which is not a scalar output", name, "name an output of the block"
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
    parameters: list[Any] = [*block.params, *block.derived]
    by_name = {p.name: p for p in parameters}
    kinds: dict[str, Sequence[Any]] = {
        "input": block.inputs,
        "output": block.outputs,
        "state": block.states,
        "parameter": parameters,
    }
    for what, declared in kinds.items():
        if len(declared) > MAX_PORTS:
            raise DiagramError(f"{len(declared)} {what}s", name, f"a block has at most {MAX_PORTS}; use arrays")
        names = [d.name for d in declared]
        if len(set(names)) < len(names):
            raise DiagramError(
                f"two {what}s are named {max(names, key=names.count)!r}", name, "names are unique within a block"
            )
    for s in block.states:
        if isinstance(s.initial, str) and not (s.initial in by_name and shape(by_name[s.initial]) == shape(s)):
            raise DiagramError(
                f"state {s.name!r} starts from {shown(s.initial)}, which is not a parameter of this type",
                name,
                "name a parameter of the same type and width",
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
                f"{method} gives {shown(n)}, which is not declared", name, f"it may give: {listed(sorted(known))}"
            )
    for n in () if partial else known:
        if n not in result:
            raise DiagramError(f"{method} does not give {n!r}", name, "give each declared name a value")
    return dict(result)


def returned(name: str, method: str, result: Any, declared: Sequence[Any], partial: bool = False) -> dict[str, Expr]:
    """What a traced method returned, as Exprs of the declared types, in the order of declaration."""
    by_name = names_given(name, method, result, declared, partial)
    return {d.name: _fit(by_name[d.name], d, f"{name}.{method}: {d.name}") for d in declared if d.name in by_name}


def _fit(value: Any, declared: Any, where: str) -> Expr:
    if declared.width is not None and isinstance(value, (list, tuple, Vector)):
        value = vector([v if isinstance(v, Expr) else as_expr(v, declared.kind) for v in value])
    if declared.width is not None and not isinstance(value, Expr):
        raise DiagramError(f"a scalar is given for an array of {declared.width}", where, "give a list")
    fitted = value if isinstance(value, Expr) else as_expr(value, declared.kind)
    if shape(fitted) != shape(declared):
        raise DiagramError(
            f"a {shape(fitted)} is given for a {shape(declared)}",
            where,
            "convert it, or declare the name with that type",
        )
    return fitted
