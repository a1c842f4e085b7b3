"""Block: named inputs, outputs, states and parameters, and methods in Python that compute outputs and states."""

import functools
import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import reduce
from operator import and_
from typing import Any, ClassVar

from twodof.blocks.bus import expanded
from twodof.blocks.declarations import Param, Port, State, as_bus, located
from twodof.blocks.enumeration import plain_data
from twodof.blocks.expressions.expr import Expr, fault
from twodof.blocks.expressions.graph import free_bounds, walk
from twodof.blocks.namespaces import Clock as Clock
from twodof.blocks.trace import HIDDEN, Trace, by_method, clock_leaves, is_users, leaves_of, place, trace_of
from twodof.errors import DiagramError, listed


class Block:
    """Base class of blocks. Set `inputs`, `outputs`, `states`, `params`, `derived` in the class or in `__init__`.

    `u`, `x`, `p` are the inputs, states and parameters by attribute, `t` is a `Clock`. Each method returns a mapping
    from names to values; a method with one name to give may return the bare value. See docs/explanation/language.md.

    The result of a method may depend only on its arguments and on attributes that `__init__` sets. Once the block is
    traced the attributes are fixed.
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
        for name in cls.__dict__.keys() & _DECLARED:
            type.__setattr__(cls, name, expanded(cls.__dict__[name]))
        if "__init__" in cls.__dict__:
            type.__setattr__(cls, "__init__", _recording_config(cls, cls.__init__))

    def prepare(self, p: Any, t: Clock) -> Any:
        """Return the derived parameters, computed in float64 when a parameter changes. `t.tick` is not available."""
        return {}

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Return the outputs at this tick."""
        return {}

    def edges(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Return (fraction of the step in [0, 1), value after it), by name, for outputs that change inside the step."""
        return {}

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Return the discrete states of the next tick; a state that is not named keeps its value."""
        return {}

    def derivative(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Return the time derivative of each continuous state."""
        return {}

    def project(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Return continuous states that jump after the integration, by name; `u` is that at the start of the step."""
        return {}

    def __setattr__(self, name: str, value: Any) -> None:
        if "_traced" in self.__dict__:
            raise fault(f"the attribute {name!r} is assigned after the block was traced", HIDDEN)
        super().__setattr__(name, expanded(value) if name in _DECLARED else value)

    @functools.cached_property
    def trace(self) -> Trace:
        """Expressions of the methods, recorded once. Raises DiagramError if they break the language's rules."""
        self.__dict__["_traced"] = True  # from here on, for a method may set an attribute while it is traced
        try:
            return trace_of(self)
        except DiagramError:
            del self.__dict__["_traced"]  # what is wrong may be an attribute
            raise

    def written(self, method: str) -> Callable[..., Any]:
        """Return the Python function of the method named `method`, whose place an error gives."""
        function: Callable[..., Any] = getattr(type(self), method)
        return function


_DECLARED = frozenset(("inputs", "outputs", "states", "params", "variables"))

REGISTRY: dict[str, type[Block]] = {}


def library_block(type_name: str) -> Callable[[type[Block]], type[Block]]:
    """Return a class decorator for a library block, which JSON holds as `type_name` and constructor arguments."""

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
            bound.arguments.update(given | {n: as_bus(given[n]) for n in ("kind", "bus") if n in given})  # made once
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


def steady_trace(block: Block, path: str) -> Trace:
    """Return the trace of the block at `path`. Raises DiagramError for a user's block that is not steady."""
    with located(path, keep=True):
        trace = block.trace
        if is_users(block):
            check_steady(block)
    return trace


def check_steady(block: Block) -> None:
    """Trace a block again, and raise DiagramError if that gives another graph than the first time.

    The first graph is compiled. A method that depends on more than its arguments could compute something else at each
    step of the reference. Values that another block or a loop recorded are refused too.
    """
    first, again = by_method(block.trace), by_method(trace_of(block))
    prepared, stepped = _own(block)
    for method, exprs in first.items():
        for name in exprs | again[method]:
            # By identity: equal graphs are one node, and == on two of them would record a comparison.
            if list(map(id, exprs.get(name, ()))) != list(map(id, again[method].get(name, ()))):
                raise DiagramError(
                    f"{method} computes another {name!r} when it is traced again", place(block, method), HIDDEN
                )
        own = prepared if method == "prepare" else stepped
        _check_own(block, method, [e for roots in exprs.values() for e in roots], own)


def _own(block: Block) -> tuple[dict[int, Expr], dict[int, Expr]]:
    """Return the arguments of `prepare`, and those of the other methods, as leaves by id."""
    clock = clock_leaves()
    prepared = [*leaves_of("param", block.params).values(), clock["dt"], clock["base_dt"]]
    stepped = [*prepared, clock["tick"], *leaves_of("param", block.derived).values()]
    stepped += [*leaves_of("input", block.inputs).values(), *leaves_of("state", block.states).values()]
    return {id(e): e for e in prepared}, {id(e): e for e in stepped}


def _check_own(block: Block, method: str, roots: Sequence[Expr], own: Mapping[int, Expr]) -> None:
    """Raise DiagramError if `roots` hold a leaf that the method was not given, or a variable outside its loop."""
    for item in walk(roots):
        if item.op in ("input", "state", "param", "tick", "dt") and id(item) not in own:
            what = f"{method} uses {item!r}, which is not one of its arguments"
            raise DiagramError(what, place(block, method), HIDDEN)
    with located(place(block, method)):
        if any(free_bounds(roots).values()):
            raise DiagramError(
                f"{method} uses a variable of a loop outside that loop", "", "return what a loop computes from its body"
            )


EDGES = ("rising", "falling", "either")


def edge_of(edge: str, before: Any, now: Any) -> Any:
    """Return True if a bool that was `before` and is `now` has an `edge`, one of EDGES."""
    if edge == "either":
        return now ^ before
    return now & ~before if edge == "rising" else ~now & before


class EnabledAgain(Block):
    """y is true in a sample in which all of the bools e0, e1, ... are true and in the one before were not all true.

    It is false in the first sample, in which the states have their initial values, or values that were set.
    """

    crossing = True

    def __init__(self, enables: int) -> None:
        self.inputs = [Port(f"e{i}", "bool") for i in range(enables)]
        self.outputs = [Port("y", "bool")]
        self.states = [State("x", True, "bool")]

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return reduce(and_, (u[port.name] for port in self.inputs))

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return self.update(u, x, p, t) & ~x.x


class TriggerEdge(Block):
    """y is true in a sample in which u has an edge. It is false in the first one, as u before is not known."""

    crossing = True

    def __init__(self, edge: str) -> None:
        self.edge = edge
        self.inputs = [Port("u", "bool")]
        self.outputs = [Port("y", "bool")]
        self.states = [State("before", False, "bool"), State("begun", False, "bool")]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return x.begun & edge_of(self.edge, x.before, u.u)

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return {"before": u.u, "begun": True}
