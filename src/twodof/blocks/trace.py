"""Trace: expressions recorded by the methods of a block, checked against its declarations; errors in its Python."""

import inspect
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from traceback import walk_tb
from typing import Any, TypeVar

from twodof.blocks.bus import check_paths, fields_given
from twodof.blocks.declarations import Declared, Param, Port, State, alike, check_lists, located, shape
from twodof.blocks.elementary.functions import FUNCTIONS
from twodof.blocks.enumeration import Enumeration, comparing, stays_within
from twodof.blocks.expressions.arrays import Matrix, flat_of, matrix, shape_of, shape_text, vector
from twodof.blocks.expressions.expr import Expr, as_expr, leaf, recording, tracing
from twodof.blocks.expressions.graph import Sight, evaluate, walk
from twodof.blocks.expressions.numbers import STORED, Vector
from twodof.blocks.namespaces import BusView, Clock, Inputs, Namespace, Parameters, States
from twodof.errors import DiagramError, nearest, shown

OWN = "twodof"  # the package whose blocks are tested, not guarded
_NOT_THE_USERS = sys.stdlib_module_names | {"numpy", "scipy"}
_RECORDED = (Expr.__name__, Matrix.__name__)  # as Python's own errors name them
ARGUMENTS = {"prepare": "self, p, t"}  # of the methods; all others take what `output` takes
HIDDEN = "let it depend on u, x, p and t alone: keep what changes in a state, and set attributes in __init__"


def is_users(block: Declared) -> bool:
    """Return True for a user's own block. This package's blocks are guarded by its tests, which costs no start-up."""
    return type(block).__module__.partition(".")[0] != OWN


def is_missing(block: Declared, method: str) -> bool:
    """Return True if the block's class lacks the method, so that Block's, which gives nothing, is called."""
    return getattr(block.written(method), "__module__", "") == "twodof.blocks.block"


def definition(method: str) -> str:
    """How to write a method."""
    return f"write def {method}({ARGUMENTS.get(method, 'self, u, x, p, t')})"


def place(block: Declared, method: str) -> str:
    """Where a method stands, for an error: its block, its name, file and line."""
    function: Any = inspect.unwrap(block.written(method))
    code = None if is_missing(block, method) else getattr(function, "__code__", None)
    line = f", {code.co_filename}:{code.co_firstlineno}" if code else ""
    return f"block {type(block).__name__}.{method}{line}"


def mistake(error: Exception, block: Declared, method: str) -> DiagramError:
    """Return the error to raise for an exception in a method. Call it in the caller of the method."""
    below = [(f.f_globals.get("__name__", ""), f"{f.f_code.co_filename}:{n}") for f, n in walk_tb(error.__traceback__)]
    below = below[1:]  # without the caller's own
    if not below and isinstance(error, TypeError):
        what, remedy = f"it cannot be called: {error}", definition(method)
    else:
        what, remedy = _told(error)
    users = [line for name, line in below if not name.startswith("twodof.blocks.") and _top(name) not in _NOT_THE_USERS]
    where = f"block {type(block).__name__}.{method}, {users[-1]}" if users else place(block, method)
    return DiagramError(what, where, remedy)


def _top(module: str) -> str:
    return module.partition(".")[0]


def _told(error: Exception) -> tuple[str, str]:
    """Return the fact and the remedy."""
    if isinstance(error, DiagramError):
        return error.what, error.remedy
    text = f"{type(error).__name__}: {error!s:.300}".removesuffix(": ")
    recorded = isinstance(error, (TypeError, AttributeError)) and any(name in str(error) for name in _RECORDED)
    if recorded and "ufunc" in str(error):
        return (
            "a function of numpy is applied to a recorded value",
            "use the functions of twodof.blocks, such as sin, sqrt, minimum or where",
        )
    if recorded:
        return (
            f"this is not an operation on recorded values ({text})",
            "see the operators and functions in docs/explanation/language.md, section 2",
        )
    early = recording() and isinstance(error, (LookupError, TypeError, ValueError))
    return f"its code raises {text}", f"correct this line{'; values are not numbers yet when it runs' if early else ''}"


View = TypeVar("View")


class Shapes(dict[str, tuple[int, int]]):
    """The shapes of declared matrices by name; `buses`: whether something declared is the field of a bus."""

    def __init__(self, declared: Iterable[Port | State | Param] = ()) -> None:
        every = list(declared)
        super().__init__({d.name: d.shape for d in every if d.shape})
        self.buses = any("." in d.name for d in every)

    def __bool__(self) -> bool:
        """Return True if a view shows anything in another form than it is kept."""
        return self.buses or len(self) > 0


def matrices(*declared: Iterable[Port | State | Param]) -> Shapes:
    """Return the names of the declared matrices, with their shapes."""
    return Shapes(chain.from_iterable(declared))


def with_matrices(view: View, shapes: Shapes) -> View:
    """Return a view (Inputs, States, Parameters) that shows matrices and buses; `view` itself without any."""
    if not shapes:
        return view
    values: dict[str, Any] = vars(view)
    made: Any = type(view)
    values = {**values, **{n: Matrix(values[n], s) for n, s in shapes.items() if n in values}}
    shown: View = made(_nested(values) if shapes.buses else values)
    return shown


def _nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values by path as values by name, those of a bus as a view of its fields."""
    found: dict[str, Any] = {}
    inside: dict[str, dict[str, Any]] = {}
    for path, value in values.items():
        name, _, field = path.partition(".")
        if field:
            inside.setdefault(name, {})[field] = value
            found.setdefault(name, None)  # in its place
        else:
            found[name] = value
    return {**found, **{name: BusView(_nested(fields)) for name, fields in inside.items()}}


MAX_PORTS = 1000  # inputs, outputs, states or parameters of one block


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


def clock_leaves() -> dict[str, Expr]:
    """Return the leaves of a clock while a block is traced."""
    return {
        "tick": leaf("tick", "tick", "uint32"),
        "dt": leaf("dt", "dt", "real"),
        "base_dt": leaf("dt", "base_dt", "real"),
    }


def leaves_of(op: str, declared: Sequence[Any]) -> dict[str, Expr]:
    """Return the leaves of kind `op` for declarations, by name."""
    return {d.name: leaf(op, d.name, d.kind, d.width) for d in declared}


def _leaves(view: type[Namespace], op: str, declared: Sequence[Any]) -> Namespace:
    return with_matrices(view(dict(leaves_of(op, declared))), matrices(declared))


def views(block: Declared, states: Sequence[State]) -> tuple[Namespace, Namespace, Namespace]:
    """Return the inputs, `states` and parameters that a method of `block` sees while it is traced."""
    inputs, kept = _leaves(Inputs, "input", block.inputs), _leaves(States, "state", states)
    return inputs, kept, _leaves(Parameters, "param", [*block.params, *block.derived])


def trace_of(block: Declared) -> Trace:
    """Record the methods of `block`. Raises DiagramError if they break the language's rules."""
    check_declarations(block, type(block).__name__)
    clock = clock_leaves()
    discrete = [s for s in block.states if not s.continuous]
    continuous = [s for s in block.states if s.continuous]

    enumerated = enumerations(block.inputs, block.states, block.params, block.derived)

    def result(method: str) -> Any:
        # Each sees views of its own, through which it cannot reach another method's.
        if method == "prepare":
            return called(block, method, _leaves(Parameters, "param", block.params), Clock(**clock | {"tick": None}))
        return called(block, method, *views(block, block.states), Clock(**clock))

    def record(method: str, declared: Sequence[Any], partial: bool = False) -> dict[str, Expr]:
        with tracing(f"{type(block).__name__}.{method}"), comparing(enumerated):
            found = result(method)
            try:
                given = returned(method, found, declared, partial)
                _check_members(declared, given, enumerated)
                return given
            except DiagramError as error:
                remedy = definition(method) if is_missing(block, method) else error.remedy
                raise DiagramError(error.what, place(block, method), remedy) from error

    prepare = record("prepare", block.derived)
    outputs = record("output", block.outputs)
    update = record("update", discrete, partial=True)
    derivative = record("derivative", continuous)
    project = record("project", continuous, partial=True)
    with tracing(f"{type(block).__name__}.edges"), comparing(enumerated):
        edges = _edges(block, result("edges"), outputs)
    below = {o: walk([e, *edges.get(o, ())]) for o, e in outputs.items()}
    return Trace(
        outputs,
        edges,
        update,
        derivative,
        project,
        prepare,
        {o: frozenset(n.data for n in nodes if n.op == "input") for o, nodes in below.items()},
        frozenset(o for o, nodes in below.items() if any(n.op == "tick" for n in nodes)),
    )


def called(block: Declared, method: str, *arguments: Any) -> Any:
    """Call a method and return its result. Raises DiagramError, with the user's line, for each error in it."""
    try:
        return getattr(block, method)(*arguments)
    except Exception as error:
        raise mistake(error, block, method) from error


def _edges(block: Declared, result: Any, outputs: Mapping[str, Expr]) -> dict[str, tuple[Expr, Expr]]:
    if isinstance(result, Mapping) and not result:
        return {}
    edges = {}
    with located(place(block, "edges")):
        remedy = "return a dict: output -> (fraction, value after)"
        if not isinstance(result, Mapping):
            raise DiagramError(f"edges returns {_described(result)}", "", remedy)
        for port, pair in result.items():
            if not isinstance(pair, (tuple, list)) or len(pair) != 2:
                raise DiagramError(f"edges gives {_described(pair)} for {shown(port)}", "", remedy)
            if port not in outputs or outputs[port].width is not None:
                what = f"edges names {shown(port)}, which is not a scalar output"
                raise DiagramError(what, "", "name an output of the block")
            edges[port] = (as_expr(pair[0], "real"), as_expr(pair[1], outputs[port].kind))
    return edges


MethodGraphs = dict[str, dict[str, tuple[Expr, ...]]]
"""The expressions of each method by name: one each, of an edge two."""


def by_method(trace: Trace) -> MethodGraphs:
    """Return the expressions of each method."""
    single = {
        "prepare": trace.prepare,
        "output": trace.outputs,
        "update": trace.update,
        "derivative": trace.derivative,
        "project": trace.project,
    }
    methods: MethodGraphs = {m: {name: (e,) for name, e in exprs.items()} for m, exprs in single.items()}
    return {**methods, "edges": dict(trace.edges)}


def roots_of(graphs: MethodGraphs) -> list[Expr]:
    """Return the expressions of all methods."""
    return [e for exprs in graphs.values() for roots in exprs.values() for e in roots]


def computed_graphs(graphs: Mapping[str, tuple[Expr, ...]], u: Any, x: Any, p: Any, t: Any) -> dict[str, Any]:
    """Evaluate the expressions of one method; return a tuple of values for each name."""
    values = iter(computed([e for roots in graphs.values() for e in roots], u, x, p, t))
    return {name: tuple(next(values) for _ in roots) for name, roots in graphs.items()}


def computed(roots: Sequence[Expr], u: Any, x: Any, p: Any, t: Any, sight: Sight | None = None) -> list[Any]:
    """Evaluate recorded expressions on the values of a step: the judge of a block's methods, and a TracedBlock's body.

    `sight` is shown what is computed, as `evaluate` does.
    """

    def value(item: Expr) -> Any:
        if item.op == "tick":
            return t.tick
        if item.op == "dt":
            return t.dt if item.data == "dt" else t.base_dt
        return flat_of({"input": u, "state": x, "param": p}[item.op][item.data])

    return evaluate(roots, value, FUNCTIONS, sight)


def check_declarations(block: Declared, name: str) -> None:
    """Raise DiagramError if two inputs, outputs, states or parameters share a name or a default does not fit."""
    check_lists(block, name)
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
        if any("." in n for n in names):
            check_paths(names, name)
    for s in block.states:
        if isinstance(s.initial, str) and not (s.initial in by_name and alike(by_name[s.initial], s)):
            raise DiagramError(
                f"state {s.name!r} starts from {shown(s.initial)}, which is not a parameter of this type",
                name,
                f"write {s.enum.name}.{s.initial}"
                if s.enum is not None and s.initial in s.enum.members
                else "name a parameter of the same type and width",
            )


def names_given(method: str, result: Any, declared: Sequence[Any], partial: bool = False) -> dict[str, Any]:
    """Return a method's result as a mapping, with its names checked against the declared ones."""
    if result is None:
        raise DiagramError(f"{method} returns nothing", "", "end it with a return of its values")
    result = by_path(result, [d.name for d in declared])
    if not isinstance(result, Mapping):
        if len(declared) != 1:
            raise DiagramError(
                f"{method} returns {_described(result)} for {len(declared)} names", "", "return a dict by name"
            )
        result = {declared[0].name: result}
    known = {d.name for d in declared}
    for n in result:
        if n not in known:
            raise DiagramError(
                f"{method} gives {shown(n)}, which is not declared", "", f"it may give: {nearest(n, sorted(known))}"
            )
    for n in () if partial else known:
        if n not in result:
            raise DiagramError(f"{method} does not give {n!r}", "", "give each declared name a value")
    return dict(result)


Enumerations = dict[tuple[str, str], Enumeration | None]


def enumerations(inputs: Sequence[Any], states: Sequence[Any], *params: Sequence[Any]) -> Enumerations:
    """Return the enumerations of inputs, states and parameters, by leaf and name."""
    leaves = (("input", inputs), ("state", states), *(("param", declared) for declared in params))
    return {(op, d.name): d.enum for op, declared in leaves for d in declared}


def _check_members(declared: Sequence[Any], given: Mapping[str, Expr], leaves: Enumerations) -> None:
    """Raise DiagramError if a value for a declared enumeration may be none of its members."""
    for d in declared:
        if d.enum is not None and d.name in given and not stays_within(d.enum, given[d.name], leaves):
            what = f"{d.name!r} is a {d.enum.name}, and is given an int32 that may be none of its members"
            remedy = f"give {d.enum.name}.{next(iter(d.enum.members))}, ..., or to_enumeration({d.enum.name}, value)"
            raise DiagramError(what, "", remedy)


def by_path(result: Any, names: Sequence[str]) -> Any:
    """Return a method's result with the fields of buses by path, such as "att.rates.p" in `names`."""
    if not any("." in name for name in names):
        return result
    tops = {name.partition(".")[0] for name in names}
    bare = isinstance(result, BusView) or (isinstance(result, Mapping) and tops.isdisjoint(result))
    if len(tops) == 1 and bare and not (isinstance(result, Mapping) and set(names) & set(result)):
        result = {next(iter(tops)): result}
    return fields_given(result, names, "") if isinstance(result, Mapping) else result


def _described(value: Any) -> str:
    return "one recorded value" if isinstance(value, Expr) else f"{shown(value)} of type {type(value).__name__}"


def returned(method: str, result: Any, declared: Sequence[Any], partial: bool = False) -> dict[str, Expr]:
    """Return a traced method's result as Exprs of the declared types, in the order of declaration."""
    by_name = names_given(method, result, declared, partial)
    return {d.name: _fit(by_name[d.name], d) for d in declared if d.name in by_name}


def _fit(value: Any, declared: Any) -> Expr:
    if declared.shape is not None and isinstance(value, (list, tuple)) and not isinstance(value, Vector):
        value = matrix(value)
    if declared.shape != (value.shape if isinstance(value, Matrix) else None):
        found = f"an array of {shape_text(shape_of(value))}" if shape_of(value) else _described(value)
        what = f"{declared.name!r} is given {found}, and is a {shape(declared)}"
        raise DiagramError(what, "", "give it that shape, or declare the name with the other one")
    value = flat_of(value)
    if declared.width is not None and isinstance(value, (list, tuple, Vector)):
        value = vector([v if isinstance(v, Expr) else as_expr(v, declared.kind) for v in value])
    if declared.width is not None and not isinstance(value, Expr):
        raise DiagramError(
            f"{declared.name!r} is given {_described(value)}, and is an array of {declared.width}", "", "give a list"
        )
    fitted = value if isinstance(value, Expr) else as_expr(value, declared.kind)
    if (fitted.kind, fitted.width) != (declared.kind, declared.width):
        rule = ', overflow="saturate") or "wrap"' if declared.kind in STORED else ")"
        how = "convert it" if fitted.kind == declared.kind else f"convert it by name, to_{declared.kind}(x{rule}"
        what = f"{declared.name!r} is given a {shape(fitted)}, and is a {shape(declared)}"
        raise DiagramError(what, "", f"{how}, or declare the name with that type")
    return fitted
